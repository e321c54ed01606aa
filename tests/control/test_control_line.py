"""Commands carried out on a simulated line in virtual time: who may, what moves, and what stops it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import pytest

from gateway.bus.worker import LineWorker
from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.door import Door, LineBell
from gateway.sim.condition import TripCode
from gateway.sim.faults import Fault, Kind
from tests import virtual
from tests.bus.rig import SELECTED, Bench, bench

PLC = Source(Channel.MODBUS_TCP, "10.0.0.7")
DASHBOARD = Source(Channel.MQTT, "dashboard")
CONTROL = {
    "control": "leased",
    "sources": ["mqtt", "modbus-tcp"],
    "communication_timeout": "1.5s",
    "timeout_action": "stop",
    "frequency": {"min": 0.0, "max": 60.0},
}


@dataclass
class Stage:
    """A line, its door, and what came out of it."""

    bench: Bench
    door: Door
    results: list[Result] = field(default_factory=list)
    events: list[tuple[str, str, str]] = field(default_factory=list)

    async def ask(self, verb: Verb, source: Source = DASHBOARD, value: str | None = None, **more: Any) -> Result:
        """Submit a command and wait for its result."""
        now = asyncio.get_running_loop().time()
        number = None if value is None else Decimal(value)
        command = Command("d1", verb, source, now, now + 1.0, value=number, **more)
        future: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
        self.door.submit(command, future.set_result)
        return await future

    async def beat_for(self, seconds: float, source: Source = DASHBOARD) -> None:
        """Keep the lease alive for a while."""
        for beat in range(int(seconds / 0.5)):
            self.door.beat("d1", source, beat)
            await asyncio.sleep(0.5)

    @property
    def hertz(self) -> float:
        """Return how fast the motor turns."""
        return self.bench.drive.inverter.condition.motor.frequency


def play(script: Callable[[Stage], Awaitable[None]], control: dict[str, Any] | None = None, **sim: Any) -> None:
    """Run a script against one VF-nC3."""

    async def main() -> None:
        protocol = sim.pop("protocol", "modbus-rtu")
        spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
        simulated = {"number": 1, "model": "vf-nc3", "block_read": SELECTED, "protocol": spoken, **sim}
        made = bench([simulated], drive={"protocol": protocol, **CONTROL, **(control or {})})
        door = Door.of(made.configured, virtual.VirtualClock())
        worker = LineWorker(
            made.configured.lines[0],
            made.image.by_name,
            made.line_stats,
            made.drive_stats,
            virtual.VirtualClock(),
            made.open,
            door.controls,
        )
        door.connect(LineBell("a", ("d1",), worker.ring, worker.announce))
        stage = Stage(made, door)
        door.on_result(stage.results.append)
        door.on_event(lambda *event: stage.events.append(event))
        task = asyncio.create_task(worker.run())
        try:
            await asyncio.sleep(3.0)
            await script(stage)
            assert not task.done() or task.exception() is None
            assert made.wire.statistics.gap_violations == 0
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    virtual.run(main())


async def started(stage: Stage, hertz: str = "30") -> None:
    """Take, arm and run."""
    assert (await stage.ask(Verb.TAKE)).status is Status.DONE
    assert (await stage.ask(Verb.ARM)).status is Status.DONE
    result = await stage.ask(Verb.RUN, value=hertz)
    assert result.status is Status.DONE, result


@pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])
def test_a_motor_is_started_and_stopped(protocol: str) -> None:
    """Frequency, then run; read back; stop at the end."""

    async def script(stage: Stage) -> None:
        await started(stage)
        await stage.beat_for(6.0)
        assert stage.hertz == 30.0
        assert (await stage.ask(Verb.STOP)).status is Status.DONE
        await stage.beat_for(6.0)
        assert stage.hertz == 0.0

    play(script, protocol=protocol)


@pytest.mark.hazard("H05")
def test_a_dead_controller_stops_the_motor() -> None:
    """The heartbeat ends: stopped within the lease and two exchanges."""

    async def script(stage: Stage) -> None:
        await started(stage)
        await stage.beat_for(5.0)
        assert stage.hertz == 30.0
        await asyncio.sleep(2.1)
        assert not stage.bench.drive.inverter.operation.is_running
        assert ("d1", "lease_lost", f"the lease of {DASHBOARD} has ended") in stage.events
        assert ("d1", "on_loss", "stop: done") in stage.events
        result = await stage.ask(Verb.RUN, value="10")
        assert (result.status, result.reason) == (Status.REFUSED, Reason.NOT_OWNER)

    play(script)


@pytest.mark.hazard("H05")
def test_a_drive_that_does_not_stop_is_left_to_its_own_time_out() -> None:
    """The stop is lost on the way: no frame any more, and F803 trips it."""

    async def script(stage: Stage) -> None:
        await started(stage)
        await stage.beat_for(5.0)
        stage.bench.wire.faults.add(Fault(Kind.CUT, 1))
        await asyncio.sleep(2.0 + 1.0 + 1.5 + 3.0)
        assert stage.bench.drive.inverter.condition.trip_code == TripCode.COMMUNICATION

    play(script)


@pytest.mark.hazard("H04")
def test_one_owner_at_a_time_but_everybody_may_stop() -> None:
    """Another source gets not_owner; its stop is obeyed."""

    async def script(stage: Stage) -> None:
        await started(stage)
        result = await stage.ask(Verb.FREQUENCY, PLC, "10")
        assert (result.status, result.reason) == (Status.REFUSED, Reason.NOT_OWNER)
        assert (await stage.ask(Verb.STOP, PLC)).status is Status.DONE
        assert not stage.bench.drive.inverter.operation.is_running

    play(script)


@pytest.mark.hazard("H06")
def test_the_watchdog_is_set_and_without_it_nothing_runs() -> None:
    """F803 and F804 as configured, written once; not configured: no arming."""

    async def armed(stage: Stage) -> None:
        memory = stage.bench.drive.inverter.memory
        assert (memory.word("communication_timeout"), memory.word("timeout_action")) == (15, 2)
        assert memory.eeprom_writes == {0x0803: 1, 0x0804: 1}
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        assert (await stage.ask(Verb.ARM)).status is Status.DONE

    async def unarmed(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        result = await stage.ask(Verb.ARM)
        assert (result.status, result.reason) == (Status.REFUSED, Reason.NO_WATCHDOG)

    play(armed)
    play(unarmed, {"communication_timeout": "100s", "timeout_action": "alarm"}, registers={"timeout_action": 0})


@pytest.mark.hazard("H31")
def test_a_wild_setpoint_is_refused() -> None:
    """Beyond what is configured, never clamped."""

    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        result = await stage.ask(Verb.FREQUENCY, value="60.01")
        assert (result.status, result.reason) == (Status.REFUSED, Reason.RANGE)
        assert (await stage.ask(Verb.FREQUENCY, value="60.00")).status is Status.DONE

    play(script)


@pytest.mark.hazard("H03")
def test_a_known_id_acts_once() -> None:
    """The first result again, and no frame."""

    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        first = await stage.ask(Verb.FREQUENCY, value="20", id="7")
        second = await stage.ask(Verb.FREQUENCY, value="40", id="7")
        assert second is first
        assert stage.bench.drive.inverter.memory.word("frequency_command") == 2000

    play(script)


def test_a_trip_disarms() -> None:
    """After it nothing runs until it is reset and armed again."""

    async def script(stage: Stage) -> None:
        await started(stage)
        stage.bench.drive.inverter.trip(TripCode.EMERGENCY)
        await stage.beat_for(1.0)
        result = await stage.ask(Verb.RUN, value="30")
        assert (result.status, result.reason) == (Status.REFUSED, Reason.NOT_ARMED)
        assert "tripped" in result.text

    play(script)


@pytest.mark.hazard("H09")
def test_a_fault_reset_is_done_when_the_drive_comes_back_untripped() -> None:
    """Sent once without an answer; the drive is observed anew, and armed anew."""

    async def script(stage: Stage) -> None:
        await started(stage)
        stage.bench.drive.inverter.trip(TripCode.EMERGENCY)
        await stage.beat_for(1.0)
        asked = asyncio.create_task(stage.ask(Verb.RESET))
        await stage.beat_for(5.0)
        result = await asked
        assert result.status is Status.DONE, result
        assert stage.bench.drive.inverter.condition.trip_code == 0
        refused = await stage.ask(Verb.RUN, value="10")
        assert refused.reason is Reason.NOT_ARMED
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        assert (await stage.ask(Verb.RUN, value="10")).status is Status.DONE

    play(script)


@pytest.mark.hazard("H13")
def test_the_end_of_the_gateway_stops_the_motor() -> None:
    """on_exit = "stop": read back and seen to stop; no command is taken any more."""

    async def script(stage: Stage) -> None:
        await started(stage)
        await stage.beat_for(5.0)
        stage.door.leave()
        assert not stage.door.is_settled
        await asyncio.sleep(1.0)
        assert stage.door.is_settled
        assert not stage.bench.drive.inverter.operation.is_running
        assert (await stage.ask(Verb.RUN, value="10")).reason is Reason.ENDING

    async def held(stage: Stage) -> None:
        await started(stage)
        await stage.beat_for(5.0)
        stage.door.leave()
        await asyncio.sleep(1.0)
        assert stage.bench.drive.inverter.operation.is_running

    play(script)
    play(held, {"on_exit": "hold"})


def test_a_release_stops_what_it_leaves_behind() -> None:
    """The owner gives the lease back while the motor runs: on_loss; the next source may take it then."""

    async def script(stage: Stage) -> None:
        await started(stage)
        await stage.beat_for(3.0)
        assert (await stage.ask(Verb.RELEASE)).status is Status.DONE
        await asyncio.sleep(1.0)
        assert not stage.bench.drive.inverter.operation.is_running
        assert (await stage.ask(Verb.TAKE, PLC)).status is Status.DONE

    play(script)


@pytest.mark.hazard("H12")
def test_a_drive_found_running_that_nobody_owns_is_left_to_its_own_time_out() -> None:
    """Nothing is written: its F803 trips it, as when no gateway had come back."""

    async def script(stage: Stage) -> None:
        inverter = stage.bench.drive.inverter
        assert ("d1", "unowned", "it runs by command, and nobody holds the lease") in stage.events
        await asyncio.sleep(4.0)
        assert inverter.condition.trip_code == TripCode.COMMUNICATION
        assert inverter.memory.word("command") == 0xC400

    found = {"command": 0xC400, "frequency_command": 3000, "communication_timeout": 15, "timeout_action": 2}
    play(script, registers=found)


@pytest.mark.hazard("H08")
def test_a_stored_parameter_needs_permission_and_is_not_written_when_equal() -> None:
    """Refused by default; counted before it is sent; equal values wear nothing."""

    async def refused(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        result = await stage.ask(Verb.SET, name="acceleration_time_1", value="7.5")
        assert (result.status, result.reason) == (Status.REFUSED, Reason.STORED)

    async def permitted(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        register = stage.bench.configured.drives[0].model.registers["acceleration_time_1"]
        for _ in range(3):
            result = await stage.ask(Verb.SET, name="acceleration_time_1", value="7.5")
            assert result.status is Status.DONE, result
        assert stage.bench.drive.inverter.memory.eeprom_writes[register.address] == 1
        assert stage.door.ledger.count("d1", register.address) == 1

    play(refused)
    play(permitted, {"allow_stored": True})


@pytest.mark.hazard("H07")
@pytest.mark.hazard("H09")
def test_a_reset_that_nobody_saw_disarms() -> None:
    """A brown-out too short for a lost link: FA87 tells, before the next run command is sent."""

    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        await stage.beat_for(1.0)
        memory = stage.bench.drive.inverter.memory
        memory.write_ram(memory.named("reset_detection"), 0)
        result = await stage.ask(Verb.RUN, value="10")
        assert result.status is Status.REFUSED, result
        assert not stage.bench.drive.inverter.operation.is_running
        assert ("d1", "disarmed", "the drive was reset") in stage.events

    play(script)


@pytest.mark.hazard("H14")
def test_an_adapter_that_is_pulled_out_disarms() -> None:
    """Nothing that waited is sent when it is back; the motor has stopped by its F803."""

    async def script(stage: Stage) -> None:
        await started(stage)
        await stage.beat_for(1.0)
        stage.bench.unplug()
        await stage.beat_for(2.5)
        assert stage.bench.drive.inverter.condition.is_timed_out
        stage.bench.is_plugged = True
        await stage.beat_for(8.0)
        result = await stage.ask(Verb.RUN, value="10")
        assert result.reason is Reason.NOT_ARMED

    play(script)


def test_raw_words_without_motion_are_a_stop() -> None:
    """From any source, ahead of everything; only the owner's may give the priority of commands away."""

    async def script(stage: Stage) -> None:
        await started(stage)
        for source, word, written in ((PLC, 0x8000, 0x8000), (PLC, 0x0000, 0x8000), (DASHBOARD, 0x0000, 0x0000)):
            assert (await stage.ask(Verb.RUN)).status is Status.DONE
            result = await stage.ask(Verb.WORDS, source, address=0xFA00, words=(word,))
            assert result.status is Status.DONE, result
            assert not stage.bench.drive.inverter.operation.is_running
            assert result.read_back == {"command": written}

    play(script)


