"""A PLC that writes its image every 100 ms, against simulated drives in virtual time: the example of the manual."""

from __future__ import annotations

import asyncio
import struct

import pytest

from gateway.control.command import Reason
from gateway.modbus_tcp.gateway_unit import UNIT
from gateway.modbus_tcp.mirror_map import REASONS
from gateway.sim.faults import Fault, Kind
from tests.modbus_tcp.plant import CODES, Master, Place, Plant, code_of, exchange, mirror, play, several

CYCLE = 0.1  # seconds
DONE, REFUSED, FAILED, UNKNOWN, UNDER_WAY, ENDED = range(1, 7)
ARMED, DISARMED = 1, 2


class Plc:
    """One drive as a PLC programmer sees it: outputs are written and inputs are read, once a cycle, by 17H."""

    def __init__(self, master: Master, index: int = 0) -> None:
        self._master = master
        self._index = index
        self.command = 0
        self.heartbeat = 0
        self.frequency = 0
        self.parameter = 0
        self.sequence = 0
        self.inputs: dict[Place, int] = {}

    async def cycle(self) -> None:
        """Exchange outputs and inputs: this is never answered by an exception."""
        outputs = (self.command, self.heartbeat, self.frequency, self.parameter, self.sequence)
        places = list(Place)[Place.ECHO :]
        first = mirror(Place.COMMAND, self._index)
        told = await self._master.ask(UNIT, exchange(first + Place.ECHO, len(places), first, *outputs))
        self.inputs = dict(zip(places, struct.unpack(f">{len(places)}H", told[2:]), strict=True))

    async def cycles(self, seconds: float, *, is_alive: bool = True) -> None:
        """Go on in cycles; one that is not alive sends the same words for ever."""
        for _ in range(round(seconds / CYCLE)):
            self.heartbeat = (self.heartbeat + is_alive) & 0xFFFF
            await self.cycle()
            await asyncio.sleep(CYCLE)

    async def make(self, word: str, frequency: int | None = None) -> tuple[int, int]:
        """Make a command, and go on until its end is told; return status and reason."""
        self.command, self.sequence = CODES[word], self.sequence + 1
        self.frequency = self.frequency if frequency is None else frequency
        for _ in range(100):
            await self.cycles(CYCLE)
            if self.inputs[Place.ECHO] == self.sequence and self.status != UNDER_WAY:
                return self.status, self.inputs[Place.REASON]
        raise AssertionError("no end of the command")

    @property
    def status(self) -> int:
        """Return what became of the last command."""
        return self.inputs[Place.RESULT]


async def running(plant: Plant, frequency: int = 3000) -> Plc:
    """Take, arm and run."""
    plc = Plc(plant.connect())
    for word in ("take", "arm"):
        assert await plc.make(word) == (DONE, 0)
    assert await plc.make("run", frequency) == (DONE, 0)
    return plc


@pytest.mark.hazard("H04")
def test_take_arm_run_another_speed_and_stop() -> None:
    """Each command is made once, whatever the number of cycles."""

    async def script(plant: Plant) -> None:
        plc = Plc(plant.connect())
        await plc.cycles(1.0)
        plant.written.clear()
        assert await plc.make("take") == (DONE, 0)
        assert await plc.make("arm") == (DONE, 0)
        assert plc.inputs[Place.STANDING] == ARMED
        assert await plc.make("run", 3000) == (DONE, 0)
        await plc.cycles(10.0)
        assert plant.hertz == 30.0
        assert plc.inputs[Place.OUTPUT_FREQUENCY] == 3000
        plc.frequency = 4500
        await plc.cycles(10.0)
        assert plant.hertz == 45.0
        assert await plc.make("stop") == (DONE, 0)
        await plc.cycles(10.0)
        assert plant.hertz == 0.0
        assert await plc.make("release") == (DONE, 0)
        assert plc.inputs[Place.OWNER] == 0
        setpoints = [(address, word) for _, address, word in plant.written if address in (0xFA00, 0xFA01)]
        assert setpoints == [(0xFA01, 3000), (0xFA00, 0xC400), (0xFA01, 4500), (0xFA00, setpoints[-1][1])]

    play(script)


