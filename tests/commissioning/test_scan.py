"""Scans of simulated lines in virtual time: what is found, what is not written, when it stops."""

from __future__ import annotations

import asyncio
import math
import tomllib
from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.bus.line import Line
from gateway.clock import Clock
from gateway.commissioning import scan_plan, scan_report
from gateway.commissioning.findings import Found, Result
from gateway.commissioning.scan import Search, scan
from gateway.commissioning.scan_plan import Setting, Wish
from gateway.drives.catalogue import load
from gateway.errors import BadReply, LineDown
from gateway.sim import settings as simulated_settings
from gateway.sim.settings import SimulatedLineConfig
from gateway.sim.wire import Wire
from tests import virtual
from tests.bus.hand import Ear, HeardLine

MODELS = load()


class Deaf(HeardLine):
    """A port at another setting than the drives': they hear nothing that they understand."""

    def __init__(self, wire: Wire, line: site.Line, clock: Clock, ear: Ear, *, is_right: bool) -> None:
        super().__init__(wire, line, clock, ear)
        self._is_right = is_right

    async def write(self, frame: bytes, not_after: float = math.inf) -> float:
        """Send what nobody hears, at the wrong setting."""
        if self._is_right:
            return await super().write(frame, not_after)
        self._ear.frames.append(frame)
        return self._clock.now()


class Stage:
    """A simulated line, the settings at which it was opened, and what the scan said on its way."""

    def __init__(self, config: SimulatedLineConfig, *, is_pty: bool) -> None:
        self.config = config
        self.is_pty = is_pty
        self.wire = simulated_settings.build(config, asyncio.get_running_loop().time())
        self.changes = [drive.inverter.memory.changes for drive in self.wire.drives]
        self.ear = Ear()
        self.opened: list[Setting] = []
        self.told: list[str] = []
        self.steps = 0
        self.planned = 0

    async def open(self, line: site.Line, clock: Clock) -> Line:
        """Open the port."""
        self.opened.append(Setting(line.baud, line.parity))
        is_right = self.is_pty or (line.baud, line.parity) == (self.config.baud, self.config.parity)
        port = Deaf(self.wire, line, clock, self.ear, is_right=is_right)
        port.is_pty = self.is_pty
        return port

    def begin(self, what: str, probes: int) -> None:
        """Count what is planned."""
        self.planned += probes

    def step(self) -> None:
        """Count what was done."""
        self.steps += 1

    def tell(self, what: str) -> None:
        """Keep what is found."""
        self.told.append(what)


def look(
    drives: list[dict[str, Any]], wish: Wish | None = None, *, is_pty: bool = False, **sim: Any
) -> tuple[Stage, Result]:
    """Scan a simulated line."""

    async def main() -> tuple[Stage, Result]:
        stage = Stage(SimulatedLineConfig.model_validate({"drive": drives, **sim}), is_pty=is_pty)
        search = Search(wish or Wish("/dev/ttyUSB0"), MODELS, virtual.VirtualClock(), stage, stage.open)
        result = await scan(search)
        assert stage.wire.statistics.gap_violations == 0
        return stage, result

    return virtual.run(main())


def found(result: Result) -> list[tuple[int, str, str]]:
    """Return number, protocol and model of what was found."""
    return [(item.number, item.protocol, item.model_name) for item in result.found]


def toshiba(number: int, model: str = "vf-nc3", **more: Any) -> dict[str, Any]:
    """Return a drive as it is shipped: TOSHIBA."""
    return {"number": number, "model": model, "protocol": "toshiba", **more}


def modbus(number: int, model: str = "vf-nc3", **more: Any) -> dict[str, Any]:
    """Return a drive set to MODBUS-RTU."""
    return {"number": number, "model": model, **more}


def test_drives_of_both_protocols_are_found_and_recognised() -> None:
    """By binary up to 63, by ASCII beyond; by 2BH in MODBUS-RTU."""
    drives = [toshiba(0, "vf-mb1"), toshiba(63), toshiba(99), modbus(3, "vf-mb1"), modbus(247)]
    stage, result = look(drives)
    assert found(result) == [
        (3, "modbus-rtu", "vf-mb1"),
        (0, "toshiba-binary", "vf-mb1"),
        (63, "toshiba-binary", "vf-nc3"),
        (99, "toshiba-ascii", "vf-nc3"),
        (247, "modbus-rtu", "vf-nc3"),
    ]
    assert set(stage.opened) == {Setting(19200, "even")}
    assert result.garbled == []
    assert len(stage.told) == 5
    assert stage.steps == stage.planned


def test_nothing_is_written_to_any_drive() -> None:
    """Neither to RAM nor to EEPROM."""
    stage, result = look([toshiba(0, "vf-mb1"), toshiba(70), modbus(3)])
    assert len(result.found) == 3
    assert [drive.inverter.memory.changes for drive in stage.wire.drives] == stage.changes