@pytest.mark.hazard("H24", "H29")
def test_a_flood_of_equal_stops_is_one_stop() -> None:
    """Each gets its result; the drive is stopped once, and not again and again from the beginning."""

    async def script(stage: Stage) -> None:
        await started(stage)
        asked = [asyncio.create_task(stage.ask(Verb.STOP, source)) for source in (DASHBOARD, PLC) * 8]
        results = await asyncio.gather(*asked)
        assert {result.status for result in results} == {Status.DONE}
        assert {str(result.command.source) for result in results} == {str(DASHBOARD), str(PLC)}
        assert not stage.bench.drive.inverter.operation.is_running

    play(script)


@pytest.mark.hazard("H05", "H18")
def test_a_drive_that_is_polled_seldom_is_refreshed_and_the_gateway_goes_on() -> None:
    """Polled every 10 s, with F803 = 1.5 s: kept alive in between, and the event loop is never held up."""

    async def script(stage: Stage) -> None:
        await started(stage)
        await stage.beat_for(25.0)
        assert stage.bench.drive.inverter.operation.is_running
        assert not stage.bench.drive.inverter.condition.is_timed_out
        assert stage.bench.drive_stats["d1"].longest_gap <= 0.5

    play(script, {"poll": [{"values": ["status"], "every": "10s"}]})


