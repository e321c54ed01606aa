"""Clients' sockets, read in short turns: a line waits for one turn at most, however many clients ask.

The transports of an event loop read every socket that has something before anything else goes on: with a hundred
busy clients that is a millisecond, in which no line is served. Here one epoll instance stands for all clients and is
one descriptor in the loop. A turn reads what some of them sent, for a bounded time, and then writes all their
answers; who is not reached is first in the next one, and in between the loop looks after the lines.

Answers are written back to back because only the first of them has to wake a client's machine that sleeps. Writing
takes about twice as long as reading and answering, so a turn lasts some 150 microseconds, and so long a line waits
at the most: unless the last client that was read has sent many requests at once, or such that are asked for the
first time, of which one connection answers a limited number.

A line's own moments are the ends of its gaps, for which it has set an alarm: no turn of more than one client begins
shortly before. What a line does then, or when an answer has arrived, goes on over several rounds of the loop: while
there is something else to do in them, a turn takes one client only. Whether there was shows in the time since the
last turn: against the shortest such time, because that is the machine's and the loop's own.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import select
import socket
from collections.abc import Callable, Sequence
from typing import cast

from gateway.clock import next_alarm

log = logging.getLogger("gateway.modbus_tcp")

READY = 32  # clients that epoll names at once; those that a turn does not reach are first in the next one
TURN = 0.000_05  # seconds, after which a turn reads no further client; the gap of a line is 1 ms at 38400 baud
LASTS = 0.000_15  # seconds, with the writing of the answers; a line's next alarm is not nearer when a turn begins
ALONE = 2.0  # times the shortest time between two turns: in less, the loop has done nothing else
FORGETS = 1.02  # by which the shortest one grows with each turn, so that it is one of the last hundred
READ_SIZE = 192  # bytes read at once: 16 requests to read, which is what a connection answers in one turn
ACCEPT_AGAIN = 1.0  # seconds, where the process or the system has no descriptor or memory left for a client
SHORT_OF = frozenset((errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM))
HAS_EPOLL = hasattr(select, "epoll")
IN, OUT, GONE = (select.EPOLLIN, select.EPOLLOUT, select.EPOLLERR | select.EPOLLHUP) if HAS_EPOLL else (1, 4, 24)
NOBODY: Sequence[tuple[int, int]] = ()
DISCARDED = 64 * 1024  # bytes, that are taken off the system when a connection closes in order
WRITE_BUFFER = 64 * 1024  # bytes, by default, as asyncio has it


AnswerNow = Callable[[bytes, float], bytes | None]
"""Takes what a client sent; see Answering.answer_now."""


class Answering(asyncio.Protocol):
    """A protocol that may return its answer instead of writing it: a turn writes the answers of all in its end."""

    def answer_now(self, data: bytes, now: float) -> bytes | None:
        """Take what came; return what is to be sent next, None where nothing is, or where it was written.

        `now` is when the turn came to this client (monotonic seconds).
        """
        self.data_received(data)
        return None


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


class Turns:
    """All clients of one server, in one epoll instance that the loop knows as one descriptor."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, now: Callable[[], float], next_alarm: Callable[[], float] = next_alarm
    ) -> None:
        self._loop = loop
        self._now = now
        self._next_alarm = next_alarm
        self._epoll = select.epoll()
        self._clients: dict[int, ClientSocket] = {}
        self._asking: dict[int, AnswerNow] = {}  # those who wait for nothing but what their clients ask
        self._answers: dict[int, bytes] = {}  # of this turn, not written yet; nothing is unsent in front of them
        self._left: Sequence[tuple[int, int]] = NOBODY  # named by epoll, and not reached in the last turn
        self._ended = 0.0  # when the last turn did
        self._shortest = float("inf")  # seconds from the end of a turn to the next one, when nothing else was done
        loop.add_reader(self._epoll.fileno(), self._turn)

    def add(self, fd: int, client: ClientSocket, answer_now: AnswerNow, mask: int) -> None:
        """Serve a client from the next turn on."""
        self._epoll.register(fd, mask)
        self._clients[fd] = client
        self._asking[fd] = answer_now

    def change(self, fd: int, answer_now: AnswerNow, mask: int) -> None:
        """Look for other events of a client."""
        self._epoll.modify(fd, mask)
        self._asking.pop(fd, None)
        if mask == IN:
            self._asking[fd] = answer_now

    def drop(self, fd: int) -> None:
        """Serve a client no more; its descriptor may be closed then."""
        del self._clients[fd]
        self._asking.pop(fd, None)
        self._answers.pop(fd, None)
        self._epoll.unregister(fd)

    def held(self, fd: int) -> bytes:
        """Return a client's answer of this turn, empty where there is none; who asks for it writes it."""
        return self._answers.pop(fd, b"")

    def _turn(self) -> None:
        asking, answers, clock, read = self._asking, self._answers, self._now, os.read
        now = clock()
        since = now - self._ended
        self._shortest = min(since, self._shortest * FORGETS)
        is_free = since <= ALONE * self._shortest and self._next_alarm() - now > LASTS
        end = now + TURN if is_free else now
        ready = iter(self._left or self._epoll.poll(0, READY))
        self._left = NOBODY
        for fd, events in ready:
            try:
                answer_now = (asking.get(fd) if events == IN else None) or self._look(fd, events)
                if answer_now is None:
                    continue  # cut for something else that came meanwhile; or there is nothing to read
                data = read(fd, READ_SIZE)
                if data:
                    answer = answer_now(data, now)
                    if answer is not None:
                        answers[fd] = answer
                else:
                    self._clients[fd].read_failed(None)
            except (BlockingIOError, InterruptedError):
                continue
            except OSError as error:
                if fd in self._clients:
                    self._clients[fd].read_failed(error)
            except Exception as error:
                self._failed(fd, error)
            now = clock()
            if now > end:
                self._left = tuple(ready)
                break
        self._write()
        self._ended = clock()

    def _look(self, fd: int, events: int) -> AnswerNow | None:
        """See to what a client waits for besides; return who takes what it asks, None where it is not to be read."""
        client = self._clients.get(fd)
        return None if client is None or not client.look(events) else client.take

    def _write(self) -> None:
        """Write what was answered in this turn."""
        write = os.write
        answers, self._answers = self._answers, {}
        for fd, answer in answers.items():
            try:
                sent = write(fd, answer)
            except OSError:
                sent = 0  # what it was shows when it is written again
            if sent != len(answer):
                self._write_on(fd, answer[sent:])

    def _write_on(self, fd: int, rest: bytes) -> None:
        try:
            self._clients[fd].write(rest)
        except Exception as error:
            self._failed(fd, error)

    def _failed(self, fd: int, error: Exception) -> None:
        """Report a defect; it costs this client its connection, and nobody else anything."""
        self._loop.call_exception_handler({"message": "a MODBUS-TCP connection failed", "exception": error})
        if fd in self._clients:
            self._clients[fd].abort()

    def close(self) -> None:
        """Leave the loop."""
        self._loop.remove_reader(self._epoll.fileno())
        self._epoll.close()


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