@pytest.mark.parametrize("protocol", ["toshiba", "modbus-rtu"])
@pytest.mark.parametrize(("baud", "parity"), [(9600, "odd"), (38400, "none"), (19200, "even")])
def test_the_setting_of_the_line_is_found(baud: int, parity: str, protocol: str) -> None:
    """And no other is tried behind it."""
    stage, result = look([{"number": 7, "model": "vf-nc3"}], baud=baud, parity=parity, protocol=protocol)
    assert [item.setting for item in result.found] == [Setting(baud, parity)]
    assert stage.opened[-1] == Setting(baud, parity)


def test_a_high_number_at_an_unlikely_setting_is_found_in_the_end() -> None:
    """The second look goes through all the rest."""
    _, result = look([modbus(200)], baud=38400, parity="odd")
    assert found(result) == [(200, "modbus-rtu", "vf-nc3")]


def test_all_goes_on_where_something_is_found() -> None:
    """Every setting is opened."""
    stage, result = look([toshiba(1)], Wish("/dev/x", numbers=(1, 2), is_all=True))
    assert len(set(stage.opened)) == 9
    assert found(result) == [(1, "toshiba-binary", "vf-nc3")]


def test_where_nobody_answers_the_scan_ends_in_the_time_that_was_said() -> None:
    """The likely questions twice, the others once; advice instead of a configuration."""

    async def main() -> None:
        loop = asyncio.get_running_loop()
        stage = Stage(SimulatedLineConfig.model_validate({"drive": [modbus(1)]}), is_pty=False)
        wish = Wish("/dev/x", bauds=(9600,), parities=("odd",))
        search = Search(wish, MODELS, virtual.VirtualClock(), stage, stage.open)
        begun = loop.time()
        result = await scan(search)
        probes = scan_plan.everything(wish, MODELS)
        longest = scan_plan.longest(probes, Setting(9600, "odd"), search.processing, search.margin)
        assert loop.time() - begun < longest + 1.0
        assert len(stage.ear.frames) == len(probes) == stage.steps
        assert result.found == []
        assert scan_report.configuration(result, "/dev/x") == ""
        assert any(line.startswith("no drive answers") for line in scan_report.sentences(result))

    virtual.run(main())


@pytest.mark.parametrize("protocol", ["toshiba", "modbus-rtu"])
def test_two_drives_with_one_number_are_told_of(protocol: str) -> None:
    """Their answers fall upon each other."""
    drives = [{"number": n, "model": "vf-nc3", "protocol": protocol} for n in (5, 5, 6)]
    _, result = look(drives)
    assert {number for _, _, number in result.garbled} == {5}
    assert [item.number for item in result.found] == [6]
    said = list(scan_report.sentences(result))
    assert any(line.startswith("number 5 answers garbage at 19200 baud, even parity") for line in said)


def test_a_single_disturbed_answer_hides_no_drive() -> None:
    """It is asked again."""
    drives = [modbus(5, fault=[{"kind": "truncate", "count": 1}]), toshiba(6, fault=[{"kind": "flip", "count": 1}])]
    _, result = look(drives)
    assert {item[0] for item in found(result)} == {5, 6}


def test_a_lost_answer_hides_no_drive_where_others_answer() -> None:
    """Silent numbers are asked once more."""
    drives = [modbus(5, fault=[{"kind": "drop", "count": 1}]), toshiba(6, fault=[{"kind": "drop", "count": 2}])]
    stage, result = look([*drives, toshiba(1), modbus(2)])
    assert {item[0] for item in found(result)} == {1, 2, 5, 6}
    assert stage.steps == stage.planned


@pytest.mark.parametrize("numbers", [(), (3, 5)])
@pytest.mark.parametrize(("protocol", "lost"), [("toshiba", 2), ("modbus-rtu", 1)])
def test_a_lost_answer_does_not_hide_the_only_drive_of_a_line(
    protocol: str, lost: int, numbers: tuple[int, ...]
) -> None:
    """Before all is given up the likely numbers are asked once more at every setting."""
    only = {"number": 5, "model": "vf-nc3", "protocol": protocol, "fault": [{"kind": "drop", "count": lost}]}
    _, result = look([only], Wish("/dev/x", protocols=scan_plan.protocols_of([protocol]), numbers=numbers), baud=9600)
    assert {item[0] for item in found(result)} == {5}


