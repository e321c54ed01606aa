"""The time-outs of simulated drives, kept by the worker itself at the least F803 that `check` permits.

The drives are the judges: each knows by how much its own timer of F803 was short of running out.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import pytest

from gateway import site
from gateway.bus import refresh
from gateway.bus.worker import LineWorker
from gateway.control.command import Channel, Command, Source, Verb
from gateway.control.door import Door, LineBell
from gateway.image import Image
from gateway.metrics import DriveStats
from gateway.sim import settings
from gateway.sim.faults import Fault, Kind
from gateway.sim.settings import SimulatedLineConfig
from gateway.sim.timeout import CommunicationTimer
from tests import virtual
from tests.bus.rig import Bench
from tests.soak import FACTOR

COMMANDED, DYING, GREEDY, DEAD = (1, 2, 3), 3, 4, 9  # numbers; nobody commands the last two
SET_UP = 10.0  # seconds for every drive to be identified and its F803 to be set
SECONDS = 60.0 * FACTOR
CALM = [{"values": ["status"], "every": "60s"}]
WIDE = ["status", "output_current", "alarm", "pid_feedback", "output_voltage", "trip_code"]


def built(protocol: str, timeout: str, *, is_busy: bool = True) -> site.Site:
    """Return a line: three drives commanded and hardly polled, one polled without a pause, one that is not there.

    The last two only where it is busy.
    """
    common = {"model": "vf-nc3", "protocol": protocol}
    control = {"control": "leased", "communication_timeout": timeout, "timeout_action": "stop", "poll": CALM}
    drives: list[dict[str, Any]] = [{"name": f"d{n}", "number": n, **common, **control} for n in COMMANDED]
    drives += [
        {"name": f"d{n}", "number": n, "poll": [{"values": WIDE, "every": "0s"}], **common}
        for n in (GREEDY, DEAD)
        if is_busy
    ]
    return site.build(
        {"gateway": {"name": "t"}, "line": [{"name": "a", "port": "/dev/null", "drive": drives}]}, "test", Path()
    )


def bench(configured: site.Site, protocol: str) -> Bench:
    """Return it with the drives that are there; to be called in the running loop."""
    spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
    drives = [{"number": n, "model": "vf-nc3", "protocol": spoken} for n in (*COMMANDED, GREEDY)]
    wire = settings.build(SimulatedLineConfig.model_validate({"drive": drives}), asyncio.get_running_loop().time())
    made = Bench(configured, wire, Image(configured.drives))
    made.drive_stats = {drive.name: DriveStats() for drive in configured.drives}
    return made


async def lose_single_requests(made: Bench, chance: Random, ends: float) -> int:
    """Cut requests to each drive, never two in a row; return how many."""
    loop, lost = asyncio.get_running_loop(), 0
    pending: dict[int, Fault] = {}
    struck: dict[int, float] = {}
    while loop.time() < ends:
        for number in COMMANDED:
            if number in pending and pending[number].count == 0:
                del pending[number]
                struck[number] = loop.time()
                lost += 1
            if number not in pending and made.drive_stats[f"d{number}"].last_heard > struck.get(number, 0.0):
                pending[number] = Fault(Kind.CUT, number, count=1)
                made.wire.faults.add(pending[number])
        await asyncio.sleep(chance.uniform(0.01, 0.2))
    return lost


async def stop_again_and_again(door: Door, drive: str, ends: float) -> None:
    """Stop a drive that stands, more often than the line can carry."""
    loop, source = asyncio.get_running_loop(), Source(Channel.MQTT, "panel")
    while (now := loop.time()) < ends:
        door.submit(Command(drive, Verb.STOP, source, now, now + 1.0), lambda result: None)
        await asyncio.sleep(0.02)


@dataclass(frozen=True, slots=True)
class Served:
    """A line that is served, its door, and the timers of the drives' own F803 by number."""

    bench: Bench
    door: Door
    timers: dict[int, CommunicationTimer]

    def least_margins(self) -> dict[int, float]:
        """Return how near each commanded drive has come to its time-out."""
        return {n: margin for n in COMMANDED if (margin := self.timers[n].least_margin) is not None}


@contextlib.asynccontextmanager
async def served(configured: site.Site, protocol: str) -> AsyncIterator[Served]:
    """Serve a line; begins when every drive is set up, and its timer runs."""
    clock = virtual.VirtualClock()
    made, door = bench(configured, protocol), Door.of(configured, clock)
    worker = LineWorker(
        configured.lines[0], made.image.by_name, made.line_stats, made.drive_stats, clock, made.open, door.controls
    )
    door.connect(LineBell("a", tuple(drive.name for drive in configured.drives), worker.ring, worker.announce))
    task = asyncio.create_task(worker.run())
    try:
        await asyncio.sleep(SET_UP)
        timers = {drive.number: drive.inverter.timer for drive in made.wire.drives}
        for number in COMMANDED:
            assert timers[number].deadline is not None
            timers[number].least_margin = None
        yield Served(made, door, timers)
        assert not task.done()
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def stormy_margins(protocol: str, f803: str) -> dict[int, float]:
    """Play for a while with everything that goes wrong at once; return the least margins of the living drives."""
    loop = asyncio.get_running_loop()
    async with served(built(protocol, f803), protocol) as line:
        begins, ends = loop.time(), loop.time() + SECONDS
        line.bench.wire.faults.add(Fault(Kind.CUT, DYING, after=begins + 20, until=begins + 30))
        lost, _ = await asyncio.gather(
            lose_single_requests(line.bench, Random(6), ends), stop_again_and_again(line.door, "d2", ends)
        )
        assert lost > SECONDS / 4
        return {number: margin for number, margin in line.least_margins().items() if number != DYING}


async def calm_margins(protocol: str, f803: str) -> dict[int, float]:
    """Let nothing but the keepalive talk to the drives for a while; return their least margins."""
    async with served(built(protocol, f803, is_busy=False), protocol) as line:
        await asyncio.sleep(SECONDS)
        return line.least_margins()


@pytest.mark.unmeasured
@pytest.mark.hazard("H06")
@pytest.mark.hazard("H30")
@pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])
def test_no_drive_comes_nearer_to_its_time_out_than_two_thirds(protocol: str) -> None:
    """A full line, a dead neighbour, a dying one, lost requests, and a flood of stops, with the least F803."""
    least = refresh.worst_case(built(protocol, "100s").lines[0]).least_timeout
    assert refresh.too_short(built(protocol, f"{least}s")) == []
    margins = virtual.run(stormy_margins(protocol, f"{least}s"))
    assert set(margins) == {1, 2}
    assert min(margins.values()) >= 2 / 3 * float(least)


@pytest.mark.unmeasured
@pytest.mark.hazard("H06")
@pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])
def test_drives_that_are_hardly_polled_are_talked_to_in_time_all_the_same(protocol: str) -> None:
    """The line has nothing else to do: what is let through never comes, and is not waited for."""
    margins = virtual.run(calm_margins(protocol, "1.5s"))
    assert set(margins) == set(COMMANDED)
    assert min(margins.values()) >= 2 / 3 * 1.5