@pytest.mark.hazard("H05")
def test_a_plc_that_has_stopped_behind_its_interface_loses_the_lease() -> None:
    """The interface writes the last image for ever: no sign of life; the motor is stopped, and its command ended."""

    async def script(plant: Plant) -> None:
        plc = await running(plant)
        await plc.cycles(3.0)
        assert plant.is_running()
        await plc.cycles(2.5, is_alive=False)
        assert not plant.is_running()
        await plc.cycles(20.0, is_alive=False)
        assert not plant.is_running()
        assert plc.status == ENDED
        assert plant.hertz == 0.0
        assert await plc.make("take") == (DONE, 0)
        assert await plc.make("arm") == (DONE, 0)
        assert await plc.make("run") == (DONE, 0)

    play(script)


@pytest.mark.hazard("H04")
def test_the_stop_of_another_host_is_not_undone_by_the_image() -> None:
    """The run command stands there and has ended; another sequence runs again."""

    async def script(plant: Plant) -> None:
        plc = await running(plant)
        assert await plant.connect("10.0.0.8").order("stop") == 0
        await plc.cycles(3.0)
        assert not plant.is_running()
        assert plc.status == ENDED
        assert await plc.make("run", 3000) == (DONE, 0)
        assert plant.is_running()

    play(script)


@pytest.mark.hazard("H29")
def test_a_stop_that_stands_in_the_image_holds_against_another_owner() -> None:
    """The other one's run is stopped by the next cycle."""

    async def script(plant: Plant) -> None:
        plc = Plc(plant.connect("10.0.0.8"))
        plc.command = CODES["stop"]
        await plc.cycles(1.0)
        owner = plant.connect()
        assert await owner.order("take") == 0
        assert await owner.order("arm") == 0
        await owner.write_words(1, 0xFA00, 0xC400, 3000)
        await plc.cycles(0.5)
        assert not plant.is_running()
        frames = len(plant.written)
        await plc.cycles(5.0)
        assert len(plant.written) == frames

    play(script)


@pytest.mark.hazard("H11")
def test_a_lost_setpoint_is_told_and_not_sent_later_by_itself() -> None:
    """A line that is cut for a moment: failed or unknown, until it is asked for anew by another sequence."""

    async def script(plant: Plant) -> None:
        plc = await running(plant)
        await plc.cycles(1.0)
        now = asyncio.get_running_loop().time()
        plant.bench.wire.faults.add(Fault(Kind.CUT, 1, until=now + 0.15))
        plc.frequency = 2000
        await plc.cycles(1.0)
        assert plc.status in (FAILED, UNKNOWN)
        assert plant.word("frequency_command") == 3000
        await plc.cycles(5.0)
        assert plant.word("frequency_command") == 3000
        assert await plc.make("take") == (DONE, 0)
        assert await plc.make("arm") == (DONE, 0)
        assert await plc.make("run") == (DONE, 0)
        assert plant.word("frequency_command") == 2000

    play(script)


@pytest.mark.hazard("H29")
def test_an_emergency_stop_of_the_line_stops_every_drive() -> None:
    """One register, by 06H; every drive trips."""

    async def script(plant: Plant) -> None:
        masters = [plant.connect(), plant.connect()]
        for index, master in enumerate(masters):
            assert await master.order("take", index) == 0
            assert await master.order("arm", index) == 0
            assert await master.cycle("run", 1, 3000, index=index) == 0
        assert plant.is_running(0)
        assert plant.is_running(1)
        assert await plant.connect("10.0.0.8").write_one(UNIT, 0xE000, CODES["emergency_stop"]) == 0
        assert not plant.is_running(0)
        assert not plant.is_running(1)
        assert await masters[0].read_words(UNIT, 0xE000, 1) == [CODES["emergency_stop"]]

    play(script, drives=2)


