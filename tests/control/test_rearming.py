"""What may have changed in a drive while nobody looked: it is read again before the drive is armed."""

from __future__ import annotations

import asyncio

import pytest

from gateway.control.command import Reason, Status, Verb
from tests.control.test_control_line import Stage, play, started

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
        await stage.beat_for(2.0)
        inverter.reset(asyncio.get_running_loop().time())
        await stage.beat_for(5.0)
        control = stage.door.controls["d1"]
        assert control.state.is_online
        assert control.facts["command"] == 0
        assert stage.bench.drive.inverter.memory.word("communication_timeout") == 15
        assert (await stage.ask(Verb.ARM)).status is Status.DONE

    play(script, protocol=protocol)


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
