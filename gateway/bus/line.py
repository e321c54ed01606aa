"""What the bus needs of a line: a half-duplex byte pipe that knows time, not protocols."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Protocol

from gateway import site
from gateway.clock import Clock

SETTLE = 0.1  # seconds of silence after opening: half a frame of whoever spoke before is let go
LATE_AT_MOST = 0.4  # seconds after a time-out in which the old answer may still come, twice the margin at least


class Line(Protocol):
    """A port with drives behind it. Every method raises LineDown once the port is gone."""

    @property
    def is_pty(self) -> bool:
        """Say whether the port is a pseudo-terminal: no real line, so its timing proves nothing."""
        ...

    @property
    def may_be_simulated(self) -> bool:
        """Say whether drives without wire timing may be behind the port: it leads to this machine alone."""
        ...

    @property
    def is_low_latency(self) -> bool | None:
        """Say whether the driver hands bytes on at once; None where there is no driver that could hold them back."""
        ...

    async def quiet(self) -> float:
        """Wait for the gap; return since when it is quiet. BadReply where it is not within a second."""
        ...

    async def write(self, frame: bytes, not_after: float = ...) -> float:
        """Wait for the gap, discard what has arrived, send; return when the first bit left (monotonic).

        BadReply where the line does not become quiet within a second; TooLate where it is free only after
        `not_after` (monotonic seconds): nothing was sent then.
        """
        ...

    async def read(self, deadline: float) -> bytes:
        """Return what arrives next, b"" when nothing has arrived by the deadline (monotonic seconds)."""
        ...

    async def drain(self, silence: float, limit: float) -> int:
        """Throw away what arrives until `silence` seconds are quiet, or `limit` seconds are over; count it."""
        ...

    def close(self) -> None:
        """Close the port."""
        ...


Opener = Callable[[site.Line, Clock], Awaitable[Line]]
