"""Run commands that go in the one frame which also reads the block, where the drive surely has it."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from itertools import pairwise
from typing import Any

import pytest

from gateway.control.carrying import TRIAL, Carrying, Form, selected
from gateway.control.carrying import Stage as Step
from gateway.control.command import Reason, Status, Verb
from gateway.protocol.pdu import ReadBlock, Request
from gateway.protocol.registry import PROTOCOLS
from gateway.sim.faults import Fault, Kind
from gateway.sim.journal import Way
from tests.control.test_control_line import PLC, Stage, started
from tests.control.test_control_line import play as play_on_line

EXCHANGE, WRITE, READ = 0x17, 0x06, 0x03
COMMAND, FREQUENCY = "command", "frequency_command"
FA00, FA01 = 0xFA00, 0xFA01
RUN_AT_40 = (0xC400, 4000)


def play(script: Callable[[Stage], Awaitable[None]], block_write: list[int], **more: Any) -> None:
    """Run a script against one VF-nC3 with these F870 and F871 in force."""
    control = {"block_write": True, **more.pop("control", {})}
    play_on_line(script, control, block_write=block_write, **more)


def word(stage: Stage, name: str) -> int:
    """Return a register of the drive."""
    return stage.bench.drive.inverter.memory.word(name)


def sent(stage: Stage, since: float) -> list[bytes]:
    """Return the frames that the gateway has sent since then."""
    return [e.data for e in stage.bench.wire.journal.last(5000) if e.way is Way.REQUEST and e.begin >= since]


def now() -> float:
    """Return the virtual time."""
    return asyncio.get_running_loop().time()


def step(stage: Stage) -> Step:
    """Return how far the drive's exchange is proven."""
    return stage.door.controls["d1"].state.carrying.stage


async def armed(stage: Stage) -> None:
    """Take and arm."""
    assert (await stage.ask(Verb.TAKE)).status is Status.DONE
    assert (await stage.ask(Verb.ARM)).status is Status.DONE


def test_frequency_run_and_five_values_go_in_one_frame() -> None:
    """17H instead of 06, 06 and 03; both words are read back, and the block is the poll that was due."""

    async def script(stage: Stage) -> None:
        await armed(stage)
        assert step(stage) is Step.PROVEN
        begun, polls = now(), stage.bench.image.by_name["d1"].version
        assert (await stage.ask(Verb.RUN, value="40")).status is Status.DONE
        frames = sent(stage, begun)
        assert [frame[1] for frame in frames if frame[1] in (EXCHANGE, WRITE)] == [EXCHANGE]
        assert frames[0][1] == READ  # FA87: the drive was not reset meanwhile
        assert stage.results[-1].raw == dict(zip((FREQUENCY, COMMAND), (4000, 0xC400), strict=True))
        assert stage.results[-1].read_back == {FREQUENCY: 4000, COMMAND: 0xC400}
        assert stage.bench.image.by_name["d1"].version > polls
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
            words = (0xC400, 3000 + cycle)
            result = await stage.ask(Verb.WORDS, PLC, address=FA00, words=words)
            assert result.status is Status.DONE, result
            await asyncio.sleep(0.2)
        functions = Counter(frame[1] for frame in sent(stage, begun))
        assert functions[EXCHANGE] == 20
        assert functions[WRITE] == 0
        assert word(stage, FREQUENCY) == 3019
        applied = [when for _, names, when in stage.bench.applied if "output_voltage" in names and when > begun]
        assert max(b - a for a, b in pairwise(applied)) < 0.25

    play(script, [1, 3])


@pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-binary"])
def test_the_command_alone_goes_with_a_poll_that_is_due(protocol: str) -> None:
    """F870 = 1, F871 = 0: run at the frequency that the drive has."""

    async def script(stage: Stage) -> None:
        await armed(stage)
        assert step(stage) is Step.PROVEN
        assert (await stage.ask(Verb.RUN)).status is Status.DONE
        assert word(stage, COMMAND) == 0x8400

    play(script, [1, 0], protocol=protocol)


