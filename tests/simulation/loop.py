"""The gateway's event loop in the world's time: it never waits, and stands still when the world says so."""

from __future__ import annotations

import asyncio
import selectors
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tests.simulation.world import World
from tests.virtual import VirtualAlarm

Factory = Callable[[], asyncio.BaseProtocol]
Ready = list[tuple[selectors.SelectorKey, int]]


@dataclass(frozen=True, slots=True)
class Watch:
    """The world's end of a pipe to the gateway: called when the gateway has written."""

    action: Callable[[], None]


class WorldSelector(selectors.EpollSelector):
    """Where the loop would wait, the world moves on; its own ends of pipes are served at once."""

    def __init__(self, world: World) -> None:
        super().__init__()
        self._world = world
        self._order: dict[int, int] = {}
        self._registered = 0

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        """Register, and remember the order: descriptors are numbered by chance."""
        key = super().register(fileobj, events, data)
        self._order[key.fd] = self._registered = self._registered + 1
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        """Forget it."""
        key = super().unregister(fileobj)
        self._order.pop(key.fd, None)
        return key

    def serve(self) -> Ready:
        """Take what the gateway has written; return what is ready for the gateway, oldest registration first."""
        ready = super().select(0)
        if not ready:
            return ready
        if len(ready) > 1:
            ready.sort(key=lambda item: self._order[item[0].fd])
        for key, _ in ready:
            if isinstance(key.data, Watch):
                key.data.action()
        return [item for item in ready if not isinstance(item[0].data, Watch)]

    def select(self, timeout: float | None = None) -> Ready:
        """Return what is ready; if nothing is, the world moves on to its next event or the loop's next timer."""
        ready = self.serve()
        if ready or (timeout is not None and timeout <= 0):
            return ready
        world = self._world
        if not world.advance(float("inf") if timeout is None else world.now + timeout):
            raise AssertionError("everybody waits for something that never comes")
        while world.now < world.frozen_until:
            world.advance(world.frozen_until)
        if not world.has_sent:
            return []
        world.has_sent = False
        return self.serve()


@dataclass
class Listener:
    """A server in this loop: it stands for asyncio's, behind pipes instead of TCP."""

    factory: Factory
    address: tuple[str, int]
    loop: SimulatedLoop
    is_open: bool = True
    tasks: list[asyncio.Task[Any]] = field(default_factory=list)

    @property
    def sockets(self) -> list[Listener]:
        """Return itself: it is its own listening socket."""
        return [self]

    def getsockname(self) -> tuple[str, int]:
        """Return where it listens."""
        return self.address

    def close(self) -> None:
        """Take no more clients."""
        self.is_open = False
        self.loop.listeners.pop(self.address[1], None)

    async def wait_closed(self) -> None:
        """Return at once: the connections are the server's own business."""

    def accept(self, end: socket.socket) -> None:
        """Serve a client at the other end of a pipe."""
        self.tasks.append(self.loop.create_task(self.loop.connect_accepted_socket(self.factory, end)))


class SimulatedLoop(asyncio.SelectorEventLoop):
    """An event loop that goes by the time of a world."""

    def __init__(self, world: World) -> None:
        self.world = world
        self.pipes = WorldSelector(world)
        self.listeners: dict[int, Listener] = {}
        super().__init__(self.pipes)

    def time(self) -> float:
        """Return the world's seconds."""
        return self.world.now

    async def create_server(self, protocol_factory: Factory, host: Any, port: Any, **_: Any) -> Any:  # type: ignore[override]
        """Listen on a port of the simulation."""
        listener = Listener(protocol_factory, (host, port), self)
        self.listeners[port] = listener
        return listener

    def watch(self, end: socket.socket, action: Callable[[], None]) -> None:
        """Call an action of the world whenever the gateway has written to the other end."""
        self.pipes.register(end, selectors.EVENT_READ, Watch(action))

    def unwatch(self, end: socket.socket) -> None:
        """Look at it no more."""
        self.pipes.unregister(end)


class SimulatedClock:
    """The gateway's clock."""

    def __init__(self, world: World) -> None:
        self._world = world

    def now(self) -> float:
        """Return monotonic seconds."""
        return self._world.look()

    def wall(self) -> float:
        """Return UTC seconds, as the machine's clock has them."""
        return self._world.wall()

    def alarm(self) -> VirtualAlarm:
        """Make a timer."""
        return VirtualAlarm()
