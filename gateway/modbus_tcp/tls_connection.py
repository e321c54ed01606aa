"""A client by TLS: its handshake, its role, and the connection that is served through it.

OpenSSL works on bytes in memory here, so that both event loops behave alike, a failure still tells the client why,
and nobody has a place before it is known who it is.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
from collections.abc import Callable
from typing import cast

from gateway.clock import Clock
from gateway.modbus_tcp.connection import Connection
from gateway.modbus_tcp.credentials import Keyring
from gateway.modbus_tcp.handshakes import DONE, LEFT, NO_ROLE, Handshakes, explain
from gateway.modbus_tcp.hosts import host_of
from gateway.modbus_tcp.places import Places
from gateway.modbus_tcp.reception import Reception
from gateway.modbus_tcp.role_certificate import BadCertificate, RoleCertificate
from gateway.modbus_tcp.role_certificate import read as read_certificate
from gateway.modbus_tcp.turns import Answering
from gateway.modbus_tcp.wrapped import WrappedTransport

log = logging.getLogger("gateway.modbus_tcp")

RECORD = 16 * 1024  # bytes of plain text in one TLS record


class SecuredConnection(Connection):
    """A connection that ends when its client's certificate does, or when the gateway's own one stops to hold."""

    def hold(self, wall: Callable[[], float], ends_at: float, is_trusted: Callable[[], bool]) -> None:
        """Take until when the client's certificate holds (UTC seconds), and how to know that the own one does."""
        self._wall, self._ends_at = wall, ends_at
        self._is_trusted, self._was_trusted = is_trusted, is_trusted()

    def overdue(self, now: float, idle_timeout: float) -> str | None:
        """Say why the time of this connection is over; None while it is not."""
        if self._wall() > self._ends_at:
            return "its certificate has expired"
        if self._was_trusted and not self._is_trusted():
            return "the gateway's certificate has expired"
        return super().overdue(now, idle_timeout)


