"""What a drive answers over MODBUS-RTU (E6581657 5)."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.errors import Refusal
from gateway.protocol.modbus_rtu import ModbusRtu
from gateway.protocol.pdu import (
    Exchange,
    Identify,
    Proportional,
    ReadBlock,
    ReadWords,
    Request,
    WriteBlock,
    WriteRam,
    WriteStored,
)
from tests.protocol.drive_side import (
    Content,
    Denied,
    Dialect,
    Heard,
    Pick,
    crc,
    is_unanswered,
    pair,
    pairs,
    unpaired,
    wanted,
)

MODBUS_REASONS = {1: Refusal.COMMAND, 2: Refusal.ADDRESS, 3: Refusal.RANGE, 4: Refusal.UNABLE}


class Rtu(Dialect):
    """MODBUS-RTU (E6581657 5)."""

    def __init__(self, writes_by_10h: bool = False) -> None:
        self.codec = ModbusRtu(writes_by_10h)
        self.writes_by_10h = writes_by_10h

    def request(self, pick: Pick) -> Request:
        number, address = pick(1, 247), pick(0, 0xFFF8)
        two = (pick(0, 0xFFFF), pick(0, 0xFFFF))
        requests: list[Request] = [
            ReadWords(number, address, pick(1, 8)),
            ReadBlock(number, pick(0x1875, 0x1876), pick(2, 5)),
            WriteRam(number, address, two[0], bool(pick(0, 3))),
            WriteStored(number, address, two[0]),
            WriteBlock(number, 0x1870, two),
            Exchange(number, 0x1875, pick(2, 5), 0x1870, two),
            Identify(number, pick(0, 3)),
        ]
        return requests[pick(0, len(requests) - 1)]

    def function(self, request: Request) -> int:
        """Return the function code."""
        match request:
            case ReadWords() | ReadBlock():
                return 0x03
            case Exchange():
                return 0x17
            case Identify():
                return 0x2B
            case WriteBlock():
                return 0x10
        return 0x10 if self.writes_by_10h else 0x06

    def frame(self, request: Request, content: Content) -> bytes:
        if not isinstance(request.number, int) or is_unanswered(request):
            return b""
        match request:
            case ReadWords() | ReadBlock() | Exchange():
                data = bytes((2 * len(content.words),)) + pairs(content.words)
            case WriteRam() | WriteStored():
                data = pair(request.address) + pair(1 if self.writes_by_10h else request.word)
            case WriteBlock():
                data = pair(request.address) + pair(len(request.words))
            case Identify():
                objects = b"".join(bytes((i, len(text))) + text for i, text in enumerate(content.texts))
                data = bytes((0x0E, request.code, 1, 0, 0, len(content.texts))) + objects
            case Proportional():
                return b""
        body = bytes((request.number, self.function(request))) + data
        return body + crc(body)

    def refusal(self, request: Request, code: int, is_tripped: bool) -> bytes:
        if not isinstance(request.number, int):
            return b""
        body = bytes((request.number, self.function(request) | 0x80, code))
        return body + crc(body)

    def sealed(self, frame: bytes) -> bytes:
        return frame[:-2] + crc(frame[:-2])

    def content(self, request: Request, pick: Pick) -> Content:
        words = tuple(pick(0, 0xFFFF) for _ in range(wanted(request)))
        device = bytes(pick(0x20, 0x7E) for _ in range(pick(0, 20)))
        return Content(words, texts=(b"TOSHIBA", device, b"0100"))

    def sizes(self, request: Request) -> set[int]:
        return {5, *range(16, 65)} if isinstance(request, Identify) else super().sizes(request)

    def said(self, request: Request, frame: bytes) -> Heard | None:
        is_function = frame[1] & 0x7F == self.function(request)  # a short cut: all else would find it too
        return super().said(request, frame) if is_function else None

    def contents(self, request: Request, frame: bytes) -> Iterator[Content]:
        words = unpaired(frame[3:-2]) if wanted(request) else ()
        texts = tuple(_texts(frame[8:-2])) if isinstance(request, Identify) else ()
        if len(words) == wanted(request) and all(text.isascii() for text in texts):
            yield Content(words, texts=texts)

    def codes(self, request: Request, frame: bytes) -> Iterator[tuple[int, bool]]:
        yield frame[2], False

    def denied(self, code: int, is_tripped: bool) -> Denied:
        return Denied(MODBUS_REASONS.get(code, Refusal.OTHER), None)

    def failed(self, words: tuple[int, ...], content: Content) -> tuple[int, ...]:
        return ()


def _texts(objects: bytes) -> Iterator[bytes]:
    """Return the values of an identification's objects (5.1.7)."""
    while len(objects) > 1:
        yield objects[2 : 2 + objects[1]]
        objects = objects[2 + objects[1] :]
