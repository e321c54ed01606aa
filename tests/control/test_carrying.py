"""Run commands that go in the one frame which also reads the block, where the drive surely has it."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from itertools import pairwise
from typing import Any

import pytest

from gateway.app import App
from gateway.bus.trial import COMMAND_WORD, FREQUENCY_WORDS, Trial
from gateway.bus.work import Work
from gateway.control.carrying import Form, selected
from gateway.control.command import Reason, Status, Verb
from gateway.control.ledger import MemoryLedger
from gateway.drives.catalogue import load
from gateway.image import LinkState
from gateway.protocol.pdu import ReadBlock
from gateway.protocol.registry import PROTOCOLS
from gateway.sim.condition import TripCode
from gateway.sim.faults import Fault, Kind
from gateway.sim.journal import Way
from tests.bus.rig import SELECTED, Bench, bench, run
from tests.control.test_control_line import PLC, Stage, started
from tests.control.test_control_line import play as play_on_line
from tests.virtual import VirtualClock
from tests.virtual import run as virtual_run

EXCHANGE, WRITE, READ = 0x17, 0x06, 0x03
COMMAND, FREQUENCY = "command", "frequency_command"
FA00, FA01 = 0xFA00, 0xFA01
OTHERS = ("command_2", "terminal_output", "analog_output")


def play(script: Callable[[Stage], Awaitable[None]], block_write: list[int], **more: Any) -> None:
    """Run a script against one VF-nC3 with these F870 and F871 in force."""
    control = {"block_write": True, **more.pop("control", {})}
    play_on_line(script, control, block_write=block_write, **more)


def word(stage: Stage | Bench, name: str) -> int:
    """Return a register of the drive."""
    made = stage.bench if isinstance(stage, Stage) else stage
    return made.drive.inverter.memory.word(name)


def put(stage: Stage | Bench, words: Mapping[str, int]) -> None:
    """Write registers of the drive, as somebody else does."""
    memory = (stage.bench if isinstance(stage, Stage) else stage).drive.inverter.memory
    for name, each in words.items():
        memory.write_ram(memory.named(name), each)


def sent(stage: Stage | Bench, since: float) -> list[bytes]:
    """Return the frames that the gateway has sent since then."""
    wire = (stage.bench if isinstance(stage, Stage) else stage).wire
    return [e.data for e in wire.journal.last(5000) if e.way is Way.REQUEST and e.begin >= since]


def now() -> float:
    """Return the virtual time."""
    return asyncio.get_running_loop().time()


def is_proven(stage: Stage) -> bool:
    """Say whether commands may go with the block."""
    return stage.door.controls["d1"].state.carrying.form is not None


async def armed(stage: Stage) -> None:
    """Take and arm."""
    assert (await stage.ask(Verb.TAKE)).status is Status.DONE
    assert (await stage.ask(Verb.ARM)).status is Status.DONE


def test_frequency_run_and_five_values_go_in_one_frame() -> None:
    """17H instead of 06, 06 and 03; both words are read back, and the block is the poll that was due."""

    async def script(stage: Stage) -> None:
        await armed(stage)
        assert is_proven(stage)
        begun, seen = now(), stage.bench.image.by_name["d1"].version
        assert (await stage.ask(Verb.RUN, value="40")).status is Status.DONE
        frames = sent(stage, begun)
        assert [frame[1] for frame in frames if frame[1] in (EXCHANGE, WRITE)] == [EXCHANGE]
        assert frames[0][1] == READ  # FA87: the drive was not reset meanwhile
        assert stage.results[-1].raw == {FREQUENCY: 4000, COMMAND: 0xC400}
        assert stage.results[-1].read_back == {FREQUENCY: 4000, COMMAND: 0xC400}
        assert stage.bench.image.by_name["d1"].version > seen
        await stage.beat_for(6.0)
        assert stage.hertz == 40.0

    play(script, [1, 3])


def test_a_plc_that_writes_both_words_each_cycle_keeps_the_polls_on_time() -> None:
    """The stream of its commands brings the block; hardly a poll is made beside it, and none is missed."""

    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE, PLC)).status is Status.DONE
        assert (await stage.ask(Verb.ARM, PLC)).status is Status.DONE
        begun = now()
        for cycle in range(20):
            stage.door.beat("d1", PLC, cycle)
            result = await stage.ask(Verb.WORDS, PLC, address=FA00, words=(0xC400, 3000 + cycle))
            assert result.status is Status.DONE, result
            await asyncio.sleep(0.2)
        functions = Counter(frame[1] for frame in sent(stage, begun))
        assert functions[EXCHANGE] == 20
        assert functions[WRITE] == 0
        assert word(stage, FREQUENCY) == 3019
        applied = [when for _, names, when in stage.bench.applied if "output_voltage" in names and when > begun]
        assert max(b - a for a, b in pairwise(applied)) < 0.25

    play(script, [3, 1])


def test_a_trip_is_seen_in_the_block_that_a_command_brings() -> None:
    """A stream of commands leaves no time for polls: the drive is disarmed all the same."""

    async def script(stage: Stage) -> None:
        await started(stage)
        stage.bench.drive.inverter.trip(TripCode.EMERGENCY)
        begun = now()
        while ("d1", "disarmed", "the drive has tripped") not in stage.events:
            await stage.ask(Verb.RUN, value="30")
            assert now() < begun + 0.3

    play(script, [1, 3])


def test_the_command_alone_goes_with_a_poll_that_is_due() -> None:
    """X, F870 = 1, F871 = 0: run at the frequency that the drive has."""

    async def script(stage: Stage) -> None:
        await armed(stage)
        assert is_proven(stage)
        assert (await stage.ask(Verb.RUN)).status is Status.DONE
        assert word(stage, COMMAND) == 0x8400

    play(script, [1, 0], protocol="toshiba-binary")


def test_what_the_trial_writes_is_gone_before_anybody_can_command() -> None:
    """FA00 and FA01 are as they were, the motor never moved, and the words were harmless ones."""

    async def watch(stage: Bench) -> None:
        put(stage, {FREQUENCY: 1234})
        seen: set[tuple[int, int]] = set()
        while stage.link("d1") is not LinkState.ONLINE:
            await asyncio.sleep(0.002)
            seen.add((word(stage, COMMAND), word(stage, FREQUENCY)))
            assert stage.drive.inverter.condition.motor.frequency == 0.0
        assert (COMMAND_WORD, FREQUENCY_WORDS[0]) in seen
        assert (word(stage, COMMAND), word(stage, FREQUENCY)) == (0, 1234)
        assert [frame[-6:-2].hex() for frame in sent(stage, 0.0) if frame[1] == EXCHANGE] == ["00040008"]

    watched(watch, [1, 3])


def watched(watch: Callable[[Bench], Awaitable[None]], block_write: list[int]) -> None:
    """Run a script from the first frame on, against one VF-nC3 that may be commanded."""
    drive = {"number": 1, "model": "vf-nc3", "block_read": SELECTED, "block_write": block_write}
    run(lambda: bench([drive], drive={"block_write": True, "control": "direct"}), watch)


@pytest.mark.parametrize("in_force", [[3, 1], [5, 3], [1, 4], [2, 3], [4, 5], [1, 0], []])
def test_selectors_that_are_not_in_force_are_found_out_harmlessly(in_force: list[int]) -> None:
    """Set at the panel without a reset: whatever the trial reaches is as it was, and nothing moves or trips."""

    async def watch(stage: Bench) -> None:
        before = {FREQUENCY: FREQUENCY_WORDS[0], COMMAND: 0, "terminal_output": 1, "analog_output": 500}
        put(stage, before)
        stage.drive.set_by_panel("block_write_1", 1)
        stage.drive.set_by_panel("block_write_2", 3)
        while stage.link("d1") is not LinkState.ONLINE:
            await asyncio.sleep(0.002)
            assert stage.drive.inverter.condition.motor.frequency == 0.0
        assert {name: word(stage, name) for name in before} == before
        assert not stage.drive.inverter.condition.is_tripped
        assert sum(frame[1] == EXCHANGE for frame in sent(stage, 0.0)) == 1
        assert stage.worker is not None
        assert stage.worker._stations["d1"].reader.form is None

    watched(watch, in_force)


@pytest.mark.parametrize(
    ("block_write", "more"),
    [
        ([], {}),
        ([3, 0], {}),  # a frequency alone: who resets the drive may have changed F870 meanwhile
        ([1, 0], {}),  # 17H writes two words: what F871 in force selects would be written as well
        ([1, 1], {}),
        ([1, 2], {}),
        ([1, 3], {"control": {"block_write": False}}),
        ([1, 3], {"protocol": "toshiba-ascii"}),
        ([1, 3], {"protocol": "toshiba-binary"}),  # X: one word may be taken, and the other refused
        ([0, 1], {"protocol": "toshiba-binary"}),
    ],
)
def test_where_no_exchange_carries_commands_none_is_tried(block_write: list[int], more: dict[str, Any]) -> None:
    """They are written one by one, and nothing else is written."""

    async def script(stage: Stage) -> None:
        assert not is_proven(stage)
        await started(stage, "30")
        assert not [frame for frame in sent(stage, 0.0) if frame[1] == EXCHANGE and "protocol" not in more]
        assert word(stage, FREQUENCY) == 3000

    play(script, block_write, **more)


@pytest.mark.parametrize("how", ["by its panel", "by somebody's command"])
def test_a_motor_that_runs_is_not_tried_on(how: str) -> None:
    """It keeps turning, FA01 is left as it is, and commands go by single writes."""

    async def watch(stage: Bench) -> None:
        if how == "by its panel":
            stage.drive.inverter.run_by_panel(20.0)
        else:
            put(stage, {FREQUENCY: 2000, COMMAND: 0xC400})
        await asyncio.sleep(4.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert stage.drive.inverter.condition.motor.frequency == 20.0
        assert not [frame for frame in sent(stage, 0.0) if frame[1] == EXCHANGE]

    watched(watch, [1, 3])


def test_stops_go_by_themselves() -> None:
    """The shortest frame there is."""

    async def script(stage: Stage) -> None:
        await started(stage, "30")
        begun = now()
        assert (await stage.ask(Verb.STOP)).status is Status.DONE
        assert not [frame for frame in sent(stage, begun) if frame[1] == EXCHANGE]

    play(script, [1, 3])


def test_a_word_out_of_range_is_told_by_the_drive() -> None:
    """17H takes both words or none (error 03); single writes tell which one, and later ones go together."""

    async def script(stage: Stage) -> None:
        await started(stage, "30")
        result = await stage.ask(Verb.RUN, value="50")
        assert (result.status, result.reason) == (Status.FAILED, Reason.REFUSED_BY_DRIVE)
        assert FREQUENCY in result.text
        assert word(stage, FREQUENCY) == 3000
        begun = now()
        assert (await stage.ask(Verb.RUN, value="35")).status is Status.DONE
        assert EXCHANGE in [frame[1] for frame in sent(stage, begun)]

    play(script, [1, 3], maximum_frequency=40.0)


def faulty(monkeypatch: pytest.MonkeyPatch, places: range, do: Callable[[], None]) -> None:
    """Do something when the frames of a trial with these places are chosen."""
    chosen = iter(range(10_000))
    unchanged = Trial.next

    def watching(trial: Trial) -> Work | None:
        step = unchanged(trial)
        if step is not None and next(chosen) in places:
            do()
        return step

    monkeypatch.setattr(Trial, "next", watching)


@pytest.mark.unmeasured
@pytest.mark.parametrize("which", range(16))
@pytest.mark.parametrize("times", [1, 3])
def test_a_trial_frame_that_is_lost_leaves_nothing_behind(
    which: int, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever answer is lost, once or so often that it is given up: FA00 and FA01 are as they were."""

    async def watch(stage: Bench) -> None:
        put(stage, {FREQUENCY: 1234})
        lose = range(which, which + times)
        faulty(monkeypatch, lose, lambda: stage.wire.faults.add(Fault(Kind.DROP, 1, count=1)))
        await asyncio.sleep(15.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert (word(stage, COMMAND), word(stage, FREQUENCY)) == (0, 1234)
        assert stage.drive.inverter.condition.motor.frequency == 0.0

    watched(watch, [1, 3])


@pytest.mark.parametrize("which", range(5, 16))
def test_a_trial_that_a_dead_line_breaks_off_is_put_right_when_it_is_back(
    which: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the trial has overwritten is remembered; then the exchange is proven after all."""

    async def watch(stage: Bench) -> None:
        put(stage, {FREQUENCY: 1234})
        faulty(monkeypatch, range(which, which + 1), stage.unplug)
        await asyncio.sleep(3.0)
        stage.is_plugged = True
        await asyncio.sleep(15.0)
        assert (word(stage, COMMAND), word(stage, FREQUENCY)) == (0, 1234)
        assert stage.worker is not None
        assert stage.worker._stations["d1"].reader.form is not None

    watched(watch, [1, 3])


@pytest.mark.parametrize("which", range(5, 16))
def test_a_gateway_that_is_ended_within_a_trial_ends_it_first(which: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGTERM at any frame of it: the port closes when FA00 and FA01 are as they were."""
    drive = {"number": 1, "model": "vf-nc3", "block_read": SELECTED, "block_write": [1, 3]}

    async def main() -> None:
        made = bench([drive], drive={"block_write": True, "control": "direct"})
        app = App(made.configured, VirtualClock(), made.open, MemoryLedger())
        put(made, {FREQUENCY: 1234})
        seen: list[int] = []

        def end() -> None:
            seen.append(word(made, FREQUENCY))
            app.end()

        faulty(monkeypatch, range(which, which + 1), end)
        await app.run()
        assert seen == [FREQUENCY_WORDS[0] if 7 <= which <= 13 else 1234]  # from the exchange to its undoing
        assert (word(made, COMMAND), word(made, FREQUENCY)) == (0, 1234)

    virtual_run(main())


@pytest.mark.hazard("H29")
@pytest.mark.parametrize("which", range(16))
def test_a_stop_in_the_middle_of_a_trial_goes_first_and_stands(which: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """FA00 is the stop's own afterwards; FA01 is as it was."""

    async def script(stage: Stage) -> None:
        put(stage, {FREQUENCY: 1234})
        asked: list[asyncio.Task[Any]] = []
        faulty(
            monkeypatch,
            range(which, which + 1),
            lambda: asked.append(asyncio.ensure_future(stage.ask(Verb.COAST))),
        )
        stage.bench.unplug()
        stage.bench.is_plugged = True
        await asyncio.sleep(8.0)
        (stop,) = asked
        assert (await stop).status is Status.DONE
        assert word(stage, COMMAND) == 0x8800
        assert word(stage, FREQUENCY) == 1234

    play(script, [1, 3])


@pytest.mark.hazard("H12")
def test_a_drive_that_was_reset_is_tried_again() -> None:
    """A brown-out: the exchange has to be proven anew, and is; nothing that was commanded before comes back."""

    async def script(stage: Stage) -> None:
        await armed(stage)
        stage.bench.drive.inverter.reset(now(), 0.05)
        await asyncio.sleep(1.0)
        assert not is_proven(stage)
        await stage.beat_for(5.0)
        assert (word(stage, COMMAND), word(stage, FREQUENCY)) == (0, 0)
        assert is_proven(stage)

    play(script, [1, 3])


@pytest.mark.hazard("H12")
def test_a_stop_that_is_owed_to_a_reset_drive_stands() -> None:
    """It comes before the trial, which is then not made: FA00 is the stop's."""

    async def script(stage: Stage) -> None:
        await started(stage, "30")
        stage.bench.drive.inverter.reset(now(), 0.05)
        await asyncio.sleep(6.0)  # the lease ends, too
        assert (word(stage, COMMAND), word(stage, FREQUENCY)) == (0xC000, 0)
        assert not is_proven(stage)

    play(script, [1, 3])


def test_a_lost_link_without_a_reset_keeps_what_was_proven() -> None:
    """FA87 tells: a drive that stands behind its stop, FA00 not 0, is not tried again, and need not be."""

    async def script(stage: Stage) -> None:
        await started(stage, "30")
        assert (await stage.ask(Verb.STOP)).status is Status.DONE
        begun = now()
        stage.bench.unplug()
        stage.bench.is_plugged = True
        await asyncio.sleep(5.0)
        assert is_proven(stage)
        assert not [frame for frame in sent(stage, begun) if frame[1] == EXCHANGE]

    play(script, [1, 3])


def test_selectors_that_somebody_changes_end_it() -> None:
    """Found within a minute; what is in force then is found out when the drive was away."""

    async def script(stage: Stage) -> None:
        assert is_proven(stage)
        stage.bench.drive.set_by_panel("block_write_2", 4)
        await asyncio.sleep(62.0)
        assert not is_proven(stage)
        stage.bench.drive.set_by_panel("block_write_2", 3)
        await asyncio.sleep(62.0)
        assert not is_proven(stage)
        stage.bench.drive.inverter.reset(now(), 0.0)
        await asyncio.sleep(8.0)
        assert is_proven(stage)

    play(script, [1, 3])


# ---- the pure parts


def test_selectors_that_are_not_known_select_nothing() -> None:
    """Unread, or a code that the model has not."""
    names = {0: "", 1: COMMAND, 3: FREQUENCY}
    assert selected([1, 3], names) == (COMMAND, FREQUENCY)
    assert selected([1, 9], names) == ()
    assert selected([1, None], names) == ()
    assert selected([], names) == ()


@pytest.mark.parametrize(
    ("names", "in_rtu", "in_binary"),
    [
        ((COMMAND, FREQUENCY), True, False),
        ((FREQUENCY, COMMAND), True, False),
        ((COMMAND, ""), False, True),
        (("", COMMAND), False, False),
        ((FREQUENCY, ""), False, False),
        ((COMMAND, COMMAND), False, False),
        ((COMMAND, "terminal_output"), False, False),
        (("", ""), False, False),
        ((), False, False),
    ],
)
def test_which_blocks_carry_commands(names: tuple[str, ...], *, in_rtu: bool, in_binary: bool) -> None:
    """The command has to be in it; two words only where the drive takes both or none."""
    form = Form(ReadBlock(1, 0x1875, 5), 0x1870, names)
    assert form.is_usable(PROTOCOLS["modbus-rtu"]) is in_rtu
    assert form.is_usable(PROTOCOLS["toshiba-binary"]) is in_binary


def test_the_words_of_the_trial_set_nothing_in_motion() -> None:
    """Bits that neither run, jog, stop nor reset, and no bit of a terminal."""
    for model in (load()["vf-nc3"], load()["vf-mb1"]):
        for value in (COMMAND_WORD, *FREQUENCY_WORDS):
            names = {name for bit, name in model.registers[COMMAND].bits.items() if value >> bit & 1}
            assert all(name.startswith("preset_speed") for name in names)
            assert not value & model.registers["terminal_output"].mask
            assert not value & model.registers["command_2"].mask
