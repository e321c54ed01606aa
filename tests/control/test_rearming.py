"""What may have changed in a drive while nobody looked: it is read again before the drive is armed."""

from __future__ import annotations

import asyncio
from decimal import Decimal

import pytest

from gateway.control.command import Command, Reason, Status, Verb
from gateway.control.resets import MARK_AGAIN, MARK_EVERY
from gateway.control.state import Standing
from gateway.control.timeout_looks import LOOK_EVERY
from gateway.errors import Refusal
from gateway.protocol.checksum import crc16
from tests.control.test_control_line import DASHBOARD, Stage, play, started

OVERLOAD = 0x0D  # FC90: OL1
SELDOM = [{"values": ["status"], "every": "5s", "max_age": "20s"}]
ALL = ["modbus-rtu", "toshiba-ascii", "toshiba-binary"]
TOSHIBA = ALL[1:]
LONG = {"poll": SELDOM, "communication_timeout": "10s"}  # F803 by P: gone after a reset


async def reset_unseen(stage: Stage) -> None:
    """Reset the drive just behind a poll, so that it is back before the next one."""
    heard = stage.bench.drive_stats["d1"]
    before = heard.last_heard
    while heard.last_heard == before:
        await asyncio.sleep(0.01)
    stage.bench.drive.inverter.reset(asyncio.get_running_loop().time())


@pytest.mark.hazard("H06", "H07")
@pytest.mark.parametrize("protocol", TOSHIBA)
def test_a_drive_that_was_reset_while_disarmed_is_not_armed_on_old_facts(protocol: str) -> None:
    """F803 is off again, and the gateway remembers 10 s: it looks, before it permits motion."""

    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        await asyncio.sleep(3.0)  # the lease ends, nothing moves
        await reset_unseen(stage)
        await asyncio.sleep(1.5)
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        refused = await stage.ask(Verb.ARM)
        assert (refused.status, refused.reason) == (Status.REFUSED, Reason.NO_WATCHDOG)

    play(script, LONG, protocol=protocol)


@pytest.mark.hazard("H06", "H07")
@pytest.mark.parametrize("protocol", ALL)
def test_a_drive_that_was_armed_once_and_was_reset_since_is_set_up_anew(protocol: str) -> None:
    """FA87 says so when it is to be armed again."""

    async def script(stage: Stage) -> None:
        await started(stage)
        assert (await stage.ask(Verb.RELEASE)).status is Status.DONE
        await asyncio.sleep(6.0)
        await reset_unseen(stage)
        await asyncio.sleep(1.5)
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        refused = await stage.ask(Verb.ARM)
        assert (refused.status, refused.text) == (Status.REFUSED, "the drive was reset")
        await stage.beat_for(3.0)
        assert (await stage.ask(Verb.ARM)).status is Status.DONE

    play(script, LONG, protocol=protocol)


@pytest.mark.hazard("H06")
@pytest.mark.parametrize("protocol", ALL)
def test_a_trip_that_is_over_was_ended_by_a_reset(protocol: str) -> None:
    """The drive is observed anew: its F803 is set again, and its command word is known to be 0."""

    async def script(stage: Stage) -> None:
        await started(stage)
        inverter = stage.bench.drive.inverter
        inverter.trip(OVERLOAD)
        await stage.beat_for(6.0)
        beating = asyncio.create_task(stage.beat_for(20.0))
        await reset_unseen(stage)
        await asyncio.sleep(12.0)
        control = stage.door.controls["d1"]
        assert control.state.is_online
        assert control.facts["command"] == 0
        assert stage.bench.drive.inverter.memory.word("communication_timeout") == 100
        beating.cancel()

    play(script, LONG, protocol=protocol)


@pytest.mark.hazard("H06")
@pytest.mark.parametrize(("name", "value"), [("communication_timeout", "0"), ("timeout_action", "0")])
@pytest.mark.parametrize("control", [{}, {"communication_timeout": None, "timeout_action": None}])
def test_a_controller_cannot_switch_off_what_would_stop_the_motor(
    name: str, value: str, control: dict[str, None]
) -> None:
    """Configured or not: F803 and F804 stay such that the drive stops."""
    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        refused = await stage.ask(Verb.SET, name=name, value=value)
        assert (refused.status, refused.reason) == (Status.REFUSED, Reason.FORBIDDEN)
        assert (await stage.ask(Verb.ARM)).status is Status.DONE

    registers = {"communication_timeout": 15, "timeout_action": 2}
    play(script, {**control, "allow_stored": True}, registers=registers)