def test_a_reset_does_not_keep_the_cycle_waiting() -> None:
    """Under way for seconds, while heartbeats keep the lease; then done, disarmed, and armed again."""

    async def script(plant: Plant) -> None:
        plc = await running(plant)
        plant.bench.drive.inverter.trip(1)
        await plc.cycles(1.0)
        assert (plc.status, plc.inputs[Place.STANDING]) == (ENDED, DISARMED)
        began = asyncio.get_running_loop().time()
        assert await plc.make("reset") == (DONE, 0)
        assert asyncio.get_running_loop().time() - began > 1.0
        assert (plc.inputs[Place.OWNER], plc.inputs[Place.STANDING]) == (2, DISARMED)
        assert await plc.make("arm") == (DONE, 0)
        assert await plc.make("run") == (DONE, 0)
        assert plant.is_running()
        assert not any(event == "lease_lost" for _, event, _ in plant.events)

    play(script)


@pytest.mark.hazard("H05")
def test_10h_of_a_slow_command_is_acknowledged_within_half_a_lease() -> None:
    """05 in the first cycle and the next ones, so that the heartbeat of one connection goes on."""

    async def script(plant: Plant) -> None:
        plc = await running(plant)
        plant.bench.drive.inverter.trip(1)
        await plc.cycles(1.0)
        master, began = plant.connect(), asyncio.get_running_loop().time()
        assert await master.cycle("reset", 1001, 3000, sequence=99) == 5
        assert 0.5 < asyncio.get_running_loop().time() - began <= 0.9 + 1e-6
        codes = []
        for beat in range(30):
            codes.append(await master.cycle("reset", beat, 3000, sequence=99))
            await asyncio.sleep(CYCLE)
        assert codes[0] == 5
        assert codes[-1] == 0
        assert set(codes) == {0, 5}
        assert await master.shown(Place.OWNER) == 2

    play(script)


def test_jog_preset_pattern_and_giving_the_priority_back() -> None:
    """The other commands, as bits of FA00."""

    async def script(plant: Plant) -> None:
        plc = await running(plant)
        plc.parameter = 5
        assert await plc.make("preset") == (DONE, 0)
        assert plant.word("command") & 0x000F == 5
        plc.parameter = 2
        assert await plc.make("acceleration") == (DONE, 0)
        assert plant.word("command") & 0x0040
        assert await plc.make("stop") == (DONE, 0)
        await plc.cycles(5.0)
        assert await plc.make("jog") == (DONE, 0)
        assert plant.word("command") & 0x0500 == 0x0500
        assert await plc.make("stop") == (DONE, 0)
        assert await plc.make("release_priority") == (DONE, 0)
        assert not plant.word("command") & 0xC000

    play(script)


@pytest.mark.hazard("H31")
def test_a_wild_setpoint_in_the_image_changes_nothing() -> None:
    """Refused, as long as it stands there; by 10H with its exception."""

    async def script(plant: Plant) -> None:
        plc = await running(plant)
        plc.frequency = 6001
        await plc.cycles(1.0)
        assert (plc.status, plc.inputs[Place.REASON]) == (REFUSED, REASONS[Reason.RANGE])
        assert plant.word("frequency_command") == 3000
        master = plant.connect()
        assert [await master.cycle("run", beat, 6001, sequence=plc.sequence) for beat in range(3)] == [3, 3, 3]
        plc.frequency = 6000
        await plc.cycles(1.0)
        assert plc.status == DONE
        assert plant.word("frequency_command") == 6000

    play(script)


def test_a_cycle_by_10h_alone_does_as_well() -> None:
    """Three registers: command, heartbeat, frequency; no sequence."""

    async def script(plant: Plant) -> None:
        master = plant.connect()
        beat = 0

        async def cycles(word: str, frequency: int, count: int) -> set[int]:
            nonlocal beat
            codes = set()
            for _ in range(count):
                beat += 1
                told = await master.ask(UNIT, several(mirror(Place.COMMAND), CODES[word], beat, frequency))
                codes.add(code_of(told))
                await asyncio.sleep(CYCLE)
            return codes

        assert await cycles("take", 0, 3) == {0}
        assert await cycles("arm", 0, 3) == {0}
        assert await cycles("run", 3000, 100) == {0}
        assert plant.hertz == 30.0
        assert await cycles("stop", 3000, 100) == {0}
        assert plant.hertz == 0.0

    play(script)
