"""Clients' sockets and the listening ones, without the transports of an event loop: turns.py says why."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import socket
from collections.abc import Callable, Sequence
from typing import cast

from gateway.modbus_tcp.turns import GONE, HAS_EPOLL, IN, OUT, Answering, Turns

log = logging.getLogger("gateway.modbus_tcp")

ACCEPT_AGAIN = 1.0  # seconds, where the process or the system has no descriptor or memory left for a client
SHORT_OF = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))
DISCARDED = 64 * 1024  # bytes, that are taken off the system when a connection closes in order
WRITE_BUFFER = 64 * 1024  # bytes, by default, as asyncio has it


class ClientSocket(asyncio.Transport):
    """One client's socket, with the contract of asyncio.Transport as far as a connection uses it."""

    def __init__(self, client: socket.socket, peer: object, protocol: Answering, turns: Turns) -> None:
        super().__init__({"socket": client, "peername": peer})
        self._socket = client
        self._fd = client.fileno()
        self._protocol = protocol
        self._turns = turns
        self._unsent = bytearray()
        self._high, self._low = WRITE_BUFFER, WRITE_BUFFER // 4
        self._is_full = False  # the protocol was told to write no further
        self._is_reading = True
        self._is_closing = False
        self._is_cut = False
        self._is_lost = False
        self._mask = IN
        turns.add(self._fd, self, protocol.answer_now, self._mask)

    def take(self, data: bytes, _now: float) -> None:
        """Hand on what came; its answer is written behind what is unsent."""
        self._protocol.data_received(data)

    def read_failed(self, error: OSError | None) -> None:
        """Take that there is nothing more to read: an error, or None for the end of what the client sends."""
        if error is not None:
            self._lose(error)
        elif self._protocol.eof_received():
            self.pause_reading()  # the end stands there for good
        else:
            self.close()

    def look(self, events: int) -> bool:
        """Take what epoll says besides that there is something to read; say whether that is to be looked for too."""
        if self._unsent and events & OUT:
            self._flush()
        if self._mask & IN and not self._is_lost:
            return True  # an error shows in reading
        if events & GONE:
            self._lose(None)
        return False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send at once what the system takes, and the rest when it takes more; an answer of this turn goes first."""
        if not self._is_closing:
            self._send(self._turns.held(self._fd) + data)

    def _send(self, data: bytes) -> None:
        if not self._unsent:
            try:
                sent = os.write(self._fd, data)
            except (BlockingIOError, InterruptedError):
                sent = 0
            except OSError as error:
                self._lose(error)
                return
            if sent == len(data):
                return
            data = data[sent:]
        self._unsent += data
        self._watch()
        if len(self._unsent) > self._high and not self._is_full:
            self._is_full = True
            self._protocol.pause_writing()

    def _flush(self) -> None:
        try:
            sent = os.write(self._fd, self._unsent)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._lose(error)
            return
        del self._unsent[:sent]
        if not self._unsent and self._is_closing:
            self._lose(None)
            return
        self._watch()
        if self._is_full and len(self._unsent) <= self._low:
            self._is_full = False
            self._protocol.resume_writing()

    def _watch(self) -> None:
        """Have epoll look for what this socket waits for."""
        if self._is_lost:
            return
        is_read = self._is_reading and not self._is_closing
        mask = (IN if is_read else 0) | (OUT if self._unsent else 0)
        if mask != self._mask:
            self._mask = mask
            self._turns.change(self._fd, self._protocol.answer_now, mask)

    def pause_reading(self) -> None:
        """Read no more."""
        self._is_reading = False
        self._watch()

    def resume_reading(self) -> None:
        """Read again."""
        self._is_reading = True
        self._watch()

    def is_reading(self) -> bool:
        """Say whether the socket is read."""
        return self._is_reading and not self._is_closing

    def set_protocol(self, protocol: asyncio.BaseProtocol) -> None:
        """Let another protocol have all that comes from now on."""
        self._protocol = cast("Answering", protocol)
        if not self._is_lost:
            self._turns.change(self._fd, self._protocol.answer_now, self._mask)

    def get_protocol(self) -> Answering:
        """Return who has what comes."""
        return self._protocol

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Set how many unsent bytes stop the protocol, and at how many it goes on."""
        self._high = WRITE_BUFFER if high is None else high
        self._low = self._high // 4 if low is None else low

    def get_write_buffer_size(self) -> int:
        """Return how many bytes are unsent."""
        return len(self._unsent)

    def is_closing(self) -> bool:
        """Say whether the socket is closed, or about to be."""
        return self._is_closing

    def close(self) -> None:
        """Read no more, and close when everything is sent."""
        held = self._turns.held(self._fd)
        if held:
            self._send(held)
        self._is_closing = True
        if self._unsent:
            self._watch()
        else:
            self._lose(None)

    def abort(self) -> None:
        """Close at once."""
        self._is_cut = True
        self._lose(None)

    def _lose(self, error: Exception | None) -> None:
        if self._is_lost:
            return
        self._is_lost = self._is_closing = True
        self._unsent.clear()
        self._turns.drop(self._fd)
        asyncio.get_running_loop().call_soon(self._end, error)

    def _end(self, error: Exception | None) -> None:
        try:
            self._protocol.connection_lost(error)
        finally:
            if error is None and not self._is_cut:
                self._discard()
            self._socket.close()

    def _discard(self) -> None:
        """Take what nobody will read: unread, it would make of the end a reset, which may cost the last answers."""
        with contextlib.suppress(OSError):
            os.read(self._fd, DISCARDED)