@pytest.mark.hazard("H06")
def test_no_motor_is_run_where_the_time_out_is_seen_to_be_off() -> None:
    """Whoever has switched it off: the drive is disarmed as soon as that is read back."""

    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        stage.door.controls["d1"].state.facts["communication_timeout"] = 0
        refused = await stage.ask(Verb.RUN, value="20")
        assert (refused.status, refused.reason) == (Status.REFUSED, Reason.NO_WATCHDOG)

    play(script)


@pytest.mark.hazard("H12", "H31")
def test_a_frequency_from_before_that_is_out_of_range_does_not_come_back() -> None:
    """Bit 14 is still latched and FA01 is 79 Hz: run wants a frequency; where it is in range it is taken."""

    async def script(stage: Stage) -> None:
        memory = stage.bench.drive.inverter.memory
        memory.set_by_panel("frequency_command", 7900)
        memory.set_by_panel("command", 0xC000)
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        refused = await stage.ask(Verb.RUN)
        assert (refused.status, refused.reason) == (Status.REFUSED, Reason.RANGE)
        refused = await stage.ask(Verb.WORDS, address=0xFA00, words=(0xC400,))
        assert (refused.status, refused.reason) == (Status.REFUSED, Reason.RANGE)
        assert (await stage.ask(Verb.RUN, value="20")).status is Status.DONE

    play(script)


def say_unable(stage: Stage, address: int, count: int) -> None:
    """Let the drive say that it cannot tell a register just now, so many times."""
    drive = stage.bench.wire.drives[0]
    answer, left = drive.handle, [count]

    def handle(frame: bytes, now: float) -> tuple[bytes | None, float]:
        if left[0] and frame[1:4] == bytes((0x03, *address.to_bytes(2, "big"))):
            left[0] -= 1
            refusal = bytes((frame[0], 0x83, 0x04))
            return refusal + crc16(refusal), 0.005
        return answer(frame, now)

    drive.handle = handle  # type: ignore[method-assign]  # this one drive only


@pytest.mark.hazard("H06")
def test_a_look_that_the_drive_cannot_answer_just_now_is_made_again() -> None:
    """F803 was set to 0 at the panel, and the first look at it is refused: the second one tells."""

    async def script(stage: Stage) -> None:
        stage.bench.drive.inverter.memory.set_by_panel("communication_timeout", 0)
        say_unable(stage, 0x0803, 1)
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        refused = await stage.ask(Verb.ARM)
        assert (refused.status, refused.reason) == (Status.REFUSED, Reason.NO_WATCHDOG)

    play(script)


@pytest.mark.parametrize("polled", ["status", "trip_code"])
def test_a_trip_ends_by_whichever_sign_is_read(polled: str) -> None:
    """The other one is read again: else a drive would be tripped for ever."""

    async def script(stage: Stage) -> None:
        inverter = stage.bench.drive.inverter
        inverter.trip(OVERLOAD)
        await asyncio.sleep(4.0)
        assert stage.door.controls["d1"].state.is_tripped
        inverter.reset(asyncio.get_running_loop().time())
        await asyncio.sleep(8.0)
        assert stage.door.controls["d1"].state.is_tripped is False

    play(script, {"poll": [{"values": [polled], "every": "2s", "max_age": "20s"}]})


@pytest.mark.hazard("H30")
def test_whoever_commands_without_end_does_not_end_the_polling() -> None:
    """A setpoint every 10 ms: polls come at least at a third of their rate, and values stay good."""

    async def script(stage: Stage) -> None:
        await started(stage)
        loop, came = asyncio.get_running_loop(), []
        stage.bench.image.subscribe(lambda _image, names: came.append(loop.time()) if "status" in names else None)
        for step in range(500):
            now = loop.time()
            value = Decimal(20 + step % 10)
            stage.door.submit(Command("d1", Verb.FREQUENCY, DASHBOARD, now, now + 1.0, value=value), lambda _: None)
            await asyncio.sleep(0.01)
        assert len(came) >= 15

    play(script, {"poll": [{"values": ["status", "output_current"], "every": "100ms", "max_age": "500ms"}]})


