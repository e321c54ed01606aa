"""What drives are sent, frame by frame: when permission ends a read in the wrong place keeps F803 from acting."""

from __future__ import annotations

import asyncio
from decimal import Decimal

import pytest

from gateway.control.command import Command, Reason, Result, Status, Verb
from gateway.control.door import Door
from gateway.image import LinkState
from gateway.sim import settings
from gateway.sim.condition import TripCode
from gateway.sim.faults import Fault, Kind
from gateway.sim.journal import Way
from gateway.sim.settings import SimulatedLineConfig
from tests.bus.rig import Bench
from tests.control import test_line_stop as lines
from tests.control.test_control_line import DASHBOARD, Stage, play, started

F803, BEYOND = 1.5, 1.0  # seconds; the second is what a drive is left alone for beyond F803
RAMP = 5.0  # seconds, more than 30 Hz to standstill take: F804 = 2 trips there
READ = 0x03
STOP = bytes.fromhex("01 06 FA 00")
RUNNING = 0x6400  # FD01 of a motor that runs
FD00, FD01, FC90 = 0xFD00, 0xFD01, 0xFC90
TRIPPED = 1 << 3  # of FD01
E = 0x11  # of FC90: emergency stop


class Watched:
    """A stage whose events have times, and whose frames can be asked for; `at_loss` comes with the end of a lease."""

    def __init__(self, stage: Stage, at_loss: Fault | None = None) -> None:
        self.stage = stage
        self.at: dict[str, float] = {}
        self._at_loss = at_loss
        stage.door.on_event(self._note)

    def _note(self, _drive: str, event: str, _reason: str) -> None:
        self.at.setdefault(event, asyncio.get_running_loop().time())
        if event == "lease_lost" and self._at_loss is not None:
            self.stage.bench.wire.faults.add(self._at_loss)

    async def until(self, event: str) -> float:
        """Wait until something was told, and return when."""
        for _ in range(1000):
            if event in self.at:
                return self.at[event]
            await asyncio.sleep(0.01)
        raise AssertionError(f"{event} was never told, but {list(self.at)}")

    def frames(self, begin: float, end: float) -> list[bytes]:
        """Return what the gateway sent between two moments."""
        entries = self.stage.bench.wire.journal.last(5000)
        return [e.data for e in entries if e.way is Way.REQUEST and begin <= e.begin < end]


async def running(stage: Stage, at_loss: Fault | None = None) -> Watched:
    """Let the motor run for some seconds, its controller alive; then the controller dies."""
    watched = Watched(stage, at_loss)
    await started(stage)
    await stage.beat_for(5.0)
    return watched


@pytest.mark.hazard("H05")
def test_until_a_stop_is_answered_nothing_else_is_sent() -> None:
    """The drive hears, and its answers are lost: every read in between would start its F803 anew."""

    async def script(stage: Stage) -> None:
        watched = await running(stage, Fault(Kind.DROP, 1))
        left = await watched.until("quiesced")
        sent = watched.frames(watched.at["lease_lost"], left)
        assert len(sent) > 1
        assert {frame[:4] for frame in sent} == {STOP}

    play(script)


@pytest.mark.hazard("H05")
def test_a_drive_that_is_left_alone_gets_no_frame_until_its_f803_has_acted() -> None:
    """Not even an identification; afterwards it is identified and observed again."""

    async def script(stage: Stage) -> None:
        watched = await running(stage, Fault(Kind.CUT, 1))
        left = await watched.until("quiesced")
        stage.bench.wire.faults.clear()
        awake = await watched.until("awake")
        assert awake - left >= F803 + BEYOND
        assert watched.frames(left + 0.001, awake) == []
        await asyncio.sleep(RAMP)
        assert watched.frames(awake, awake + RAMP) != []
        assert stage.bench.drive.inverter.condition.trip_code == TripCode.COMMUNICATION

    play(script)