def test_what_the_trial_writes_is_gone_when_the_drive_is_armed() -> None:
    """FA00 and FA01 are as they were, and the motor never moved."""

    async def script(stage: Stage) -> None:
        memory = stage.bench.drive.inverter.memory
        memory.write_ram(memory.named(FREQUENCY), 1234)
        begun = now()
        await armed(stage)
        exchanges = [frame for frame in sent(stage, begun) if frame[1] == EXCHANGE]
        assert [frame[-6:-2].hex() for frame in exchanges] == ["00040008", "000004d2"]
        assert (word(stage, COMMAND), word(stage, FREQUENCY)) == (0, 1234)
        assert stage.hertz == 0.0

    play(script, [1, 3])


@pytest.mark.parametrize("in_force", [[3, 1], [5, 3], [1, 4], [2, 3], []])
def test_selectors_that_are_not_in_force_are_found_out_harmlessly(in_force: list[int]) -> None:
    """Set at the panel without a reset: commands go by single writes, and nothing moves or trips before."""

    async def script(stage: Stage) -> None:
        stage.bench.drive.set_by_panel("block_write_1", 1)
        stage.bench.drive.set_by_panel("block_write_2", 3)
        await asyncio.sleep(61.0)  # the gateway looks at them once a minute
        begun = now()
        await armed(stage)
        assert step(stage) is Step.GIVEN_UP
        assert (word(stage, COMMAND), word(stage, FREQUENCY)) == (0, 0)
        assert stage.hertz == 0.0
        assert not stage.bench.drive.inverter.condition.is_tripped
        assert (await stage.ask(Verb.RUN, value="30")).status is Status.DONE
        assert sum(frame[1] == EXCHANGE for frame in sent(stage, begun)) == 1  # the trial's only
        await stage.beat_for(6.0)
        assert stage.hertz == 30.0

    play(script, in_force)


@pytest.mark.parametrize(
    ("block_write", "more"),
    [
        ([], {}),
        ([3, 0], {}),  # a frequency alone: who resets the drive may have changed F870 meanwhile
        ([1, 1], {}),
        ([1, 2], {}),
        ([1, 3], {"control": {"block_write": False}}),
        ([1, 3], {"protocol": "toshiba-ascii"}),
        ([1, 3], {"protocol": "toshiba-binary"}),  # X: one word may be taken, and the other refused
    ],
)
def test_where_no_exchange_carries_commands_none_is_tried(block_write: list[int], more: dict[str, Any]) -> None:
    """They are written one by one, and nothing else is written."""

    async def script(stage: Stage) -> None:
        await started(stage, "30")
        assert step(stage) is Step.UNTRIED
        frames = sent(stage, 0.0)
        assert not [frame for frame in frames if frame[1] == EXCHANGE and "protocol" not in more]
        assert word(stage, FREQUENCY) == 3000

    play(script, block_write, **more)


def test_a_motor_that_its_panel_runs_is_not_tried_on() -> None:
    """FA00 is 0 and the motor turns: it keeps turning, and FA01 is left as it is."""

    async def script(stage: Stage) -> None:
        stage.bench.drive.inverter.run_by_panel(20.0)
        await asyncio.sleep(2.0)
        begun = now()
        await armed(stage)
        assert step(stage) is Step.GIVEN_UP
        assert not [frame for frame in sent(stage, begun) if frame[1] == EXCHANGE]

    play(script, [1, 3])


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


