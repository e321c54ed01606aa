"""WebSocket as a client speaks it (RFC 6455): the opening handshake, frames to bytes and back. Pure.

MQTT is a stream of bytes in binary frames, cut anywhere (MQTT 5 6.0): payloads are handed on as they come, so that
no frame, however long it says it is, is ever collected.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from enum import IntEnum

GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455 1.3
LARGEST_HEAD = 16 * 1024  # bytes of the answer to the handshake
LARGEST_CONTROL = 125  # bytes of a ping, pong or close (5.5)
SHORT, MIDDLE = 125, 0xFFFF  # longest payloads whose length takes 1 byte, and 3


class BadWebSocket(ConnectionError):
    """What came is no WebSocket for MQTT: the connection is of no use."""


class Opcode(IntEnum):
    """Kinds of frames (5.2)."""

    CONTINUATION = 0x0
    TEXT = 0x1
    BINARY = 0x2
    CLOSE = 0x8
    PING = 0x9
    PONG = 0xA


# ---- the opening handshake


def request(host: str, path: str, key: bytes) -> bytes:
    """Return what asks for a WebSocket (4.1); `host` is with its port where that is not the usual one."""
    lines = (
        f"GET {path} HTTP/1.1",
        f"Host: {host}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {base64.b64encode(key).decode()}",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Protocol: mqtt",
    )
    return "".join(f"{line}\r\n" for line in (*lines, "")).encode()


def parted(received: bytes) -> tuple[bytes, bytes] | None:
    """Return the head of the answer and what came behind it; None: not whole yet; BadWebSocket where it is none."""
    if not received.startswith(b"HTTP/"[: len(received)]):
        raise BadWebSocket("what answers there speaks no HTTP")
    head, end, rest = received.partition(b"\r\n\r\n")
    if end:
        return head, rest
    if len(received) > LARGEST_HEAD:
        raise BadWebSocket("the answer to the WebSocket's request does not end")
    return None


def check(head: bytes, key: bytes) -> None:
    """See that the answer opens a WebSocket for MQTT (4.1, MQTT 5 6.0); BadWebSocket says why it does not."""
    status, *lines = head.decode("latin-1").split("\r\n")
    code = status.split(" ")[1:2]
    if code != ["101"]:
        raise BadWebSocket(f"no WebSocket there: HTTP {' '.join(status.split(' ')[1:])[:80]}")
    fields: dict[str, str] = {}
    for line in lines:
        name, _, value = line.partition(":")
        fields[name.strip().lower()] = value.strip()
    wanted = base64.b64encode(hashlib.sha1(base64.b64encode(key) + GUID.encode()).digest()).decode()  # noqa: S324
    if fields.get("upgrade", "").lower() != "websocket" or fields.get("sec-websocket-accept") != wanted:
        raise BadWebSocket("no WebSocket there: the answer does not fit the request")
    if fields.get("sec-websocket-protocol", "mqtt").lower() != "mqtt" or fields.get("sec-websocket-extensions"):
        raise BadWebSocket("no WebSocket for MQTT there: another protocol or an extension")


# ---- frames


def frame(opcode: Opcode, payload: bytes, mask: bytes) -> bytes:
    """Return a whole frame; `mask` is four bytes that nobody can foresee (5.3)."""
    size = len(payload)
    if size <= SHORT:
        length = bytes((0x80 | size,))
    elif size <= MIDDLE:
        length = bytes((0x80 | 126,)) + size.to_bytes(2, "big")
    else:
        length = bytes((0x80 | 127,)) + size.to_bytes(8, "big")
    return bytes((0x80 | opcode,)) + length + mask + masked(payload, mask)


def masked(payload: bytes, mask: bytes) -> bytes:
    """Mask, or unmask (5.3)."""
    size = len(payload)
    pattern = (mask * (size // 4 + 1))[:size]
    return (int.from_bytes(payload, "little") ^ int.from_bytes(pattern, "little")).to_bytes(size, "little")


@dataclass(frozen=True, slots=True)
class Control:
    """A ping, a pong or a close, whole."""

    opcode: Opcode
    payload: bytes


class Frames:
    """What the other end sends: feed it, and take the bytes of MQTT and the control frames that came."""

    def __init__(self) -> None:
        self._buffer = bytearray()  # of a head, or a control frame, that is not whole: 139 bytes at the most
        self._left = 0  # bytes of the payload of a data frame that are to come
        self._is_in_message = False

    def feed(self, received: bytes) -> tuple[bytes, list[Control]]:
        """Return bytes of MQTT and control frames; BadWebSocket where a server must not send that."""
        rest, found, controls = bytes(self._buffer) + received, [], []
        while rest:
            if self._left:
                found.append(rest[: self._left])
                rest, self._left = rest[self._left :], max(0, self._left - len(rest))
                continue
            head = _head(rest)
            if head is None:
                break
            opcode, is_final, start, size = head
            if opcode >= Opcode.CLOSE:
                if len(rest) < start + size:
                    break
                controls.append(Control(opcode, rest[start : start + size]))
                rest = rest[start + size :]
            else:
                self._begin(opcode, is_final)
                rest, self._left = rest[start:], size
        self._buffer[:] = rest
        return b"".join(found), controls

    def _begin(self, opcode: Opcode, is_final: bool) -> None:
        """See that messages follow each other, and are of bytes."""
        if opcode is Opcode.TEXT or (opcode is Opcode.CONTINUATION) is not self._is_in_message:
            raise BadWebSocket(f"a WebSocket frame that does not belong there: {opcode.name}")
        self._is_in_message = not is_final


def _head(received: bytes) -> tuple[Opcode, bool, int, int] | None:
    """Return opcode, whether it is the last of its message, where the payload starts, and its size; None: not yet."""
    if len(received) < 2:
        return None
    first, second = received[0], received[1]
    if first & 0x70 or second & 0x80 or first & 0x0F not in set(Opcode):
        raise BadWebSocket(f"no WebSocket frame of a server: {received[:2].hex(' ')}")
    opcode, is_final, size, start = Opcode(first & 0x0F), bool(first & 0x80), second & 0x7F, 2
    if opcode >= Opcode.CLOSE and (size > LARGEST_CONTROL or not is_final):
        raise BadWebSocket(f"a WebSocket {opcode.name} that is in parts or too long")
    if size > SHORT:
        start = 4 if size == SHORT + 1 else 10
        if len(received) < start:
            return None
        size = int.from_bytes(received[2:start], "big")
    return opcode, is_final, start, size
