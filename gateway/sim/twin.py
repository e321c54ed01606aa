"""A simulated line without a port: the bus's line in memory, on whatever clock it is given."""

from __future__ import annotations

import math

from gateway.clock import Clock
from gateway.errors import BadReply, LineDown, TooLate
from gateway.protocol.timing import LineTiming
from gateway.sim.wire import Wire

NEVER_QUIET = 1.0  # seconds without a gap, after which waiting for one is given up


class TwinLine:
    """Keeps the contract of a serial line towards the bus: the gap is waited for, answers come in their time."""

    is_pty = False
    may_be_simulated = False
    is_low_latency = None

    def __init__(self, wire: Wire, timing: LineTiming, clock: Clock) -> None:
        self.wire = wire
        self._timing = timing
        self._clock = clock
        self._alarm = clock.alarm()
        self._arrived = bytearray()
        self._quiet_since = clock.now()
        self._is_down = False

    async def quiet(self) -> float:
        """Wait for the gap; return since when the line is quiet."""
        self._collect()
        patience = self._clock.now() + NEVER_QUIET
        while (when := self._quiet_since + self._timing.gap) > self._clock.now():
            if when > patience:
                raise BadReply("the simulated line is never quiet")
            await self._alarm.wait_until(when)  # what arrives meanwhile moves the end of the gap
            self._collect()
        return self._quiet_since

    async def write(self, frame: bytes, not_after: float = math.inf) -> float:
        """Wait for the gap, discard what has arrived, send; return when the first bit left (monotonic)."""
        await self.quiet()
        self._arrived.clear()
        begun = self._clock.now()
        if begun > not_after:
            raise TooLate("the simulated line was free too late")
        self.wire.feed(frame, begun)
        self._quiet_since = begun + self._timing.request(len(frame))
        return begun

    async def read(self, deadline: float) -> bytes:
        """Return what arrives next, b"" when nothing has arrived by the deadline (monotonic seconds)."""
        self._collect()
        while not self._arrived and self._clock.now() < deadline:
            event = self.wire.next_event()
            await self._alarm.wait_until(deadline if event is None else min(event, deadline))
            self._collect()
        data = bytes(self._arrived)
        self._arrived.clear()
        return data

    async def drain(self, silence: float, limit: float) -> int:
        """Throw away what arrives until `silence` seconds are quiet, or `limit` seconds are over; count it."""
        end = self._clock.now() + limit
        thrown = 0
        while (now := self._clock.now()) < end:
            data = await self.read(min(now + silence, end))
            if not data:
                break
            thrown += len(data)
        return thrown

    def close(self) -> None:
        """Close the port."""
        self._alarm.close()

    def unplug(self) -> None:
        """Pull the adapter out: every call raises LineDown from now on; a new twin on the wire is the new port."""
        self._is_down = True
        self.wire.clear()

    def _collect(self) -> None:
        """Take what has arrived by now, each piece at its own time."""
        if self._is_down:
            raise LineDown("the simulated adapter was pulled out")
        now = self._clock.now()
        while (event := self.wire.next_event()) is not None and event <= now:
            for data in self.wire.due(event):
                self._arrived += data
                self._quiet_since = max(self._quiet_since, event)
