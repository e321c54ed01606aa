"""A simulated RS485 line behind the gateway's own serial line: a socket pair stands for the tty."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable

from gateway import site
from gateway.bus.line import Line
from gateway.bus.serial_line import DescriptorLine
from gateway.clock import Clock
from gateway.errors import LineDown
from gateway.sim.wire import Wire
from tests.simulation.loop import SimulatedLoop
from tests.simulation.world import Event, World

READ_SIZE = 4096  # bytes


class Port:
    """An adapter with a line behind it. What the gateway writes goes on the wire at once, byte after byte."""

    def __init__(self, world: World, loop: SimulatedLoop, wire: Wire) -> None:
        self.wire = wire
        self.is_plugged = True
        self._world = world
        self._loop = loop
        self.on_change: Callable[[], None] = lambda: None  # called when something has happened on the line
        self._listeners: list[Callable[[bytes], None]] = []
        self._end: socket.socket | None = None
        self._next: Event | None = None

    async def open(self, line: site.Line, clock: Clock) -> Line:
        """Open the port for the gateway; LineDown where the adapter is not there, or somebody else has it."""
        if not self.is_plugged:
            raise LineDown(f"{line.port}: no such device")
        if self._end is not None:
            raise LineDown(f"{line.port}: in use by another process")
        self._end, theirs = socket.socketpair()
        for end in (self._end, theirs):
            end.setblocking(False)
        self._loop.watch(self._end, self._take)
        return DescriptorLine(line.port, theirs, line.timing, clock, is_pty=False)

    def listen(self, listener: Callable[[bytes], None]) -> None:
        """Call `listener` with every frame in the moment in which the gateway writes it."""
        self._listeners.append(listener)

    def unplug(self) -> None:
        """Pull the adapter out: what is on the line is lost."""
        self._world.note("unplug")
        self.is_plugged = False
        self.sever()
        self.wire.clear()

    def plug(self) -> None:
        """Put the adapter back."""
        self._world.note("plug")
        self.is_plugged = True

    def sever(self) -> None:
        """Part with whoever has the port open: the process was killed, or the adapter is gone."""
        if self._end is not None:
            self._loop.unwatch(self._end)
            self._end.close()
            self._end = None

    def _take(self) -> None:
        end = self._end
        if end is None:
            return
        try:
            data = end.recv(READ_SIZE)
        except OSError:
            data = b""
        if not data:
            self.sever()
            return
        for listener in self._listeners:
            listener(data)
        self.wire.feed(data, self._world.now)
        self.plan()

    def plan(self) -> None:
        """Be there when something happens on the line next."""
        if self._next is not None:
            self._next.call_off()
        when = self.wire.next_event()
        self._next = None if when is None else self._world.at(when, self._pump)

    def _pump(self) -> None:
        self._next = None
        for data in self.wire.due(self._world.now):
            if self._end is not None:
                self._world.has_sent = True
                with contextlib.suppress(OSError):
                    self._end.send(data)
        self.on_change()
        self.plan()