@pytest.mark.hazard("H04", "H13")
def test_a_stop_that_waits_is_not_taken_back_by_a_release_or_the_end() -> None:
    """With `hold` as well: somebody wanted the motor to stop."""

    async def released(stage: Stage) -> None:
        await started(stage)
        asked = asyncio.create_task(stage.ask(Verb.EMERGENCY_STOP, PLC))
        await asyncio.sleep(0)
        assert (await stage.ask(Verb.RELEASE)).status is Status.DONE
        assert (await asked).status is Status.DONE

    async def ended(stage: Stage) -> None:
        await started(stage)
        asked = asyncio.create_task(stage.ask(Verb.STOP, PLC))
        await asyncio.sleep(0)
        stage.door.leave()
        assert not stage.door.is_settled
        assert (await asked).status is Status.DONE
        assert not stage.bench.drive.inverter.operation.is_running

    play(released, {"on_loss": "hold"})
    play(ended, {"on_exit": "hold"})

def test_the_command_with_the_earliest_deadline_goes_first() -> None:
    """Six drives that are armed at once: the first of them are armed, instead of all being too late together."""

    async def main() -> None:
        drive = {"control": "direct", "communication_timeout": "15s", "timeout_action": "stop"}
        simulated = [{"number": n, "model": "vf-nc3", "block_read": SELECTED} for n in range(1, 13)]
        made = bench(simulated, [{"values": ["status"], "every": "5s"}], drive=drive)
        door = Door.of(made.configured, virtual.VirtualClock())
        line = made.configured.lines[0]
        stats = made.line_stats, made.drive_stats
        worker = LineWorker(
            line, made.image.by_name, *stats, virtual.VirtualClock(), made.open, door.controls
        )
        door.connect(LineBell("a", tuple(made.image.by_name), worker.ring, worker.announce))
        task = asyncio.create_task(worker.run())
        try:
            await asyncio.sleep(20.0)
            now = asyncio.get_running_loop().time()
            results: list[Result] = []
            for number in range(1, 13):
                command = Command(f"d{number}", Verb.ARM, DASHBOARD, now, now + 1.0 + number / 1000)
                door.submit(command, results.append)
            await asyncio.sleep(3.0)
            done = [result.command.drive for result in results if result.status is Status.DONE]
            assert done[0] == "d1"
            assert len(done) >= 3
            assert len(results) == 12
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    virtual.run(main())


@pytest.mark.hazard("H07")
def test_a_command_to_another_drive_says_who_answers() -> None:
    """Neither armed nor moved, and the reason is not that nobody is there."""

    async def script(stage: Stage) -> None:
        await stage.ask(Verb.TAKE)
        for verb in (Verb.ARM, Verb.FREQUENCY):
            result = await stage.ask(verb, value="30" if verb is Verb.FREQUENCY else None)
            assert (result.status, result.reason) == (Status.REFUSED, Reason.OFFLINE)
            assert result.text.startswith("d1 is not online: identity mismatch: vf-nc3 is configured, 'VFMB1")

    play(script, model="vf-mb1", configured="vf-nc3")