def test_a_late_answer_is_not_taken_for_the_next_number_and_told_of() -> None:
    """A send waiting time, F805, makes a drive slow; --wait-time finds it."""
    slow = modbus(5, registers={"communication_wait_time": 20})
    _, result = look([slow, modbus(9)])
    assert found(result) == [(9, "modbus-rtu", "vf-nc3")]
    assert result.has_late_answers
    assert any("Try --wait-time" in line for line in scan_report.sentences(result))
    _, result = look([slow, modbus(9)], Wish("/dev/x", wait_time=0.2))
    assert [item[0] for item in found(result)] == [5, 9]
    assert 'wait_time = "200ms"  # F805' in scan_report.configuration(result, "/dev/x")


def test_another_master_on_the_line_ends_the_scan() -> None:
    """Two masters cannot work."""

    async def main() -> None:
        stage = Stage(SimulatedLineConfig.model_validate({"drive": [modbus(1)]}), is_pty=False)
        loop = asyncio.get_running_loop()

        async def babble() -> None:
            while True:
                stage.wire.babble(4, loop.time())
                await asyncio.sleep(0.05)

        task = asyncio.create_task(babble())
        try:
            with pytest.raises(BadReply, match="bytes that nobody asked for: another master talks on this line"):
                await scan(Search(Wish("/dev/x"), MODELS, virtual.VirtualClock(), stage, stage.open))
        finally:
            task.cancel()

    virtual.run(main())


def test_a_port_that_cannot_be_opened_says_why() -> None:
    """As the gateway would."""

    async def closed(line: site.Line, clock: Clock) -> Line:
        raise LineDown(f"{line.port}: in use by process 42; two masters on one line cannot work")

    async def main() -> None:
        stage = Stage(SimulatedLineConfig.model_validate({"drive": [modbus(1)]}), is_pty=False)
        with pytest.raises(LineDown, match="in use by process 42"):
            await scan(Search(Wish("/dev/x"), MODELS, virtual.VirtualClock(), stage, closed))

    virtual.run(main())


def test_on_a_pty_one_setting_is_enough_and_said() -> None:
    """The kernel drops its parity."""
    stage, result = look([modbus(1)], is_pty=True, parity="odd")
    assert set(stage.opened) == {Setting(19200, "even")}
    assert found(result) == [(1, "modbus-rtu", "vf-nc3")]
    assert "a pseudo-terminal has no parity" in result.notes[0]


def test_baud_rates_that_are_asked_for_are_tried_on_a_pty_too() -> None:
    """Another program may carry it to a line that has one."""
    wish = Wish("/dev/x", bauds=(9600, 38400), numbers=(9,), is_each_baud=True)
    stage, _ = look([modbus(1)], wish, is_pty=True)
    assert set(stage.opened) == {Setting(9600, "even"), Setting(38400, "even")}


def test_what_was_found_is_a_configuration_that_is_accepted(tmp_path: Path) -> None:
    """The same number in both protocols, number 0, a waiting time: pasted as it is."""
    drives = [toshiba(0, "vf-mb1"), toshiba(5), modbus(5), modbus(1, "vf-mb1"), toshiba(80)]
    _, result = look(drives)
    text = scan_report.configuration(result, "/dev/ttyUSB0")
    built = site.build(tomllib.loads(text), "scan", tmp_path)
    assert {(d.number, d.protocol, d.model.name) for d in built.drives} == set(found(result))
    assert len(result.found) == 5
    assert len({drive.unit for drive in built.drives}) == 5
    assert (built.lines[0].port, built.lines[0].baud, built.lines[0].parity) == ("/dev/ttyUSB0", 19200, "even")


def test_a_drive_of_no_known_model_is_a_comment() -> None:
    """What it says of itself is there, and nothing of it can break the file."""
    _, result = look([modbus(4), modbus(5)])
    strange = result.found[1]
    other = Found(strange.setting, strange.protocol, 9, type(strange.recognised)(None, "2BH: X\n[evil] 1"), {}, {})
    result.found.append(other)
    text = scan_report.configuration(result, "/dev/x")
    assert "# number 9, modbus-rtu: model not known; 2BH: X?[evil] 1" in text
    assert len(tomllib.loads(text)["line"][0]["drive"]) == 2


def test_drives_at_another_setting_are_a_comment() -> None:
    """A port has one setting."""
    _, result = look([modbus(4)])
    one = result.found[0]
    result.found.append(Found(Setting(9600, "odd"), one.protocol, 9, one.recognised, one.facts, one.settings))
    text = scan_report.configuration(result, "/dev/x")
    assert "# number 9 was found at 9600 baud, odd parity: set it to 19200 baud, even parity (F800, F801)" in text
    assert len(tomllib.loads(text)["line"][0]["drive"]) == 1


def test_a_time_out_that_may_act_now_is_told_of() -> None:
    """The scan was a master that went away."""
    _, result = look([modbus(4, registers={"communication_timeout": 20}), modbus(5)])
    four, five = list(scan_report.sentences(result))[1:3]
    assert "F803 is set: it may act now" in four
    assert "F803" not in five