@pytest.mark.hazard("H07")
@pytest.mark.parametrize("protocol", ["toshiba-ascii", "toshiba-binary"])
def test_a_stop_that_is_owed_is_not_given_to_another_drive(protocol: str) -> None:
    """A VF-MB1 in the place of a VF-nC3 that was lost while it ran: who it is comes first; it is sent no write."""

    async def script(stage: Stage) -> None:
        await running(stage, Fault(Kind.CUT, 1))
        watched, wire = Watched(stage), stage.bench.wire
        await watched.until("awake")
        other = {"drive": [{"number": 1, "model": "vf-mb1", "protocol": "toshiba"}]}
        now = asyncio.get_running_loop().time()
        (wire.drives[0],) = settings.build(SimulatedLineConfig.model_validate(other), now).drives
        wire.faults.clear()
        await asyncio.sleep(5.0)
        assert stage.bench.link("d1") is LinkState.STRANGER
        assert wire.drives[0].inverter.memory.changes == 1  # since it was switched on: none

    play(script, protocol=protocol)


@pytest.mark.hazard("H05")
def test_a_stop_that_reads_back_is_no_proof_while_the_motor_turns() -> None:
    """FA00 is as it should be, and FD01 and FD00 say that the motor goes on: left to F803, and never told as done."""

    async def script(stage: Stage) -> None:
        watched = await running(stage)
        registers = stage.bench.drive.registers
        registers.forced.update({FD00: 3000, FD01: RUNNING})
        left = await watched.until("quiesced")
        assert "on_loss" not in watched.at
        assert left - watched.at["lease_lost"] > BEYOND
        awake = await watched.until("awake")
        assert watched.frames(left + 0.001, awake) == []

    play(script)