class Listener:
    """Sockets that are listened on; the contract is that of asyncio.Server as far as it is used here."""

    def __init__(
        self, sockets: Sequence[socket.socket], connect: Callable[[], Answering], now: Callable[[], float]
    ) -> None:
        self.sockets = tuple(sockets)
        self._connect = connect
        self._loop = asyncio.get_running_loop()
        self._turns = Turns(self._loop, now)
        self._waiting: set[asyncio.TimerHandle] = set()
        for listening in self.sockets:
            self._loop.add_reader(listening.fileno(), self._accept, listening)

    def _accept(self, listening: socket.socket) -> None:
        """Take one client; the next one's turn is after what else the loop has to do."""
        try:
            client, peer = listening.accept()
        except (BlockingIOError, InterruptedError, ConnectionAbortedError):
            return
        except OSError as error:
            if error.errno not in SHORT_OF:
                raise
            log.error("no client can be taken for %g s: %s", ACCEPT_AGAIN, error.strerror)
            self._loop.remove_reader(listening.fileno())
            self._loop.call_later(ACCEPT_AGAIN, self._accept_again, listening)
            return
        client.setblocking(False)
        with contextlib.suppress(OSError):  # it may be gone already
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        protocol = self._connect()
        protocol.connection_made(ClientSocket(client, peer, protocol, self._turns))

    def _accept_again(self, listening: socket.socket) -> None:
        if listening.fileno() >= 0:
            self._loop.add_reader(listening.fileno(), self._accept, listening)

    def close(self) -> None:
        """Take no further client."""
        for listening in self.sockets:
            if listening.fileno() >= 0:
                self._loop.remove_reader(listening.fileno())
                listening.close()

    async def wait_closed(self) -> None:
        """Leave the loop; to be called when every client is gone."""
        self._turns.close()


async def listen(
    connect: Callable[[], Answering], now: Callable[[], float], host: str, port: int, backlog: int
) -> Listener | asyncio.Server:
    """Listen on every address of a host; OSError where one is not to be had. Without epoll the loop's own serve.

    `now` tells monotonic seconds.
    """
    loop = asyncio.get_running_loop()
    if not HAS_EPOLL:
        return await loop.create_server(connect, host, port, backlog=backlog)
    found = await loop.getaddrinfo(host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    sockets: list[socket.socket] = []
    try:
        for family, kind, protocol, _, address in dict.fromkeys(found):
            sockets.append(_bound(family, kind, protocol, address, backlog))
    except OSError:
        for listening in sockets:
            listening.close()
        raise
    return Listener(sockets, connect, now)


def _bound(family: int, kind: int, protocol: int, address: object, backlog: int) -> socket.socket:
    listening = socket.socket(family, kind, protocol)
    try:
        listening.setblocking(False)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listening.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        listening.bind(cast("tuple[str, int]", address))
        listening.listen(backlog)
    except OSError:
        listening.close()
        raise
    return listening
