"""A site with two lines and three drives, and its state, for the tests of the web pages."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway import site
from gateway.clock import Alarm
from gateway.control.ledger import MemoryLedger
from gateway.image import Image, LinkState
from gateway.metrics import DriveStats, LineStats, Stats

NOW = 5000.0  # monotonic seconds
WALL = 1_700_000_000.0  # UTC seconds: 2023-11-14T22:13:20Z
VALUES = ["status", "output_frequency", "alarm"]


@dataclass
class StandingClock:
    """A clock that moves when a test moves it."""

    moment: float = NOW

    def now(self) -> float:
        """Return monotonic seconds."""
        return self.moment

    def wall(self) -> float:
        """Return UTC seconds."""
        return WALL + self.moment - NOW

    def alarm(self) -> Alarm:
        """Nobody waits here."""
        raise NotImplementedError


def drive(name: str, number: int, **more: Any) -> dict[str, Any]:
    """Return a drive's table that polls three values, at most 1 s old."""
    poll = [{"values": VALUES, "every": "100ms", "max_age": "1s"}]
    return {"name": name, "number": number, "model": "vf-nc3", "poll": poll, **more}


def table(**more: Any) -> dict[str, Any]:
    """Return a configuration: pump-1 and pump-2 on line a, fan on line b."""
    return {
        "gateway": {"name": "hall-3"},
        "mqtt": {"url": "mqtt://127.0.0.1:1883"},
        "sparkplug": {"url": "mqtt://127.0.0.1:1883", "group_id": "plant-1"},
        "modbus_tcp": {},
        "web": {"listen": "127.0.0.1:0"},
        "line": [
            {"name": "a", "port": "/dev/ttyA", "drive": [drive("pump-1", 1), drive("pump-2", 2)]},
            {"name": "b", "port": "/dev/ttyB", "drive": [drive("fan", 3)]},
        ],
        **more,
    }


@dataclass
class Rig:
    """A gateway's state without a gateway."""

    built: site.Site = field(default_factory=lambda: site.build(table(), "test", Path()))
    clock: StandingClock = field(default_factory=StandingClock)
    image: Image = field(init=False)
    stats: Stats = field(init=False)
    ledger: MemoryLedger = field(default_factory=MemoryLedger)

    def __post_init__(self) -> None:
        self.image = Image(self.built.drives)
        self.stats = Stats(started=WALL - 60)
        self.stats.lines = {line.name: LineStats() for line in self.built.lines}
        self.stats.drives = {drive.name: DriveStats() for drive in self.built.drives}

    def answer(self, *names: str) -> None:
        """Let drives (all by default) answer for all of their values now."""
        for image in self.image.drives:
            if not names or image.drive.name in names:
                image.set_link(LinkState.ONLINE)
                words = [(point.register.address, 1) for point in image.points.values()]
                image.apply(words, self.clock.now(), self.clock.wall())

    def open(self) -> None:
        """Let every line be up."""
        for line in self.stats.lines.values():
            line.is_up = True
            line.opened = 1
