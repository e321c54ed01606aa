"""When the block is believed: no value of another register, of an old mapping, or of the display."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from gateway.image import LinkState, Quality
from gateway.sim.faults import Fault, Kind
from tests.bus.rig import FIVE, SELECTED, Bench, bench, run

BLOCKS = ("modbus-rtu", "toshiba-binary")
THREE = [{"values": ["output_frequency", "output_current", "output_voltage"], "every": "100ms"}]


def one(protocol: str, polls: Any = None, drive: dict[str, Any] | None = None, **sim: Any) -> Bench:
    """Return a line with one VF-nC3 of which status, a word that is never 0, need not be polled."""
    spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
    simulated = {"number": 1, "model": "vf-nc3", "protocol": spoken, **sim}
    return bench([simulated], polls, drive={"protocol": protocol, **(drive or {})})


class Wrong:
    """Collects the frequencies that were good and not what the motor does."""

    def __init__(self, stage: Bench, tolerance: float = 0.5) -> None:
        self.values: list[tuple[float, float]] = []
        self._stage, self._tolerance = stage, tolerance
        stage.image.by_name["d1"].subscribe(self._look)

    def _look(self, image: Any, names: Any) -> None:
        now = asyncio.get_running_loop().time()
        sample = image.sample("output_frequency", now)
        hertz = sample.word / 100
        if sample.quality is Quality.GOOD and abs(hertz - self._stage.drive.inverter.condition.motor.frequency) > (
            self._tolerance
        ):
            self.values.append((now, hertz))


def turn(stage: Bench, hertz: float) -> None:
    """Have the motor turn at once, as it would after a ramp that nobody saw."""
    stage.drive.inverter.run_by_panel(hertz)
    stage.drive.inverter.condition.motor.frequency = hertz


@pytest.mark.hazard("H19")
@pytest.mark.parametrize("protocol", BLOCKS)
def test_zeros_alone_prove_nothing(protocol: str) -> None:
    """At rest a block that carries nothing agrees with everything: it is not used, and no dummy 0 is published."""

    async def play(stage: Bench) -> None:
        for place, code in enumerate((2, 3, 4), 1):
            stage.drive.set_by_panel(f"block_read_{place}", code)
        await asyncio.sleep(10.0)
        turn(stage, 40.0)
        await asyncio.sleep(1.0)
        wrong = Wrong(stage)
        await asyncio.sleep(60.0)
        assert stage.value("d1", "output_frequency") == "40.00"
        assert not wrong.values
        assert stage.image.by_name["d1"].is_reset_needed

    run(lambda: one(protocol, THREE), play)


@pytest.mark.parametrize("protocol", BLOCKS)
def test_the_block_is_used_once_something_moves(protocol: str) -> None:
    """In force and at rest: single reads until a value leaves 0, then the proof, then the block."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0)
        assert max(len(names) for _, names, _ in stage.applied) < 3
        turn(stage, 40.0)
        await asyncio.sleep(5.0)
        assert max(len(names) for _, names, _ in stage.applied[-10:]) >= 3
        assert not stage.image.by_name["d1"].is_reset_needed

    run(lambda: one(protocol, THREE, block_read=[2, 3, 4]), play)


@pytest.mark.parametrize("protocol", BLOCKS)
def test_a_lost_reset_mark_is_set_again(protocol: str) -> None:
    """The frame that sets FA87 does not arrive: no selector is written before it stands."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(8.0)
        assert stage.drive.inverter.memory.word("reset_detection") == 1
        assert stage.image.by_name["d1"].is_reset_needed
        turn(stage, 40.0)
        await asyncio.sleep(1.0)
        wrong = Wrong(stage)
        await asyncio.sleep(30.0)
        assert not wrong.values

    def built() -> Bench:
        made = one(protocol, THREE, {"provision": True})
        made.wire.faults.add(Fault(Kind.CUT, 1, probability=0.5, until=asyncio.get_running_loop().time() + 1.0))
        return made

    run(built, play)


@pytest.mark.parametrize("protocol", BLOCKS)
def test_a_gateway_that_starts_between_provisioning_and_reset_knows_it(protocol: str) -> None:
    """FA87 is still 1: reset needed, and the block is not believed."""

    async def play(stage: Bench) -> None:
        memory = stage.drive.inverter.memory
        for place, code in enumerate(SELECTED, 1):
            stage.drive.set_by_panel(f"block_read_{place}", code)
        memory.write_ram(memory.named("reset_detection"), 1)
        await asyncio.sleep(5.0)
        assert stage.image.by_name["d1"].is_reset_needed
        assert not memory.eeprom_writes
        wrong = Wrong(stage)
        turn(stage, 40.0)
        await asyncio.sleep(20.0)
        assert stage.value("d1", "output_frequency") == "40.00"
        assert [at for at, _ in wrong.values if at > asyncio.get_running_loop().time() - 19.0] == []

    run(lambda: one(protocol, None, {"provision": True}), play)


@pytest.mark.hazard("H20")
@pytest.mark.parametrize("protocol", BLOCKS)
@pytest.mark.parametrize(
    "text", [(0x00, 0x31, 0x32, 0x00), (0x31, 0x32, 0x33, 0x10), (0, 0, 0, 0), (0x64, 0x41, 0x74, 0x41)]
)
def test_no_text_of_the_display_is_taken_for_a_value(protocol: str, text: tuple[int, ...]) -> None:
    """Blanks, digits, letters and nothing at all, while the motor runs."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(4.0)
        wrong = Wrong(stage)
        for digit, code in enumerate(text, 1):
            stage.drive.set_by_panel(f"led_text_1_digit_{digit}", code)
        stage.drive.set_by_panel("block_mode", 1)
        await asyncio.sleep(10.0)
        assert not wrong.values
        assert stage.value("d1", "output_frequency") == "50.00"

    run(lambda: one(protocol, block_read=SELECTED, running_at=50.0), play)