@pytest.mark.hazard("H06", "H09")
def test_a_controller_that_sets_without_end_does_not_hide_a_reset() -> None:
    """Its queue never empties; FA87 is looked at all the same, once a second."""

    async def script(stage: Stage) -> None:
        await started(stage)

        async def set_without_end() -> None:
            for number in range(1000):
                await stage.ask(Verb.SET, name="terminal_output", value=f"{number % 2}")

        setting = [asyncio.create_task(set_without_end()) for _ in range(3)]
        beating = asyncio.create_task(stage.beat_for(60.0))
        await asyncio.sleep(3.0)
        memory = stage.bench.drive.inverter.memory
        memory.write_ram(memory.named("reset_detection"), 0)
        await asyncio.sleep(1.5)
        assert ("d1", "disarmed", "the drive was reset") in stage.events
        for task in (*setting, beating):
            task.cancel()

    play(script, {"poll": SELDOM})


def test_a_drive_that_cannot_tell_whether_it_was_reset_is_asked_again_a_little_later() -> None:
    """FA87 is refused with 04 (CPU busy): the line is not filled with the question."""

    async def script(stage: Stage) -> None:
        await started(stage)
        resets, now = stage.door.controls["d1"].resets, asyncio.get_running_loop().time()
        mark = stage.bench.configured.drives[0].model.registers["reset_detection"]
        due = now + 2 * MARK_EVERY
        assert resets.next_look(due) is not None
        resets.refused(mark, Refusal.UNABLE, due)
        assert resets.next_look(due + MARK_AGAIN / 2) is None
        assert resets.next_time() == due + MARK_AGAIN
        assert resets.next_look(due + MARK_AGAIN) is not None

    play(script)


UNCONFIGURED = {"communication_timeout": None, "timeout_action": None}
SET_AT_THE_DRIVE = {"communication_timeout": 150, "timeout_action": 2}  # 15.0 s, trip


@pytest.mark.hazard("H06")
@pytest.mark.parametrize(("name", "word"), [("communication_timeout", 0), ("timeout_action", 0)])
def test_a_time_out_that_is_switched_off_at_the_panel_is_seen_and_set_again(name: str, word: int) -> None:
    """Nobody would stop the motor any more: the drive is disarmed, and armed anew when it has its time-out again."""

    async def script(stage: Stage) -> None:
        await started(stage)
        beating = asyncio.create_task(stage.beat_for(120.0))
        memory = stage.bench.drive.inverter.memory
        before = memory.word(name)
        memory.set_by_panel(name, word)
        await asyncio.sleep(3 * LOOK_EVERY + 1)
        assert memory.word(name) == before
        assert [event for event in stage.events if event[1] == "watchdog" and "changed by somebody else" in event[2]]
        assert stage.door.controls["d1"].standing is Standing.DISARMED
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        assert (await stage.ask(Verb.RUN, value="20")).status is Status.DONE
        beating.cancel()

    play(script)


@pytest.mark.hazard("H06")
def test_a_time_out_that_is_not_configured_is_looked_at_all_the_same() -> None:
    """Switched off: disarmed, and not armed again. Another time that stops the motor too is taken as it is."""

    async def script(stage: Stage) -> None:
        await started(stage)
        beating = asyncio.create_task(stage.beat_for(120.0))
        control, memory = stage.door.controls["d1"], stage.bench.drive.inverter.memory
        memory.set_by_panel("communication_timeout", 300)
        await asyncio.sleep(3 * LOOK_EVERY + 1)
        assert (control.standing, control.state.timeout) == (Standing.ARMED, 30.0)
        memory.set_by_panel("communication_timeout", 0)
        await asyncio.sleep(3 * LOOK_EVERY + 1)
        assert control.standing is Standing.DISARMED
        refused = await stage.ask(Verb.ARM)
        assert (refused.status, refused.reason) == (Status.REFUSED, Reason.NO_WATCHDOG)
        assert memory.word("communication_timeout") == 0
        beating.cancel()

    play(script, UNCONFIGURED, registers=SET_AT_THE_DRIVE)


def test_looks_at_a_time_out_are_seldom() -> None:
    """One register in ten seconds, whatever is answered."""

    async def script(stage: Stage) -> None:
        await started(stage)
        looks, now = stage.door.controls["d1"].timeout_looks, asyncio.get_running_loop().time()
        assert looks.next(now) is None
        due = now + LOOK_EVERY
        seen = []
        for _ in range(3):
            errand = looks.next(due)
            assert errand is not None
            assert errand is not looks.next(due)  # asked twice, sent once
            assert errand.look is not None
            seen.append(errand.look.name)
            looks.looked(errand.look, due)
            assert looks.next(due) is None
            due = looks.next_time()
        assert sorted(seen) == ["communication_timeout", "timeout_action", "timeout_detection"]

    play(script)
