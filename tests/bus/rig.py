"""One gateway line and the simulated line behind it, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway import site
from gateway.bus.line import Line
from gateway.bus.worker import LineWorker
from gateway.clock import Clock
from gateway.errors import LineDown
from gateway.image import Image, LinkState, Quality
from gateway.metrics import DriveStats, LineStats
from gateway.sim import settings
from gateway.sim.drive import SimulatedDrive
from gateway.sim.settings import SimulatedLineConfig
from gateway.sim.twin import TwinLine
from gateway.sim.wire import Wire
from tests import virtual

FIVE = ["status", "output_frequency", "output_current", "output_voltage", "alarm"]
SELECTED = [1, 2, 3, 4, 5]


@dataclass
class Bench:
    """One gateway line and the simulated line behind it."""

    configured: site.Site
    wire: Wire
    image: Image
    line_stats: LineStats = field(default_factory=LineStats)
    drive_stats: dict[str, DriveStats] = field(default_factory=dict)
    twins: list[TwinLine] = field(default_factory=list)
    is_plugged: bool = True
    applied: list[tuple[str, tuple[str, ...], float]] = field(default_factory=list)
    worker: LineWorker | None = None

    @property
    def drive(self) -> SimulatedDrive:
        """Return the first simulated drive, ticked up to now."""
        drive = self.wire.drives[0]
        drive.tick(asyncio.get_running_loop().time())
        return drive

    async def open(self, line: site.Line, clock: Clock) -> Line:
        """Open the simulated port."""
        if not self.is_plugged:
            raise LineDown("no such device")
        self.twins.append(TwinLine(self.wire, line.timing, clock))
        return self.twins[-1]

    def unplug(self) -> None:
        """Pull the adapter out."""
        self.is_plugged = False
        self.twins[-1].unplug()

    def value(self, drive: str, name: str) -> str:
        """Return a value as text, or its quality where it is not good."""
        image = self.image.by_name[drive]
        sample = image.sample(name, asyncio.get_running_loop().time())
        return image.show(name, sample.word) if sample.quality is Quality.GOOD else sample.quality.word

    def link(self, drive: str) -> LinkState:
        """Return the link state of a drive."""
        return self.image.by_name[drive].link


def bench(
    simulated: list[dict[str, Any]],
    polls: Any = None,
    line: dict[str, Any] | None = None,
    drive: dict[str, Any] | None = None,
    protocols: dict[int, str] | None = None,
    **sim: Any,
) -> Bench:
    """Build a line of drives d1, d2 ... and their simulation; to be called in the running loop."""
    drives = [
        {
            "name": f"d{entry['number']}",
            "number": entry["number"],
            "model": entry.get("configured", entry["model"]),
            "poll": polls or [{"values": FIVE, "every": "100ms"}],
            "protocol": (protocols or {}).get(entry["number"], "modbus-rtu"),
            **(drive or {}),
        }
        for entry in simulated
    ]
    lines = [{"name": "a", "port": "/dev/null", "drive": drives, **(line or {})}]
    built = site.build({"gateway": {"name": "t"}, "line": lines}, "test", Path())
    entries = [{key: word for key, word in entry.items() if key != "configured"} for entry in simulated]
    config = SimulatedLineConfig.model_validate({"drive": entries, **sim})
    wire = settings.build(config, asyncio.get_running_loop().time())
    made = Bench(built, wire, Image(built.drives))
    made.drive_stats = {drive.name: DriveStats() for drive in built.drives}
    made.image.subscribe(
        lambda image, names: made.applied.append(
            (image.drive.name, tuple(names), asyncio.get_running_loop().time())
        )
    )
    return made


def run(made: Callable[[], Bench], play: Callable[[Bench], Awaitable[None]]) -> None:
    """Run the worker while the play lasts."""

    async def main() -> None:
        stage = made()
        line = stage.configured.lines[0]
        worker = LineWorker(
            line, stage.image.by_name, stage.line_stats, stage.drive_stats, virtual.VirtualClock(), stage.open
        )
        stage.worker = worker
        task = asyncio.create_task(worker.run())
        try:
            await play(stage)
            assert not task.done() or task.exception() is None
            assert stage.wire.statistics.gap_violations == 0
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    virtual.run(main())


def nc3(number: int = 1, **more: Any) -> dict[str, Any]:
    """Return a simulated VF-nC3, its selectors set."""
    return {"number": number, "model": "vf-nc3", "block_read": SELECTED, **more}