@pytest.mark.parametrize("protocol", BLOCKS)
def test_the_display_during_the_proof_refutes_nothing(protocol: str) -> None:
    """FA80 = 1 for two seconds at the start: afterwards the block is used, and no reset is asked for."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(0.3)
        stage.drive.set_by_panel("block_mode", 1)
        await asyncio.sleep(2.0)
        stage.drive.set_by_panel("block_mode", 0)
        await asyncio.sleep(20.0)
        assert any(set(FIVE) <= set(names) for _, names, _ in stage.applied[-20:])
        assert not stage.image.by_name["d1"].is_reset_needed

    run(lambda: one(protocol, block_read=SELECTED, running_at=50.0), play)


@pytest.mark.parametrize("protocol", BLOCKS)
def test_small_values_are_published_though_they_look_like_text(protocol: str) -> None:
    """2.00 Hz and a little current: fresh all the time."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0)
        before = len(stage.applied)
        await asyncio.sleep(10.0)
        assert len(stage.applied) - before > 80
        assert stage.value("d1", "output_frequency") == "2.00"

    polls = [{"values": ["output_frequency", "output_current"], "every": "100ms"}]
    run(lambda: one(protocol, polls, block_read=[2, 3], running_at=2.0, load=0.05), play)


@pytest.mark.parametrize("protocol", BLOCKS)
@pytest.mark.parametrize("in_force", [(2, 1, 3, 4, 5), (1, 3, 4, 2, 5), (0, 0, 0, 0, 0)])
def test_a_mapping_that_changes_unseen_is_found_out_soon(protocol: str, in_force: tuple[int, ...]) -> None:
    """A brown-out between two polls puts other selectors in force: right again with the set-up that follows."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0)
        wrong = Wrong(stage)
        force(stage, in_force)
        await asyncio.sleep(10.0)
        span = [at for at, _ in wrong.values]
        assert not span or span[-1] - span[0] <= 1.2
        assert stage.value("d1", "output_frequency") == "40.00"

    def force(stage: Bench, codes: tuple[int, ...]) -> None:
        memory = stage.drive.inverter.memory
        for place, code in enumerate(codes, 1):
            memory._in_force[memory.named(f"block_read_{place}").address] = code

    run(lambda: one(protocol, block_read=SELECTED, running_at=40.0), play)


def test_a_drive_that_does_not_answer_x_is_read_without_it() -> None:
    """Binary has silence for an unknown command: after three of them other reads bring the values."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(8.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert stage.value("d1", "output_frequency") == "40.00"

    def built() -> Bench:
        made = one("toshiba-binary", block_read=SELECTED, running_at=40.0)
        drive = made.wire.drives[0]
        handle = drive.handle

        def deaf_to_x(frame: bytes, now: float) -> tuple[bytes | None, float]:
            return (None, 0.0) if frame[2:3] == b"X" else handle(frame, now)

        drive.handle = deaf_to_x  # type: ignore[method-assign]
        return made

    run(built, play)


def test_trip_code_and_status_that_disagree_do_not_flap() -> None:
    """MODBUS: one sign of a trip is a trip; the line is not kept busy by reading both again and again."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        stage.drive.force("trip_code", 0x18)
        before = stage.drive_stats["d1"].exchanges
        await asyncio.sleep(10.0)
        assert stage.drive_stats["d1"].exchanges - before < 150
        assert stage.image.by_name["d1"].is_tripped is True
        stage.drive.force("trip_code", None)
        await asyncio.sleep(3.0)
        assert stage.image.by_name["d1"].is_tripped is False

    polls = [{"values": ["status"], "every": "200ms"}, {"values": ["trip_code"], "every": "1s"}]
    run(lambda: one("modbus-rtu", polls, running_at=40.0), play)


def test_a_stranger_is_not_called_tripped() -> None:
    """What another drive says is nothing that this one does."""

    async def play(stage: Bench) -> None:
        stage.drive.force("series_code", 7)
        stage.drive.inverter.trip(0x18)
        await asyncio.sleep(5.0)
        assert stage.link("d1") is LinkState.STRANGER
        assert stage.image.by_name["d1"].is_tripped is None

    run(lambda: one("toshiba-binary"), play)


@pytest.mark.hazard("H08")
@pytest.mark.parametrize("protocol", BLOCKS)
def test_a_write_to_the_eeprom_counts_though_its_answer_is_lost(protocol: str) -> None:
    """What may have worn the EEPROM is counted; nothing is worn for a block that is not used."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(20.0)
        drive = stage.drive.inverter.memory.eeprom_writes
        counted = stage.drive_stats["d1"].eeprom_writes
        assert drive
        assert all(counted[address] >= writes for address, writes in drive.items())

    def built() -> Bench:
        made = one(protocol, None, {"provision": True}, running_at=40.0)
        made.wire.faults.add(Fault(Kind.DROP, 1, probability=0.3))
        return made

    run(built, play)


def test_selectors_are_not_written_for_a_block_that_would_not_be_used() -> None:
    """One value often and one seldom: single reads are cheaper."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0)
        assert not stage.drive.inverter.memory.eeprom_writes
        assert not stage.image.by_name["d1"].is_reset_needed

    polls = [{"values": ["output_frequency"], "every": "100ms"}, {"values": ["output_current"], "every": "10s"}]
    run(lambda: one("modbus-rtu", polls, {"provision": True}, running_at=40.0), play)
