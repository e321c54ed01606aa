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
import os
import select
from collections.abc import Callable, Sequence
from typing import Protocol

from gateway.clock import next_alarm

READY = 32  # clients that epoll names at once; those that a turn does not reach are first in the next one
TURN = 0.000_05  # seconds, after which a turn reads no further client; the gap of a line is 1 ms at 38400 baud
LASTS = 0.000_15  # seconds, with the writing of the answers; a line's next alarm is not nearer when a turn begins
ALONE = 2.0  # times the shortest time between two turns: in less, the loop has done nothing else
FORGETS = 1.02  # by which the shortest one grows with each turn, so that it is one of the last hundred
LEAST = 1e-7  # seconds; a clock may show the same time twice
READ_SIZE = 192  # bytes read at once: 16 requests to read, which is what a connection answers in one turn
HAS_EPOLL = hasattr(select, "epoll")
IN, OUT, GONE = (select.EPOLLIN, select.EPOLLOUT, select.EPOLLERR | select.EPOLLHUP) if HAS_EPOLL else (1, 4, 24)
NOBODY: Sequence[tuple[int, int]] = ()

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


class Client(Protocol):
    """A client's socket, as a turn sees it."""

    def take(self, data: bytes, now: float) -> None:
        """Hand on what came, where something is unsent or paused."""
        ...

    def look(self, events: int) -> bool:
        """Take what epoll says besides that there is something to read; say whether that is to be looked for too."""
        ...

    def read_failed(self, error: OSError | None) -> None:
        """Take that there is nothing more to read: an error, or None for the end of what the client sends."""
        ...

    def write(self, data: bytes) -> None:
        """Send what the system takes, and the rest when it takes more."""
        ...

    def abort(self) -> None:
        """Close at once."""
        ...


class Turns:
    """All clients of one server, in one epoll instance that the loop knows as one descriptor."""

    def __init__(
        self, loop: asyncio.AbstractEventLoop, now: Callable[[], float], next_alarm: Callable[[], float] = next_alarm
    ) -> None:
        self._loop = loop
        self._now = now
        self._next_alarm = next_alarm
        self._epoll = select.epoll()
        self._clients: dict[int, Client] = {}
        self._asking: dict[int, AnswerNow] = {}  # those who wait for nothing but what their clients ask
        self._answers: dict[int, bytes] = {}  # of this turn, not written yet; nothing is unsent in front of them
        self._left: Sequence[tuple[int, int]] = NOBODY  # named by epoll, and not reached in the last turn
        self._ended = 0.0  # when the last turn did
        self._shortest = float("inf")  # seconds from the end of a turn to the next one, when nothing else was done
        loop.add_reader(self._epoll.fileno(), self._turn)

    def add(self, fd: int, client: Client, answer_now: AnswerNow, mask: int) -> None:
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
        self._shortest = max(min(since, self._shortest * FORGETS), LEAST)
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