class TlsClient(Answering):
    """One socket of the TLS listener."""

    def __init__(
        self, keyring: Keyring, reception: Reception, clock: Clock, places: Places, handshakes: Handshakes
    ) -> None:
        self.host = ""
        self._keyring = keyring
        self._reception = reception
        self._clock = clock
        self._places = places
        self._handshakes = handshakes
        self._transport: asyncio.Transport
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        context = keyring.credentials.context
        self._tls = context.wrap_bio(self._incoming, self._outgoing, server_side=True)
        self._connection: Connection | None = None
        self._wire: _Wire
        self._is_going = False  # its handshake has been begun
        self._is_paused = False  # nothing is read until that is so
        self._has_ended = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin a handshake, unless there is no place for the client anyway."""
        self._transport = cast("asyncio.Transport", transport)
        self.host = host_of(self._transport.get_extra_info("peername"))
        if self._places.turns_away(self.host):
            self._transport.abort()
        else:
            self._handshakes.begin(self, self._clock.now())

    def data_received(self, data: bytes) -> None:
        """Go on with the handshake, or hand on what it says."""
        if self._has_ended:
            return
        self._incoming.write(data)
        if self._connection is not None:
            self._hand_on(self._connection)
        elif self._is_going or self._handshakes.may_go_on(self, self._clock.now()):
            self.go_on()
        else:
            self._is_paused = True
            self._transport.pause_reading()

    def go_on(self) -> None:
        """Do the handshake as far as the client has come; what came behind it is a request."""
        self._is_going = True
        if self._is_paused:
            self._is_paused = False
            self._transport.resume_reading()
        self._shake_hands()
        if self._connection is not None:
            self._hand_on(self._connection)

    def _shake_hands(self) -> None:
        try:
            self._tls.do_handshake()
        except ssl.SSLWantReadError:
            self._flush()
            return
        except ssl.SSLError as error:
            kind, reason = explain(error)
            self._handshakes.end(self, kind, f"no TLS: {reason}", self._clock.now())
            self._has_ended = True
            self._flush()  # the alert, which tells the client why
            self._transport.close()
            return
        self._flush()
        self._serve()

    def _serve(self) -> None:
        """Serve the client as its role may be served."""
        found = self._certificate()
        if found is not None and not found.is_valid(self._clock.wall()):  # a resumed session is not verified again
            found = None
        role = None if found is None else found.role
        if role is None:
            reason = "its certificate does not hold" if found is None else found.objection
            self._handshakes.end(self, NO_ROLE, f"by TLS without any right: {reason}", self._clock.now())
        else:
            self._handshakes.end(self, DONE, f"by TLS as {role!r}", self._clock.now())
        served = self._reception.secured(role, self.host, is_trusted=self._keyring.is_own_valid)
        connection = SecuredConnection(served.responder, self._clock, self._places, served.writers, served.source)
        ends_at = float("inf") if found is None else found.not_after
        connection.hold(self._clock.wall, ends_at, lambda: self._keyring.is_own_valid)
        self._connection = connection
        self._wire = _Wire(self._transport, self._tls, self._outgoing)
        connection.connection_made(self._wire)

    def _certificate(self) -> RoleCertificate | None:
        der = self._tls.getpeercert(binary_form=True)
        try:
            return None if der is None else read_certificate(der)
        except BadCertificate as error:
            log.warning("%s: its certificate cannot be read: %s", self.host, error)
            return None

    def _hand_on(self, connection: Connection) -> None:
        """Hand on all that can be decrypted by now."""
        pieces: list[bytes] = []
        try:
            while not self._has_ended and (self._incoming.pending or self._tls.pending()):
                piece = self._tls.read(RECORD)
                self._has_ended = not piece  # the client has said goodbye
                pieces.append(piece)
        except ssl.SSLWantReadError:
            pass  # the rest of a record is still to come
        except ssl.SSLError as error:
            self._has_ended = True
            self._flush()
            connection.cut(f"what it sends is no TLS: {error.reason or error}")
            return
        self._flush()  # a key update, say
        data = b"".join(pieces)
        if data and not self._wire.is_closing():
            connection.data_received(data)
        if self._has_ended and not connection.eof_received() and not self._wire.is_closing():
            self._wire.close()

    def _flush(self) -> None:
        data = self._outgoing.read()
        if data and not self._transport.is_closing():
            self._transport.write(data)

    def give_up(self, kind: str, reason: str) -> None:
        """End a handshake that leads nowhere."""
        self._has_ended = True
        self._handshakes.end(self, kind, f"no TLS: {reason}", self._clock.now())
        self._transport.abort()

    def pause_writing(self) -> None:
        """Pass it on; in a handshake little is sent."""
        if self._connection is not None:
            self._connection.pause_writing()

    def resume_writing(self) -> None:
        """Pass it on."""
        if self._connection is not None:
            self._connection.resume_writing()

    def eof_received(self) -> bool:
        """Stay open while a client that sends no more is still owed answers."""
        return self._connection is not None and self._connection.eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """Let go of everything."""
        self._has_ended = True
        self._handshakes.end(self, LEFT, "no TLS: it left before the handshake was done", self._clock.now())
        if self._connection is not None:
            self._connection.connection_lost(exc)


class _Wire(WrappedTransport):
    """Encrypts what a connection sends."""

    def __init__(self, inner: asyncio.Transport, tls: ssl.SSLObject, outgoing: ssl.MemoryBIO) -> None:
        super().__init__(inner)
        self._tls = tls
        self._outgoing = outgoing

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send answers."""
        self._tls.write(data)
        self._inner.write(self._outgoing.read())

    def close(self) -> None:
        """Say goodbye, and close behind what is sent."""
        with contextlib.suppress(ssl.SSLError):  # it wants to read the client's goodbye, which nobody waits for
            self._tls.unwrap()
        if not self._inner.is_closing():
            self._inner.write(self._outgoing.read())
        self._inner.close()