@pytest.mark.parametrize("which", range(6))
def test_a_trial_frame_that_is_lost_leaves_nothing_behind(which: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever answer is lost: the drive is armed without it, FA00 and FA01 are as they were."""

    async def script(stage: Stage) -> None:
        memory = stage.bench.drive.inverter.memory
        memory.write_ram(memory.named(FREQUENCY), 1234)
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        lose_trial_frame(stage, which, monkeypatch)
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        assert step(stage) is Step.GIVEN_UP
        assert (word(stage, COMMAND), word(stage, FREQUENCY)) == (0, 1234)
        assert stage.hertz == 0.0

    play(script, [1, 3])


def lose_trial_frame(stage: Stage, which: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the answer to the frame of the trial with that place dropped."""
    place = iter(range(100))
    unchanged = Carrying.next_step

    def losing(carrying: Carrying, facts: Mapping[str, int]) -> Request | None:
        request = unchanged(carrying, facts)
        if request is not None and next(place) == which:
            stage.bench.wire.faults.add(Fault(Kind.DROP, 1, count=1))
        return request

    monkeypatch.setattr(Carrying, "next_step", losing)


@pytest.mark.parametrize("which", range(1, 6))
def test_a_stop_in_the_middle_of_a_trial_goes_first_and_the_next_arming_puts_all_right(which: int) -> None:
    """What the trial has overwritten is remembered."""

    async def script(stage: Stage) -> None:
        memory = stage.bench.drive.inverter.memory
        memory.write_ram(memory.named(FREQUENCY), 1234)
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        control = stage.door.controls["d1"]
        arming = asyncio.ensure_future(stage.ask(Verb.ARM))
        seen: list[Step] = []
        order = [Step.TRIAL, Step.CHECKING, Step.RESTORING, Step.RESTORED, Step.PROVEN]
        while control.state.carrying.stage is not order[which - 1]:
            await asyncio.sleep(0.002)
            seen.append(control.state.carrying.stage)
        assert (await stage.ask(Verb.STOP)).status is Status.DONE
        await arming
        assert word(stage, COMMAND) & 0x0400 == 0
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        assert word(stage, FREQUENCY) == 1234

    play(script, [1, 3])


@pytest.mark.hazard("H12")
def test_a_drive_that_was_reset_is_tried_again() -> None:
    """A brown-out that nobody commands through: the exchange has to be proven anew."""

    async def script(stage: Stage) -> None:
        await started(stage, "30")
        stage.bench.drive.inverter.reset(now(), 0.05)
        await stage.beat_for(5.0)
        assert step(stage) is not Step.PROVEN
        assert word(stage, COMMAND) == 0
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        assert step(stage) is Step.PROVEN

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
        ((COMMAND, ""), True, True),
        (("", COMMAND), True, True),
        ((FREQUENCY, ""), False, False),
        ((COMMAND, COMMAND), False, False),
        ((COMMAND, "terminal_output"), False, False),
        (("", ""), False, False),
        ((), False, False),
    ],
)
def test_which_blocks_carry_commands(names: tuple[str, ...], *, in_rtu: bool, in_binary: bool) -> None:
    """The command has to be in it; two words only where the drive takes both or none."""
    form = Form(ReadBlock(1, 0x1875, 5), names)
    assert form.is_usable(PROTOCOLS["modbus-rtu"]) is in_rtu
    assert form.is_usable(PROTOCOLS["toshiba-binary"]) is in_binary


def test_another_form_has_to_be_proven_anew() -> None:
    """As after F879 was changed, or FA80."""

    async def script(stage: Stage) -> None:
        await armed(stage)
        carrying: Carrying = stage.door.controls["d1"].state.carrying
        form = carrying.form
        assert form is not None
        carrying.offer(form)
        assert step(stage) is Step.PROVEN
        carrying.offer(None)
        assert step(stage) is Step.UNTRIED

    play(script, [1, 3])


def test_the_words_of_the_trial_set_nothing_in_motion() -> None:
    """Bits that neither run, jog, stop nor reset, and no bit of a terminal."""
    from gateway.drives.catalogue import load

    model = load()["vf-nc3"]
    for value in TRIAL.values():
        names = {name for bit, name in model.registers[COMMAND].bits.items() if value >> bit & 1}
        assert all(name.startswith("preset_speed") for name in names)
        assert not any(value >> bit & 1 for bit in model.registers["terminal_output"].bits)