@pytest.mark.hazard("H08")
def test_the_eeprom_is_written_as_often_as_is_permitted_and_no_more() -> None:
    """A burst, then refusals that say when; a parameter that was written too often is not written at all."""

    async def often(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        results = [await stage.ask(Verb.SET, name="acceleration_time_1", value=f"{n}.5") for n in range(1, 5)]
        assert [result.status for result in results] == [Status.DONE] * 2 + [Status.REFUSED] * 2
        assert {result.reason for result in results[2:]} == {Reason.TOO_OFTEN}
        assert stage.bench.drive.inverter.memory.eeprom_writes[0x0009] == 2

    async def worn(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        results = [await stage.ask(Verb.SET, name="acceleration_time_1", value=f"{n}.5") for n in range(1, 5)]
        assert [str(result.reason) for result in results] == ["", "", "", "worn"]
        assert stage.bench.drive.inverter.memory.eeprom_writes[0x0009] == 3

    set_before = {"communication_timeout": 15, "timeout_action": 2}
    play(often, {"allow_stored": True, "stored_writes": {"burst": 2, "per_hour": 1.0}}, registers=set_before)
    play(worn, {"allow_stored": True, "stored_writes": {"burst": 10, "warn": 1, "refuse": 3}}, registers=set_before)


@pytest.mark.hazard("H09")
def test_a_fault_reset_is_sent_once_and_not_believed() -> None:
    """The cause of the trip is still there: failed, by what the drive says when it is back."""

    async def script(stage: Stage) -> None:
        await started(stage)
        drive = stage.bench.drive
        drive.inverter.trip(TripCode.EMERGENCY)
        drive.registers.forced.update({FC90: E, FD01: TRIPPED})
        await stage.beat_for(1.0)
        watched, begun = Watched(stage), asyncio.get_running_loop().time()
        asked = asyncio.create_task(stage.ask(Verb.RESET))
        await stage.beat_for(6.0)
        result = await asked
        assert (result.status, result.reason) == (Status.FAILED, Reason.STILL_TRIPPED)
        sent = [frame for frame in watched.frames(begun, begun + 6.0) if frame.startswith(STOP)]
        assert [frame[4:6].hex() for frame in sent] == ["e000"]  # fault reset, both priorities, no run

    play(script)


@pytest.mark.hazard("H14")
def test_an_armed_drive_is_disarmed_when_its_line_was_lost() -> None:
    """It stands still and has not tripped: still nobody knows what was done to it meanwhile."""

    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        assert (await stage.ask(Verb.ARM)).status is Status.DONE
        stage.bench.unplug()
        await stage.beat_for(1.0)
        stage.bench.is_plugged = True
        await stage.beat_for(5.0)
        result = await stage.ask(Verb.RUN, value="10")
        assert (result.status, result.reason) == (Status.REFUSED, Reason.NOT_ARMED)
        assert result.text.startswith("disarmed: the link was lost")
        assert stage.bench.drive.inverter.condition.trip_code == TripCode.NONE

    play(script)


@pytest.mark.hazard("H22")
def test_nothing_of_a_write_is_sent_where_any_part_of_it_is_refused() -> None:
    """The frequency would have been permitted, and goes first; the command word behind it is not."""
    right = {"source": "mqtt", "commands": ["take", "words"], "registers": ["frequency_command"]}

    async def script(stage: Stage) -> None:
        assert (await stage.ask(Verb.TAKE)).status is Status.DONE
        watched, begun = Watched(stage), asyncio.get_running_loop().time()
        result = await stage.ask(Verb.WORDS, address=0xFA00, words=(0xC400, 3000))
        assert (result.status, result.reason) == (Status.REFUSED, Reason.NOT_PERMITTED)
        await asyncio.sleep(1.0)
        assert not [frame for frame in watched.frames(begun, begun + 1.0) if frame[1] != READ]
        assert (await stage.ask(Verb.WORDS, address=0xFA01, words=(3000,))).status is Status.DONE

    play(script, {"right": [right]})


@pytest.mark.hazard("H29")
@pytest.mark.hazard("H10")
def test_a_stop_waits_for_one_exchange_at_the_most() -> None:
    """Every drive of the line has commands that wait, and polls; the stop of the last one is the next frame."""

    async def script(made: Bench, door: Door) -> None:
        now, results = asyncio.get_running_loop().time(), list[Result]()
        for place in range(8):
            for name in ("d1", "d2", "d3"):
                word = Decimal(place % 2)
                door.submit(Command(name, Verb.TERMINALS, DASHBOARD, now, now + 5.0, value=word), results.append)
        await asyncio.sleep(0.1)
        asked = asyncio.get_running_loop().time()
        door.submit(Command("d3", Verb.STOP, lines.PLC, asked, asked + 1.0), results.append)
        await asyncio.sleep(1.0)
        sent = [e.data for e in made.wire.journal.last(5000) if e.way is Way.REQUEST and e.begin >= asked]
        assert sent[0][:4] == bytes.fromhex("03 06 FA 00")
        ended = [r for r in results if r.command.drive == "d3" and r.command.verb is Verb.TERMINALS]
        assert {r.reason for r in ended if r.status is Status.REFUSED} == {Reason.STOPPED}
        assert len(ended) == 8

    lines.play(script)


@pytest.mark.hazard("H29")
def test_an_emergency_stop_of_a_line_is_one_frame_for_all_before_any_for_one() -> None:
    """Number 0, which every drive obeys; then each is read back by itself."""

    async def script(made: Bench, door: Door) -> None:
        asked = asyncio.get_running_loop().time()
        results = await lines.stopped(door, Verb.EMERGENCY_STOP, 3)
        assert {result.status for result in results} == {Status.DONE}
        sent = [e.data for e in made.wire.journal.last(5000) if e.way is Way.REQUEST and e.begin >= asked]
        assert sent[0][:4] == bytes.fromhex("00 06 FA 00")
        assert sorted(frame[0] for frame in sent[1:4]) == [1, 2, 3]

    lines.play(script)
