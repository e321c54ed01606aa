"""A client that speaks MODBUS-RTU over TCP: its frames go to a connection in MODBUS-TCP's form, answers come back."""

from __future__ import annotations

import asyncio
from typing import cast

from gateway.modbus_tcp.connection import Connection
from gateway.modbus_tcp.rtu_framing import RtuFraming, framed
from gateway.modbus_tcp.wrapped import WrappedTransport

FRAME_WITHIN = 1.0  # seconds; masters have given an answer up by then, and what they send next is another frame


class RtuConnection(Connection):
    """Turns, buffers, places, time-outs and rights are those of every connection; only the frames differ."""

    _framing: RtuFraming
    _begun_at: float | None = None  # since when a frame is not whole

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Serve the client if there is a place for it."""
        self._framing = RtuFraming()
        wire = cast("asyncio.Transport", transport)
        super().connection_made(_Wire(wire))
        self._write = wire.write  # what is answered now is framed already

    def answer_now(self, data: bytes, now: float) -> bytes | None:
        """Answer what is whole by now; close behind that where the stream is out of step."""
        if self._framing.out_of_step:
            return None
        requests = self._framing.receive(data)
        if requests or not self._framing.is_amid:
            self._begun_at = None
        if self._framing.is_amid and self._begun_at is None:
            self._begun_at = now
        answer = super().answer_now(requests, now) if requests else None
        if self._framing.out_of_step and not self._transport.is_closing():
            if answer is not None:
                self._transport.write(answer)
            self._close(f"what it sends is no MODBUS-RTU: {self._framing.out_of_step}")
            return None
        return None if answer is None else framed(answer)

    def overdue(self, now: float, idle_timeout: float) -> str | None:
        """Say why the time of this connection is over; None while it is not."""
        if self._begun_at is not None and now - self._begun_at > FRAME_WITHIN:
            return f"a frame that has not ended within {FRAME_WITHIN:g} s"
        return super().overdue(now, idle_timeout)


class _Wire(WrappedTransport):
    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send answers."""
        self._inner.write(framed(bytes(data)))
