"""The network between the gateway and all others: pipes in the world's time, which can be slow, held up or cut."""

from __future__ import annotations

import socket
from collections import deque
from collections.abc import Callable
from typing import Any

from tests.simulation.broker import Broker, Message, Peer
from tests.simulation.loop import SimulatedLoop
from tests.simulation.world import World

READ_SIZE = 65_536  # bytes
AGAIN = 0.01  # seconds, where the gateway does not read and its socket is full
CLIENT_PORT = 40_000

Delivered = Callable[[], None]


class End(socket.socket):
    """One end of a pipe that takes itself for TCP: it has a peer with an address, and takes TCP's options."""

    peer: tuple[str, int] = ("", 0)

    def setsockopt(self, *_: Any) -> None:
        """Take an option."""

    def getpeername(self) -> tuple[str, int]:
        """Return who is at the other end."""
        return self.peer


def pipe(peer: tuple[str, int]) -> tuple[socket.socket, End]:
    """Make a pipe: the world's end, and the gateway's, to which the other one is `peer`."""
    ours, theirs = socket.socketpair()
    end = End(theirs.family, theirs.type, theirs.proto, theirs.detach())
    end.peer = peer
    for each in (ours, end):
        each.setblocking(False)
    return ours, end


class Cable:
    """One connection of the gateway, seen from the world. `heard` takes what the gateway sends, b"" at its end."""

    def __init__(
        self, world: World, loop: SimulatedLoop, end: socket.socket, latency: float, heard: Callable[[bytes], None]
    ) -> None:
        self.is_open = True
        self._world = world
        self._loop = loop
        self._end = end
        self._latency = latency
        self._heard = heard
        self._waiting: deque[tuple[float, bytes, Delivered | None]] = deque()
        self._held_until = 0.0
        self._is_closing = False
        loop.watch(end, self._take)

    def send(self, data: bytes, delivered: Delivered | None = None) -> None:
        """Send bytes; `delivered` is called when they are in the gateway's socket."""
        if not self.is_open:
            return
        due = max(self._world.now + self._latency, self._waiting[-1][0] if self._waiting else 0.0)
        self._waiting.append((due, data, delivered))
        self._world.at(due, self._flush)

    def hold(self, seconds: float) -> None:
        """Let nothing through for so long, as a network does that is cut and mended in time."""
        self._held_until = max(self._held_until, self._world.now + seconds)
        self._world.at(self._held_until, self._flush)
        self._world.at(self._held_until, self._take)

    def close(self) -> None:
        """Close behind what is on its way."""
        self._is_closing = True
        self._world.after(self._latency, self._flush)

    def cut(self) -> None:
        """Part at once; the gateway sees the connection end."""
        if self.is_open:
            self.is_open = False
            self._loop.unwatch(self._end)
            self._end.close()
            self._heard(b"")

    def _flush(self) -> None:
        """Put into the gateway's socket what is due, as far as it takes it."""
        now = self._world.now
        if not self.is_open or now < self._held_until:
            return
        self._world.has_sent = True
        while self._waiting and self._waiting[0][0] <= now:
            _, data, delivered = self._waiting[0]
            try:
                sent = self._end.send(data)
            except BlockingIOError:
                sent = 0
            except OSError:
                self.cut()
                return
            if sent < len(data):
                self._waiting[0] = (now, data[sent:], delivered)
                self._world.after(AGAIN, self._flush)
                return
            self._waiting.popleft()
            if delivered is not None:
                delivered()
        if self._is_closing and not self._waiting:
            self.cut()

    def _take(self) -> None:
        if not self.is_open or self._world.now < self._held_until:
            return
        try:
            data = self._end.recv(READ_SIZE)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._heard(data)
        else:
            self.cut()


class BrokerLink:
    """The broker's way to the gateway."""

    def __init__(self, world: World, loop: SimulatedLoop, broker: Broker, end: socket.socket, latency: float) -> None:
        self.cable = Cable(world, loop, end, latency, self._heard)
        self._world = world
        self._peer: Peer = broker.accept(self)

    def _heard(self, data: bytes) -> None:
        if data:
            self._peer.feed(data)
        else:
            self._peer.lost()

    def send(self, data: bytes, message: Message | None) -> None:
        """Send bytes; whoever published the message that they carry is told when they have arrived."""
        tag = message.tag if message is not None else None
        self.cable.send(data, tag if callable(tag) else None)

    def close(self) -> None:
        """Close the connection."""
        self.cable.close()


class Network:
    """What the gateway reaches by TCP, and who reaches it."""

    def __init__(self, world: World, loop: SimulatedLoop, broker: Broker) -> None:
        self.broker = broker
        self.is_broker_up = True
        self.latency = 0.002  # seconds, one way
        self.links: list[BrokerLink] = []
        self.clients: list[Cable] = []
        self._world = world
        self._loop = loop
        self._port = CLIENT_PORT

    def create_connection(self, address: tuple[str, int], *_: Any, **__: Any) -> socket.socket:
        """Stand for socket.create_connection: only the broker is there."""
        if not self.is_broker_up:
            raise ConnectionRefusedError(111, f"{address[0]} port {address[1]}: connection refused")
        ours, theirs = pipe(address)
        self.links = [link for link in self.links if link.cable.is_open]
        self.links.append(BrokerLink(self._world, self._loop, self.broker, ours, self.latency))
        return theirs

    def dial(self, address: str, port: int, heard: Callable[[bytes], None]) -> Cable | None:
        """Connect to the gateway's server from an address; None where nobody listens."""
        listener = self._loop.listeners.get(port)
        if listener is None:
            return None
        self._port += 1
        ours, theirs = pipe((address, self._port))
        listener.accept(theirs)
        self.clients = [cable for cable in self.clients if cable.is_open]
        self.clients.append(Cable(self._world, self._loop, ours, self.latency, heard))
        return self.clients[-1]

    def partition(self, seconds: float, *, is_lost: bool) -> None:
        """Part the gateway from the broker for a time; `is_lost`: the connection does not survive it."""
        self._world.note("partition", seconds, is_lost)
        for link in self.links:
            link.cable.hold(seconds)
            if is_lost:
                self._world.after(seconds, link.cable.cut)

    def take_down(self, seconds: float, *, is_forgetful: bool) -> None:
        """Restart the broker: it is away for so long."""
        self._world.note("broker down", seconds, is_forgetful)
        self.is_broker_up = False
        self.broker.restart(is_forgetful=is_forgetful)
        for link in self.links:
            link.cable.cut()
        self._world.after(seconds, self._bring_up)

    def _bring_up(self) -> None:
        self.is_broker_up = True

    def sever(self) -> None:
        """End every connection of the gateway's process, which was killed."""
        for cable in (*(link.cable for link in self.links), *self.clients):
            cable.cut()
