"""The loop that runs a simulated line in real time: waits, moves bytes, and measures how late it was."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import select
import time
from collections.abc import Callable
from typing import Any

from gateway.sim.lateness import Lateness
from gateway.sim.pty_port import PtyPort
from gateway.sim.wire import Wire

PR_SET_TIMERSLACK = 29  # prctl(2)
SPIN = 0.0002  # seconds: a sleep ends some 60 us late, and the event wants as much work before it


def sharpen() -> None:
    """Make this thread's waits end at once instead of within 50 us, and spare it long garbage collections.

    It takes a while the first time, and hardly any the next.
    """
    with contextlib.suppress(OSError, AttributeError):  # not on every system; the line is a little later then
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0)
    gc.collect()
    gc.freeze()


class LineLoop:
    """Runs one wire behind one port until `stop`; other descriptors may be waited on beside it.

    With `baud` the master's own setting counts: at another rate it is noise to the drives, and they to it.
    """

    def __init__(self, wire: Wire, port: PtyPort, baud: int | None = None) -> None:
        self.wire = wire
        self.port = port
        self._baud = baud
        self.lateness = Lateness()
        self.started = time.monotonic()
        self._readers: dict[int, Callable[[], None]] = {}
        self._wake_out, self._wake_in = os.pipe()
        os.set_blocking(self._wake_in, False)
        self._stops = False

    def add_reader(self, descriptor: int, reader: Callable[[], None]) -> None:
        """Call `reader` whenever the descriptor has something."""
        self._readers[descriptor] = reader

    def remove_reader(self, descriptor: int) -> None:
        """Wait on that descriptor no more."""
        self._readers.pop(descriptor, None)

    def stop(self) -> None:
        """End the loop; may be called from a signal handler or another thread until it is closed."""
        self._stops = True
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_in, b"\0")

    def run(self) -> None:
        """Run until stopped."""
        sharpen()
        while not self._stops:
            self._turn()

    def close(self) -> None:
        """Give back what the loop itself had open."""
        os.close(self._wake_out)
        os.close(self._wake_in)

    def _turn(self) -> None:
        event = self.wire.next_event()
        ready = self._wait(event)
        if self.port.descriptor in ready and (data := self.port.read()):
            self.wire.feed(data, time.monotonic(), is_noise=self._is_out_of_tune())
        if self.port.closings in ready:
            self.port.restore()
        for descriptor in ready:
            if reader := self._readers.get(descriptor):
                reader()
        if event is not None and (not ready or time.monotonic() >= event):
            self._deliver(event)

    def _is_out_of_tune(self) -> bool:
        return self._baud is not None and self.port.baud != self._baud

    def _wait(self, event: float | None) -> list[int]:
        """Wait for bytes until shortly before the event; return which descriptors have some."""
        of_port = (self.port.descriptor, self.port.closings)
        watched = [self._wake_out, *self._readers, *(one for one in of_port if one is not None)]
        if event is None:
            return select.select(watched, [], [])[0]
        left = event - time.monotonic() - SPIN
        return select.select(watched, [], [], max(0.0, left))[0]

    def _deliver(self, event: float) -> None:
        """Work out what the event brings while it is not there yet, and hand it over on time."""
        heard = self.wire.due(event)
        while time.monotonic() < event:
            pass
        is_out_of_tune = bool(heard) and self._is_out_of_tune()
        for data in heard:
            self.port.write(self.wire.faults.collided(data) if is_out_of_tune else data)
            self.lateness.add(time.monotonic() - event)

    def statistics(self) -> dict[str, Any]:
        """Return what the line counted, how long it ran, and how late the simulation was, in seconds."""
        return self.wire.statistics.as_table() | {
            "elapsed": time.monotonic() - self.started,
            "lateness_maximum": self.lateness.maximum,
            "lateness_p50": self.lateness.percentile(0.5),
            "lateness_p99": self.lateness.percentile(0.99),
        }

    def reset_statistics(self) -> None:
        """Count from now on anew."""
        self.wire.statistics.clear()
        self.lateness = Lateness()
        self.started = time.monotonic()
