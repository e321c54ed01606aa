"""A broker that is played, byte by byte: for what no real one does, or only when it is broken."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
from typing import Any

CONNECT, CONNACK, PUBLISH, PUBACK, SUBSCRIBE, SUBACK = 1, 0x20, 0x30, 0x40, 8, 0x90
GRANTED = 1  # QoS


def packet(head: int, body: bytes) -> bytes:
    """Put the fixed header before a packet (MQTT 5 2.1.4)."""
    size, length = len(body), b""
    while True:
        size, digit = divmod(size, 128)
        length += bytes([digit | (0x80 if size else 0)])
        if not size:
            return bytes([head]) + length + body


class PlayedBroker:
    """Takes clients of MQTT 5 or 3.1.1, answers their subscription with `code`, and sends what a test wants.

    `is_silent`: it confirms no subscription until `confirm`. Of messages it acknowledges all but results.
    """

    def __init__(
        self,
        *,
        is_5: bool = True,
        code: int = GRANTED,
        is_silent: bool = False,
        context: ssl.SSLContext | None = None,
    ) -> None:
        self.port = 0
        self.subscribed = asyncio.Event()
        self.subscriptions: list[bytes] = []
        self.topics: list[bytes] = []  # of all that was published
        self._is_5 = is_5
        self._code = code
        self._is_silent = is_silent
        self._context = context
        self._writer: asyncio.StreamWriter | None = None

    async def __aenter__(self) -> PlayedBroker:
        self._server = await asyncio.start_server(self._meet, "127.0.0.1", 0, ssl=self._context)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        if self._writer is not None:
            self._writer.transport.abort()

    def send(self, raw: bytes) -> None:
        """Send bytes to the client."""
        assert self._writer is not None
        self._writer.write(raw)

    def publish(self, topic: bytes, payload: bytes, **more: Any) -> None:
        """Send a message."""
        self.send(self.message(topic, payload, **more))

    def message(
        self, topic: bytes, payload: bytes, *, retain: bool = False, dup: bool = False, properties: bytes = b""
    ) -> bytes:
        """Return a message of QoS 1."""
        named = len(topic).to_bytes(2, "big") + topic
        rest = b"\x00\x07" + (bytes([len(properties)]) + properties if self._is_5 else b"")
        return packet(PUBLISH | 8 * dup | 2 | retain, named + rest + payload)

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writer = writer
        with contextlib.suppress(asyncio.IncompleteReadError, OSError):
            while True:
                head, body = await _read(reader)
                if head >> 4 == CONNECT:
                    self.send(packet(CONNACK, b"\x00\x00\x00" if self._is_5 else b"\x00\x00"))
                elif head >> 4 == SUBSCRIBE:
                    self.subscriptions.append(body)
                    if not self._is_silent:
                        self.confirm()
                    self.subscribed.set()
                elif head & 0xF0 == PUBLISH:
                    self._take(head >> 1 & 3, body)

    def _take(self, qos: int, body: bytes) -> None:
        end = 2 + int.from_bytes(body[:2], "big")
        self.topics.append(body[2:end])
        if qos and not self.topics[-1].endswith(b"/result"):
            self.send(packet(PUBACK, body[end : end + 2]))

    def break_off(self) -> None:
        """Break the connection."""
        assert self._writer is not None
        self._writer.transport.abort()

    def confirm(self) -> None:
        """Answer the last subscription."""
        body = self.subscriptions[-1]
        filters = body.count(b"tosvert/")
        codes = bytes([self._code] * filters)
        self.send(packet(SUBACK, body[:2] + (b"\x00" if self._is_5 else b"") + codes))


async def _read(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    """Read one packet."""
    head = (await reader.readexactly(1))[0]
    size = shift = 0
    while True:
        digit = (await reader.readexactly(1))[0]
        size |= (digit & 0x7F) << shift
        shift += 7
        if not digit & 0x80:
            return head, await reader.readexactly(size)
