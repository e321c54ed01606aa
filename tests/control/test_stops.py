"""Stops that meet other commands: none is lost, none is weakened, and none takes a setpoint from before it along."""

from __future__ import annotations

import asyncio

import pytest

from gateway.control.command import Reason, Result, Status, Verb
from gateway.control.state import WAITING
from gateway.sim.condition import TripCode
from tests.control.test_control_line import DASHBOARD, PLC, Stage, play, started


async def both(stage: Stage, first: Verb, second: Verb) -> list[Result]:
    """Ask for two stops at once, each by another source."""
    asked = [asyncio.create_task(stage.ask(first, PLC)), asyncio.create_task(stage.ask(second, DASHBOARD))]
    return [await each for each in asked]


@pytest.mark.hazard("H10", "H29")
@pytest.mark.parametrize("other", [Verb.STOP, Verb.COAST])
@pytest.mark.parametrize("is_first", [True, False])
def test_a_weaker_stop_does_not_take_the_place_of_an_emergency_stop(other: Verb, *, is_first: bool) -> None:
    """Whichever came first, the drive trips; both are told that it was done."""
    order = (Verb.EMERGENCY_STOP, other) if is_first else (other, Verb.EMERGENCY_STOP)

    async def script(stage: Stage) -> None:
        await started(stage)
        results = await both(stage, *order)
        assert [result.status for result in results] == [Status.DONE, Status.DONE]
        assert stage.bench.drive.inverter.condition.trip_code == TripCode.EMERGENCY

    play(script)


@pytest.mark.hazard("H10", "H29")
def test_a_motor_that_is_let_coast_is_not_slowed_down_instead() -> None:
    """Coast is the stronger of the two; a ramp would drive it on."""

    async def script(stage: Stage) -> None:
        await started(stage)
        await both(stage, Verb.COAST, Verb.STOP)
        assert stage.bench.drive.inverter.operation.is_coasting

    play(script)


@pytest.mark.hazard("H05")
def test_a_plain_stop_under_way_is_no_emergency_stop_for_a_lost_lease() -> None:
    """What is configured for the loss is done, though somebody has just asked for less."""

    async def script(stage: Stage) -> None:
        await started(stage)
        asked = asyncio.create_task(stage.ask(Verb.STOP, PLC))
        await asyncio.sleep(0)
        stage.door.controls["d1"].loss.begin("the lease has ended", asyncio.get_running_loop().time())
        assert (await asked).status is Status.DONE
        assert stage.bench.drive.inverter.condition.trip_code == TripCode.EMERGENCY

    play(script, {"on_loss": "emergency-stop"})


@pytest.mark.hazard("H03", "H29")
def test_a_stop_with_an_id_that_was_used_before_stops() -> None:
    """Its first result is no answer: the motor has been run since."""

    async def script(stage: Stage) -> None:
        await started(stage)
        for _ in range(2):
            assert (await stage.ask(Verb.STOP, id="42")).status is Status.DONE
            assert not stage.bench.drive.inverter.operation.is_running
            assert (await stage.ask(Verb.RUN, value="20")).status is Status.DONE

    play(script)


@pytest.mark.hazard("H10")
def test_a_setpoint_that_a_run_needs_is_not_dropped_for_a_later_one() -> None:
    """10 Hz, run, 20 Hz: the motor starts at what stood before the run, whatever the drive held from before."""

    async def script(stage: Stage) -> None:
        await started(stage, "60")
        await stage.ask(Verb.STOP)
        await stage.beat_for(4.0)
        asked = [
            asyncio.create_task(stage.ask(verb, value=value))
            for verb, value in ((Verb.FREQUENCY, "10"), (Verb.RUN, None), (Verb.FREQUENCY, "20"))
        ]
        results = [await each for each in asked]
        assert [result.status for result in results] == [Status.DONE] * 3
        assert results[0].raw == {"frequency_command": 1000}

    play(script)


@pytest.mark.hazard("H13")
def test_a_stop_is_taken_while_the_gateway_ends() -> None:
    """With on_exit = "hold" the motor would run on; nothing else is taken any more."""

    async def script(stage: Stage) -> None:
        await started(stage)
        stage.door.leave()
        assert (await stage.ask(Verb.RUN, value="10")).status is Status.REFUSED
        assert (await stage.ask(Verb.STOP)).status is Status.DONE
        assert not stage.bench.drive.inverter.operation.is_running

    play(script, {"on_exit": "hold"})


@pytest.mark.hazard("H05")
@pytest.mark.parametrize(("verb", "value", "hertz"), [(Verb.PRESET, "3", 10.0), (Verb.JOG, None, 0.0)])
def test_the_fallback_frequency_ends_a_preset_speed_and_stops_who_jogs(
    verb: Verb, value: str | None, hertz: float
) -> None:
    """Presets go before FA01 (7.1), and nobody goes on jogging."""

    async def script(stage: Stage) -> None:
        await started(stage)
        assert (await stage.ask(verb, value=value)).status is Status.DONE
        await stage.beat_for(3.0)
        await asyncio.sleep(8.0)
        assert stage.hertz == hertz

    play(script, {"on_loss": {"frequency": 10.0}}, preset_frequencies=[15.0, 25.0, 35.0])


@pytest.mark.hazard("H31")
def test_a_frequency_for_a_motor_at_a_preset_speed_takes_effect() -> None:
    """The preset is ended; who jogs goes on jogging."""

    async def script(stage: Stage) -> None:
        await started(stage)
        assert (await stage.ask(Verb.PRESET, value="3")).status is Status.DONE
        assert (await stage.ask(Verb.FREQUENCY, value="20")).status is Status.DONE
        await stage.beat_for(6.0)
        assert stage.hertz == 20.0

    play(script, preset_frequencies=[15.0, 25.0, 35.0])


@pytest.mark.hazard("H24")
def test_a_flood_of_weaker_stops_is_bounded() -> None:
    """They share the result of the stronger one as far as there is room; the rest is told so."""

    async def script(stage: Stage) -> None:
        await started(stage)
        asked = [asyncio.create_task(stage.ask(Verb.EMERGENCY_STOP, PLC))]
        asked += [asyncio.create_task(stage.ask(Verb.STOP)) for _ in range(2 * WAITING)]
        results = [await each for each in asked]
        assert [result.reason for result in results].count(Reason.BUSY) == WAITING
        assert stage.bench.drive.inverter.condition.trip_code == TripCode.EMERGENCY

    play(script)
