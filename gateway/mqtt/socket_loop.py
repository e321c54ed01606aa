"""The socket of one connection on the event loop: when it is read, how much at a stretch, and how it is written."""

from __future__ import annotations

import asyncio
from typing import Any, Protocol

from gateway.mqtt import packets
from gateway.mqtt.reception import Reception
from gateway.mqtt.stream import Stream, TooLarge

READ_AT_ONCE = 8  # packets that are read at a stretch: well below a millisecond, so that no line waits for a flood
RECEIVED_AT_ONCE = 4096  # bytes: a thousand acknowledgements, which take a millisecond
TOGETHER = 0.001  # seconds in which readings are collected behind those that went at once
LARGEST_PACKET = 64 * 1024  # bytes that the broker may send in one packet
TOO_LARGE = "the broker sent a packet of %d bytes; no command needs more than %d"


class Owner(Protocol):
    """Whose socket it is."""

    @property
    def lost(self) -> str | None:
        """Return why the connection is lost; None while it is not."""
        ...

    @property
    def has_unwritten(self) -> bool:
        """Say whether anything was sent since the last flush."""
        ...

    def acknowledge(self, packet_id: int, code: int) -> bool:
        """Take a PUBACK; False where it is for paho."""
        ...

    def flush(self) -> None:
        """Write what was sent."""
        ...

    def lose(self, reason: str) -> None:
        """Take that the connection has ended."""
        ...

    def fail(self, error: Exception) -> None:
        """Take an error that nobody expects."""
        ...


class SocketLoop:
    """The socket of a paho client, from `attach` to `detach`."""

    def __init__(self, client: Any, reception: Reception, owner: Owner, *, is_5: bool) -> None:
        self._client = client
        self._is_5 = is_5
        self._reception = reception
        self._owner = owner
        self._loop = asyncio.get_running_loop()
        self._fd = -1
        self._stream = Stream(LARGEST_PACKET)
        self._may_have_more = False  # whole packets that were received and not read
        self._is_reading_soon = False
        self._is_writing = False
        self._is_flushing_soon = self._is_flushing_later = False
        self._flushed_at = float("-inf")  # by the time of the loop

    def attach(self) -> bool:
        """Have the loop watch the socket; False where paho has none any more."""
        sock = self._client.socket()
        if sock is None:
            return False
        self._fd = sock.fileno()
        self._loop.add_reader(self._fd, self._readable)
        return True

    def detach(self) -> None:
        """Watch it no more."""
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            if self._is_writing:
                self._loop.remove_writer(self._fd)
        self._fd, self._is_writing = -1, False

    # ---- reading

    def _readable(self) -> None:
        if not self._is_reading_soon:
            self._read()

    def _read_on(self) -> None:
        self._is_reading_soon = False
        self._read()

    def _read(self) -> None:
        """Read some packets; what is left makes the socket readable again, but for what was received already."""
        if self._fd < 0:
            return  # it was lost since this was asked for
        try:
            self._hand_on()
            if self._fd >= 0 and (self._may_have_more or self._has_pending()):
                self._is_reading_soon = True
                self._loop.call_soon(self._read_on)
            self._reception.hand_over()
            self._owner.flush()
        except Exception as error:
            self._owner.fail(error)

    def _hand_on(self) -> None:
        """Let paho read some packets, and the owner the acknowledgements between them."""
        if not self._may_have_more:
            self._stream.feed(self._client.receive(RECEIVED_AT_ONCE))
        self._may_have_more = False
        for _ in range(READ_AT_ONCE):
            packet = self._next_for_paho()
            if packet is None:
                return
            self._client.take(packet)
            if self._owner.lost is not None:
                return
        self._may_have_more = True

    def _next_for_paho(self) -> bytes | None:
        """Return the next packet that is no acknowledgement for the owner, None where none has come."""
        try:
            while (packet := self._stream.next()) is not None:
                found = packets.puback(packet, is_5=self._is_5)
                if found is None or not self._owner.acknowledge(*found):
                    return packet
        except TooLarge as error:
            self.detach()
            self._owner.lose(TOO_LARGE % (error.size, LARGEST_PACKET))
        return None

    def _has_pending(self) -> bool:
        """Say whether TLS or a WebSocket holds bytes that it has read already, of which the socket tells nothing."""
        pending = getattr(self._client.socket(), "pending", None)
        return pending is not None and pending() > 0

    # ---- writing

    def write_in_turn(self) -> None:
        """Have the owner flush: now, or where it just has, a little later with what comes by then.

        One reading goes at once; where they come in thousands a second, each would cost a call of the system.
        """
        if self._is_flushing_later:
            return
        wait = self._flushed_at + TOGETHER - self._loop.time()
        if wait <= 0:
            self._flushed_at = self._loop.time()
            self._writable()
        else:
            self._is_flushing_later = True
            self._loop.call_later(wait, self._flush_later)

    def _flush_later(self) -> None:
        self._is_flushing_later = False
        self._flush()

    def write_soon(self) -> None:
        """Have the owner flush when whoever sends has come to an end."""
        if not self._is_flushing_soon:
            self._is_flushing_soon = True
            self._loop.call_soon(self._flush_soon)

    def _flush_soon(self) -> None:
        self._is_flushing_soon = False
        self._flush()

    def _flush(self) -> None:
        if self._owner.has_unwritten:
            self._flushed_at = self._loop.time()
            self._writable()

    def _writable(self) -> None:
        if self._fd < 0:
            return
        try:
            self._owner.flush()
        except Exception as error:
            self._owner.fail(error)

    def write(self) -> bool:
        """Write what paho holds; say whether all of it is written. The rest is as soon as the socket takes it."""
        queued = self._client._out_packet
        if queued:
            packets.join(queued)
            self._client.loop_write()
        wants_write = bool(queued) or not self._pushed()
        if self._fd >= 0 and wants_write is not self._is_writing:
            self._is_writing = wants_write
            if wants_write:
                self._loop.add_writer(self._fd, self._writable)
            else:
                self._loop.remove_writer(self._fd)
        return not wants_write

    def _pushed(self) -> bool:
        """Write what a WebSocket has taken of paho and not written yet; say whether that is all."""
        push = getattr(self._client.socket(), "push", None)
        try:
            return push is None or bool(push())
        except OSError:
            return True  # reading says why the connection is lost
