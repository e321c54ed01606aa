"""What a MODBUS-TCP request is answered: pure, from the image as it is now."""

from __future__ import annotations

import struct
from collections.abc import Callable

from gateway.image import Image, Missing
from gateway.metrics import Stats
from gateway.modbus_tcp.mapping import GATEWAY_UNIT, gateway_words

READ_HOLDING, READ_INPUT = 0x03, 0x04
IDENTIFICATION = 0x2B
MOST_WORDS = 125  # a read (MODBUS Application Protocol V1.1b3, 6.3)
READ_SIZE = 5  # function, address, count

ILLEGAL_FUNCTION = 0x01
ILLEGAL_ADDRESS = 0x02
ILLEGAL_VALUE = 0x03
PATH_UNAVAILABLE = 0x0A  # unknown unit, or the line is down
TARGET_FAILED = 0x0B  # stale, never read, or the drive is silent

_READ = struct.Struct(">BHH")
_EXCEPTION = {
    Missing.UNMAPPED: ILLEGAL_ADDRESS,
    Missing.NOT_FRESH: TARGET_FAILED,
    Missing.LINE_DOWN: PATH_UNAVAILABLE,
}

Identify = Callable[[bytes, int], bytes | int]  # PDU and unit to the answer's PDU, or an exception code


class Answerer:
    """Answers PDUs from the image. `identify` serves function 43/14, which no fast path needs."""

    def __init__(self, image: Image, stats: Stats, now: Callable[[], float], wall: Callable[[], float],
                 identify: Identify) -> None:  # fmt: skip
        self._by_unit = dict(image.by_unit)
        self._image = image
        self._stats = stats
        self._now = now
        self._wall = wall
        self._identify = identify
        self._requests = stats.tcp.requests
        self._exceptions = stats.tcp.exceptions

    def answer(self, unit: int, pdu: bytes) -> bytes:
        """Return the PDU that answers a PDU of at least one byte."""
        function = pdu[0]
        self._requests[function] += 1
        if function in (READ_HOLDING, READ_INPUT):
            result = self._read(unit, pdu)
        elif unit != GATEWAY_UNIT and unit not in self._by_unit:
            result = PATH_UNAVAILABLE
        elif function == IDENTIFICATION:
            result = self._identify(pdu, unit)
        else:
            result = ILLEGAL_FUNCTION
        if isinstance(result, int):
            self._exceptions[result] += 1
            return bytes((function | 0x80, result))
        return result

    def _read(self, unit: int, pdu: bytes) -> bytes | int:
        drive = self._by_unit.get(unit)
        if drive is None and unit != GATEWAY_UNIT:
            return PATH_UNAVAILABLE
        if len(pdu) != READ_SIZE:
            return ILLEGAL_VALUE
        function, start, count = _READ.unpack(pdu)
        if not 1 <= count <= MOST_WORDS:
            return ILLEGAL_VALUE
        if start + count > 0x10000:
            return ILLEGAL_ADDRESS
        words: bytes | Missing | None
        if drive is None:
            words = gateway_words(start, count, self._image, self._stats, self._now(), self._wall())
        else:
            words = drive.read(start, count, self._now())
        if isinstance(words, bytes):
            return bytes((function, len(words))) + words
        return ILLEGAL_ADDRESS if words is None else _EXCEPTION[words]
