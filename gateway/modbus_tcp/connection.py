"""One MODBUS-TCP client and the limits it lives under: turns, buffers, places and time-outs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Mapping
from typing import cast

from gateway.clock import Clock
from gateway.control.command import Channel, Source
from gateway.metrics import TcpStats
from gateway.modbus_tcp.responder import GO_ON, READ_ON, Later, Responder, Write
from gateway.modbus_tcp.writing import DriveWriter, MirrorWriter

log = logging.getLogger("gateway.modbus_tcp")

IN_FLIGHT = 16  # requests of one client that are answered before the others have their turn
WRITE_BUFFER = 64 * 1024  # bytes; beyond them the client's requests wait until it has read
DRAIN_WITHIN = 4.0  # seconds; a client that does not read is cut by the sweep after it, 5 s at the latest
KEEP_ALIVE = (("TCP_KEEPIDLE", 15), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3))  # a dead peer is gone after 30 s


class Places:
    """The connections that are served. When all places are taken the next client is turned away at once."""

    def __init__(self, limit: int, stats: TcpStats) -> None:
        self.taken: set[Connection] = set()
        self.all_free = asyncio.Event()
        self.all_free.set()
        self._limit = limit
        self._stats = stats
        self._has_told = False  # that all places are taken

    def take(self, connection: Connection) -> bool:
        """Give the connection a place; False when none is left."""
        if len(self.taken) >= self._limit:
            self._stats.turned_away += 1
            if not self._has_told:
                log.warning("all %d connections are taken: further clients are turned away", self._limit)
            self._has_told = True
            return False
        self.taken.add(connection)
        self.all_free.clear()
        self._stats.accepted += 1
        self._stats.connections = len(self.taken)
        return True

    def give_back(self, connection: Connection) -> None:
        """Take a connection off, if it had a place."""
        if connection in self.taken:
            self.taken.remove(connection)
            self._stats.connections = len(self.taken)
            self._has_told = False
        if not self.taken:
            self.all_free.set()


class Connection(asyncio.Protocol):
    """One client. Its requests are answered in turns, so that it cannot keep the loop from the lines."""

    def __init__(
        self,
        responder: Responder,
        clock: Clock,
        places: Places,
        writers: Mapping[int, DriveWriter | MirrorWriter] | None = None,
    ) -> None:
        self._writers = writers or {}
        self._source = Source(Channel.MODBUS_TCP)
        self._owed = 0  # answers of writes that are still to come
        self._respond = responder.respond
        self._answer_again = responder.answer_again
        self._now = clock.now
        self._places = places
        self._transport: asyncio.Transport
        self._data = b""  # received; answered up to _at
        self._at = 0
        self._is_waiting = False  # nothing is read: for the next turn, or until the client has read
        self._has_ended = False  # the client sends no more
        self._heard_at = self._now()  # when it last sent a whole request
        self._blocked_at: float | None = None  # since when it owes us reading

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Serve the client if there is a place for it."""
        self._transport = cast("asyncio.Transport", transport)
        if not self._places.take(self):
            self._transport.abort()
            return
        self._transport.set_write_buffer_limits(high=WRITE_BUFFER)
        peer = self._transport.get_extra_info("peername")
        self._source = Source(Channel.MODBUS_TCP, str(peer[0]) if peer else "")
        _keep_alive(self._transport.get_extra_info("socket"))

    def data_received(self, data: bytes) -> None:
        """Answer what is whole by now."""
        if not self._data and not self._is_waiting:
            now = self._now()
            answer = self._answer_again(data, now)
            if answer is not None:  # nearly always: a lone request that was asked before
                self._heard_at = now
                self._transport.write(answer)
                return
        self._data = self._data[self._at :] + data if self._data else data
        self._at = 0
        if not self._is_waiting:
            self._take_turn()

    def _take_turn(self) -> None:
        """Answer some requests in one write."""
        now = self._now()
        room = IN_FLIGHT - self._owed
        answers, used, then = self._respond(self._data, self._at, room, now, self._writer, self._put)
        if used > self._at:
            self._heard_at = now
            self._at = used
        if answers:
            self._transport.write(answers)
        if self._owed >= IN_FLIGHT:
            self._wait()
            return
        if then is READ_ON:
            if used == len(self._data):
                self._data, self._at = b"", 0
            if self._is_waiting:
                self._read_on()
        elif then is GO_ON:
            self._queue_up()
        else:
            self._close("what it sends is no MODBUS-TCP")

    def _writer(self, unit: int) -> Write | None:
        """Say who carries out the writes of a unit."""
        writer = self._writers.get(unit)
        if writer is None:
            return None

        def write(pdu: bytes, later: Later) -> None:
            self._owed += 1
            writer.write(pdu, self._source, later)

        return write

    def _put(self, answer: bytes) -> None:
        """Send the answer of a write that has been carried out, and go on reading where that had to wait."""
        was_full = self._owed >= IN_FLIGHT
        self._owed -= 1
        if self._transport.is_closing():
            return
        self._transport.write(answer)
        if was_full:
            asyncio.get_running_loop().call_soon(self._go_on)

    def _read_on(self) -> None:
        """Read again, or close behind a client that has sent its last; not before it has read its answers."""
        if self._blocked_at is not None:
            return
        self._is_waiting = False
        if self._has_ended:
            self._close("it has sent its last")
        else:
            self._transport.resume_reading()

    def _queue_up(self) -> None:
        """Let the others have their turn; what may wait is bounded by what one read of the socket brings."""
        self._wait()
        if self._blocked_at is None:
            asyncio.get_running_loop().call_soon(self._go_on)

    def _wait(self) -> None:
        if not self._is_waiting:
            self._is_waiting = True
            self._transport.pause_reading()

    def _go_on(self) -> None:
        if not self._transport.is_closing():
            self._take_turn()

    def pause_writing(self) -> None:
        """Answer no further: the client does not read."""
        self._blocked_at = self._now()
        self._wait()

    def resume_writing(self) -> None:
        """Go on: the client has read."""
        self._blocked_at = None
        self._go_on()

    def eof_received(self) -> bool:
        """Stay open while a client that sends no more is still owed answers."""
        self._has_ended = True
        return self._is_waiting or self._owed > 0

    def overdue(self, now: float, idle_timeout: float) -> str | None:
        """Say why the time of this connection is over; None while it is not."""
        if self._blocked_at is not None and now - self._blocked_at > DRAIN_WITHIN:
            return f"its answers were not read for {DRAIN_WITHIN:g} s"
        if now - self._heard_at > idle_timeout:
            return f"no request for {idle_timeout:g} s"
        return None

    def _close(self, reason: str) -> None:
        """Close behind the answers; a client that does not fetch them is cut in the end."""
        log.info("%s: closed: %s", self._peer, reason)
        self._data, self._at = b"", 0
        self._blocked_at = self._blocked_at or self._now()
        self._transport.close()

    def cut(self, reason: str) -> None:
        """Close at once, whatever is still to be sent."""
        log.info("%s: cut: %s", self._peer, reason)
        self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back."""
        self._data, self._at = b"", 0
        self._places.give_back(self)

    @property
    def _peer(self) -> str:
        return str(self._transport.get_extra_info("peername"))


def _keep_alive(connection: socket.socket | None) -> None:
    """Have the system find out that a client's machine is gone."""
    if connection is None:
        return
    with contextlib.suppress(OSError):  # the client may be gone already
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in KEEP_ALIVE:
            if hasattr(socket, option):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
