"""A simulated line as something that can be acted upon: its wire and drives, its port, and what is written of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from gateway.sim.capture import Capture
from gateway.sim.drive import SimulatedDrive
from gateway.sim.journal import Entry, Way
from gateway.sim.options import MODBUS_RTU, TOSHIBA
from gateway.sim.wire import Wire


class WrongRequest(Exception):
    """What was asked cannot be done; the message says why."""


class Adapter(Protocol):
    """What the line is plugged in with."""

    name: str

    def unplug(self) -> None:
        """Pull it out."""
        ...

    def plug(self) -> None:
        """Put it back."""
        ...


class Doing(Protocol):
    """Something that can be done to a line."""

    def act(self, line: Installation, now: float) -> Any:
        """Do it; WrongRequest says why not."""
        ...


class Installation:
    """The line; `opened` is when, on its clock. A line in memory has no port."""

    def __init__(
        self, wire: Wire, opened: float, names: Mapping[str, SimulatedDrive], port: Adapter | None = None
    ) -> None:
        self.wire = wire
        self.opened = opened
        self.names = names
        self._port = port
        self._done = self._failed = 0
        self._capture: Capture | None = None

    @property
    def port(self) -> Adapter:
        """Return the port; WrongRequest where there is none."""
        if self._port is None:
            raise WrongRequest("this line is in memory: it has no port")
        return self._port

    def do(self, doing: Doing, now: float) -> Any:
        """Do something, and enter in the journal that it was done, or why it could not be."""
        try:
            result = doing.act(self, now)
        except WrongRequest as error:
            self._failed += 1
            self._enter(f"{doing}: {error}", now)
            raise
        self._done += 1
        self._enter(str(doing), now)
        return result

    def _enter(self, note: str, now: float) -> None:
        self.wire.journal.add(Entry(Way.EVENT, now, now, b"", None, note))

    def counts(self) -> dict[str, Any]:
        """Return what was done to the line and could not be done, and how often each kind of fault struck."""
        return {"done": self._done, "failed": self._failed, "faults": dict(self.wire.faults.struck)}

    def reset_counts(self) -> None:
        """Count from now on anew."""
        self._done = self._failed = 0
        self.wire.faults.struck.clear()

    def drive(self, key: int | str, now: float) -> SimulatedDrive:
        """Return the drive of that number, as it is now, or name; ticked up to now."""
        drive = self.find(key)
        if drive is None:
            known = ", ".join([*(str(drive.number) for drive in self.wire.drives), *self.names])
            raise WrongRequest(f"no drive {key}; on the line: {known}")
        drive.tick(now)
        return drive

    def drives(self, key: int | str | None, now: float) -> Sequence[SimulatedDrive]:
        """Return the drive of that number or name; without one, all."""
        if key is not None:
            return [self.drive(key, now)]
        for drive in self.wire.drives:
            drive.tick(now)
        return self.wire.drives

    def find(self, key: int | str) -> SimulatedDrive | None:
        """Return the drive of that number, the first in the file where several have it, or of that name."""
        if isinstance(key, str):
            return self.names.get(key)
        return next((drive for drive in self.wire.drives if drive.number == key), None)

    def name_of(self, drive: SimulatedDrive) -> str | None:
        """Return the name that the file gives a drive; None for none."""
        return next((name for name, named in self.names.items() if named is drive), None)

    def capture(self, path: Path | None) -> None:
        """Write the frames from now on to a file; None ends it. OSError where that cannot be."""
        if self._capture is not None:
            self.wire.journal.ignore(self._capture.write)
            self._capture.close()
            self._capture = None
        if path is not None:
            has_modbus = any(drive.protocol == MODBUS_RTU for drive in self.wire.drives)
            self._capture = Capture(path, self.opened, MODBUS_RTU if has_modbus else TOSHIBA)
            self.wire.journal.listen(self._capture.write)
