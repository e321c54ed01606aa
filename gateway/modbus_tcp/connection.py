"""One MODBUS-TCP client and the limits it lives under: turns, buffers and time-outs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable, Mapping
from typing import cast

from gateway.clock import Clock
from gateway.control.command import Channel, Source
from gateway.modbus_tcp.hosts import host_of, peer_name
from gateway.modbus_tcp.places import Places
from gateway.modbus_tcp.reception import Served
from gateway.modbus_tcp.responder import GO_ON, READ_ON, TRANSACTION, Responder
from gateway.modbus_tcp.session import Session, Timer, Writer
from gateway.modbus_tcp.turns import Answering

log = logging.getLogger("gateway.modbus_tcp")

IN_FLIGHT = 16  # requests of one client that may wait for their answers; so many are answered in one turn
WRITE_BUFFER = 64 * 1024  # bytes; beyond them the client's requests wait until it has read
DRAIN_WITHIN = 4.0  # seconds; a client that does not read is cut by the sweep after it, 5 s at the latest
KEEP_ALIVE = (("TCP_KEEPIDLE", 15), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3))  # a dead peer is gone after 30 s


class Connection(Answering):
    """One client. Its requests are answered in turns, so that it cannot keep the loop from the lines."""

    def __init__(
        self,
        responder: Responder,
        clock: Clock,
        places: Places,
        writers: Mapping[int, Writer] | None = None,
        source: Source | None = None,
        serve: Callable[[str], Served] | None = None,
    ) -> None:
        self._responder = responder
        self._writers = writers or {}
        self._known = responder.known
        self._serve = serve  # says by whom a client is served where that depends on its address
        self._now = clock.now
        self._places = places
        self._transport: asyncio.Transport
        self._write: Callable[[bytes], None]
        self._source = source  # who commands; by its address where it is not known yet
        self._session = self._session_of(source or Source(Channel.MODBUS_TCP))
        self._owed = self._session.owed
        self._data = b""  # received; answered up to _at
        self._at = 0
        self._is_waiting = False  # nothing is read: for the next turn, for an answer, or until the client has read
        self._is_next = False  # the next turn is coming
        self._is_sending = False  # answers of writes are about to be sent
        self._has_ended = False  # the client sends no more
        self._heard_at = self._now()  # when it last sent a whole request, or was answered
        self._blocked_at: float | None = None  # since when it owes us reading

    def _session_of(self, source: Source) -> Session:
        return Session(self._responder, self._writers, source, self._on_answer, call_later)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Serve the client if there is a place for it."""
        self._transport = cast("asyncio.Transport", transport)
        self._write = self._transport.write
        peer = self._transport.get_extra_info("peername")
        if not self._places.take(self, host_of(peer)):
            self._transport.abort()
            return
        if self._serve is not None:
            self._attend(self._serve(host_of(peer)))
        self._transport.set_write_buffer_limits(high=WRITE_BUFFER)
        self._session = self._session_of(self._source or source_of(peer))
        self._owed = self._session.owed
        _keep_alive(self._transport.get_extra_info("socket"))

    def _attend(self, served: Served) -> None:
        self._responder, self._writers, self._source = served.responder, served.writers, served.source
        self._known = served.responder.known

    def answer_now(self, data: bytes, now: float) -> bytes | None:
        """Answer what is whole by now; return the answer where nothing waits in front of it."""
        if not self._data and not self._is_waiting and not self._owed:
            again = self._known.get(data[TRANSACTION:])
            if again is not None:  # nearly always: a lone request that was asked before
                answer = again(now)
                if answer is not None:
                    self._heard_at = now
                    return data[:TRANSACTION] + answer
        self._take(data)
        return None

    def data_received(self, data: bytes) -> None:
        """Answer what is whole by now."""
        answer = self.answer_now(data, self._now())
        if answer is not None:
            self._write(answer)

    def _take(self, data: bytes) -> None:
        """Answer what is whole by now, one request after the other."""
        self._data = self._data[self._at :] + data if self._data else data
        self._at = 0
        if not self._is_waiting:
            self._take_turn()

    def _take_turn(self) -> None:
        """Answer some requests in one write."""
        now = self._now()
        room = IN_FLIGHT - len(self._owed)
        answers, used, then = self._responder.respond(self._data, self._at, room, now, self._session)
        if used > self._at:
            self._heard_at = now
            self._at = used
        if answers:
            self._transport.write(answers)
        if then is READ_ON:
            if used == len(self._data):
                self._data, self._at = b"", 0
            if self._is_waiting:
                self._read_on()
        elif then is GO_ON:
            self._queue_up()
        else:
            self._close("what it sends is no MODBUS-TCP")

    def _on_answer(self) -> None:
        """Have answers sent as soon as who told them is through: a read behind a write sees all that it did."""
        if not self._is_sending:
            self._is_sending = True
            asyncio.get_running_loop().call_soon(self._send_answers)

    def _send_answers(self) -> None:
        """Send the answers of writes, and what waited behind them; go on where there was no room for more."""
        self._is_sending = False
        if self._transport.is_closing():
            return
        now = self._now()
        answers = self._session.release(now)
        if answers:
            self._heard_at = now
            self._transport.write(answers)
        if self._is_waiting:
            self._queue_up()
        elif self._has_ended and not self._owed:
            self._close("it has sent its last")

    def _read_on(self) -> None:
        """Read again, or close behind a client that has sent its last; not before it has read its answers."""
        if self._blocked_at is not None:
            return
        self._is_waiting = False
        if not self._has_ended:
            self._transport.resume_reading()
        elif not self._owed:
            self._close("it has sent its last")

    def _queue_up(self) -> None:
        """Let the others have their turn; what may wait is bounded by what one read of the socket brings."""
        self._wait()
        if self._blocked_at is None and not self._is_next and len(self._owed) < IN_FLIGHT:
            self._is_next = True
            asyncio.get_running_loop().call_soon(self._go_on)

    def _wait(self) -> None:
        if not self._is_waiting:
            self._is_waiting = True
            self._transport.pause_reading()

    def _go_on(self) -> None:
        self._is_next = False
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
        return self._is_waiting or bool(self._owed)

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
        self._session.close()
        self._blocked_at = self._blocked_at or self._now()
        self._transport.close()

    def cut(self, reason: str) -> None:
        """Close at once, whatever is still to be sent."""
        log.info("%s: cut: %s", self._peer, reason)
        self._transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back; what is under way goes on, and its result goes nowhere."""
        self._data, self._at = b"", 0
        self._session.close()
        self._places.give_back(self)

    @property
    def _peer(self) -> str:
        return peer_name(self._transport.get_extra_info("peername"))


def call_later(seconds: float, call: Callable[[], None]) -> Timer:
    """Put a call off, by the running loop."""
    return asyncio.get_running_loop().call_later(seconds, call)


def source_of(peer: tuple[str, ...] | None) -> Source:
    """Name a controller by its address: all connections of one machine are one source, whatever they came by."""
    return Source(Channel.MODBUS_TCP, host_of(peer))


def _keep_alive(connection: socket.socket | None) -> None:
    """Have the system find out that a client's machine is gone."""
    if connection is None:
        return
    with contextlib.suppress(OSError):  # the client may be gone already
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in KEEP_ALIVE:
            if hasattr(socket, option):
                connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
