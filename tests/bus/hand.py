"""A line used by hand in virtual time: simulated drives, a session that talks to them, and what the wire saw."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway import site
from gateway.bus.line import Line
from gateway.bus.session import Session, opened
from gateway.clock import Clock
from gateway.errors import LineDown
from gateway.protocol.pdu import Request
from gateway.sim import settings
from gateway.sim.drive import SimulatedDrive
from gateway.sim.faults import Fault, Kind
from gateway.sim.settings import SimulatedLineConfig
from gateway.sim.twin import TwinLine
from gateway.sim.wire import Wire
from tests import virtual


@dataclass
class Ear:
    """What hears every frame before the drives do; `pending` are faults that wait for a frame with certain bytes."""

    frames: list[bytes] = field(default_factory=list)
    pending: list[tuple[bytes, Fault]] = field(default_factory=list)

    def hear(self, frame: bytes, wire: Wire) -> None:
        """Take note of a frame, and let the fault begin that waits for it."""
        self.frames.append(frame)
        for part, fault in [*self.pending]:
            if part in frame:
                self.pending.remove((part, fault))
                wire.faults.add(fault)


class HeardLine(TwinLine):
    """The simulated port, with an ear at it."""

    def __init__(self, wire: Wire, line: site.Line, clock: Clock, ear: Ear) -> None:
        super().__init__(wire, line.timing, clock)
        self._ear = ear

    async def write(self, frame: bytes, not_after: float = math.inf) -> float:
        """Let the ear hear the frame, and send it."""
        self._ear.hear(frame, self.wire)
        return await super().write(frame, not_after)


@dataclass
class Hand:
    """One session on one line, and the simulated drives behind it."""

    line: site.Line
    wire: Wire
    session: Session
    ear: Ear

    @property
    def frames(self) -> list[bytes]:
        """Return every frame that was sent, or sent since this was cleared."""
        return self.ear.frames

    def simulated(self, number: int) -> SimulatedDrive:
        """Return a simulated drive by its number, ticked up to now."""
        found = next(drive for drive in self.wire.drives if drive.number == number)
        found.tick(asyncio.get_running_loop().time())
        return found

    def drive(self, name: str) -> site.Drive:
        """Return a configured drive."""
        return next(drive for drive in self.line.drives if drive.name == name)

    def word(self, number: int, name: str) -> int:
        """Return what a simulated drive holds in its RAM."""
        return self.simulated(number).inverter.memory.word(name)

    def wear(self, number: int) -> Mapping[int, int]:
        """Return how often each place of a simulated drive's EEPROM was written."""
        return self.simulated(number).inverter.memory.eeprom_writes

    def fault(self, kind: Kind, drive: int | None = None, **more: Any) -> None:
        """Let a fault begin."""
        self.wire.faults.add(Fault(kind, drive, **more))

    def fault_at(self, request: Request, name: str, kind: Kind, **more: Any) -> None:
        """Let a fault begin with that request to a configured drive."""
        self.ear.pending.append((self.drive(name).codec.encode(request), Fault(kind, **more)))

    def sent(self, request: Request, name: str) -> int:
        """Count how often that request to a configured drive was sent."""
        return self.frames.count(self.drive(name).codec.encode(request))


def gone_from(hand: Hand, place: int) -> None:
    """Let the adapter be pulled out at that frame, counted from 0, as seen by whoever sends it and all later ones."""
    hand.frames.clear()

    def hear(frame: bytes, wire: Wire) -> None:
        if len(hand.frames) >= place:
            raise LineDown("pulled out")
        type(hand.ear).hear(hand.ear, frame, wire)

    hand.ear.hear = hear  # type: ignore[method-assign]


def configured(drives: Sequence[Mapping[str, Any]], files: Sequence[str] = (), **line: Any) -> site.Line:
    """Build a line of drives named d1, d2 ... as a configuration would."""
    tables = [
        {"name": f"d{drive['number']}", "unit": place + 1, "poll": [{"values": ["output_frequency"], "every": "1s"}]}
        | {key: value for key, value in drive.items() if key in ("number", "model", "protocol", "wait_time")}
        for place, drive in enumerate(drives)
    ]
    table = {"name": "a", "port": "/dev/null", "drive": tables, **line}
    return site.build({"gateway": {"name": "t", "catalogue": list(files)}, "line": [table]}, "test", Path()).lines[0]


def _simulated(drive: Mapping[str, Any]) -> dict[str, Any]:
    """Return the simulated drive of an entry: set to its protocol, and of another model where `is` says so."""
    entry = {key: value for key, value in drive.items() if key not in ("protocol", "wait_time", "is")}
    entry["model"] = drive.get("is", drive["model"])
    if drive.get("protocol", "modbus-rtu") != "modbus-rtu":
        entry["protocol"] = "toshiba"
    return entry


def play(
    drives: Sequence[Mapping[str, Any]],
    scene: Callable[[Hand], Awaitable[None]],
    *,
    files: Sequence[str] = (),
    line: Mapping[str, Any] | None = None,
    **sim: Any,
) -> None:
    """Open a session on simulated drives and run a scene; the gap between frames must have been kept."""

    async def main() -> None:
        table = configured(drives, files, **(line or {}))
        simulated = [_simulated(drive) for drive in drives]
        config = SimulatedLineConfig.model_validate({"drive": simulated, "catalogue": list(files), **sim})
        wire = settings.build(config, asyncio.get_running_loop().time())
        ear = Ear()

        async def open_(opening: site.Line, clock: Clock) -> Line:
            return HeardLine(wire, opening, clock, ear)

        async with opened(table, virtual.VirtualClock(), open_) as session:
            await scene(Hand(table, wire, session, ear))
        assert wire.statistics.gap_violations == 0

    virtual.run(main())
