"""Decides what is answered to the bytes of a MODBUS-TCP client: requests in, answers out, no I/O and no clock."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from enum import Enum, IntEnum
from typing import Protocol

from gateway.image import LinkState, Missing
from gateway.metrics import TcpStats

# MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3: transaction, protocol, length, unit; then the PDU.
MBAP_BEFORE_LENGTH_ENDS = 6  # bytes; the length counts what stands behind it, the unit id first
LEAST_LENGTH = 2  # unit id and function code
MOST_LENGTH = 254  # unit id and a PDU of 253 bytes
HEAD = struct.Struct(">HHH")
READ = struct.Struct(">HHHBBHH")  # a whole request to read registers
READ_SIZE = READ.size
READ_LENGTH = 6  # unit id, function code, address, count
ANSWER = struct.Struct(">HHHBBB")  # up to the byte count
EXCEPTION = struct.Struct(">HHHBBB")  # a whole one

READ_HOLDING_REGISTERS = 0x03
READ_INPUT_REGISTERS = 0x04
ENCAPSULATED_INTERFACE = 0x2B
IS_EXCEPTION = 0x80
MOST_REGISTERS = 125  # MODBUS Application Protocol V1.1b3, 6.3
ADDRESSES = 0x10000


class ExceptionCode(IntEnum):
    """MODBUS Application Protocol V1.1b3, 7, as far as this gateway uses them."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_DATA_ADDRESS = 0x02
    ILLEGAL_DATA_VALUE = 0x03
    GATEWAY_PATH_UNAVAILABLE = 0x0A
    GATEWAY_TARGET_FAILED_TO_RESPOND = 0x0B


CODE_FOR = {
    Missing.UNMAPPED: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Missing.NOT_FRESH: ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND,
    Missing.LINE_DOWN: ExceptionCode.GATEWAY_PATH_UNAVAILABLE,
}


class Unit(Protocol):
    """Who answers under a unit id: a drive's image or the gateway itself."""

    @property
    def link(self) -> LinkState:
        """Return what is known of the connection to it."""
        ...

    @property
    def identity(self) -> Mapping[str, str]:
        """Return vendor, device and version; empty where not known yet."""
        ...

    def read(self, start: int, count: int, now: float) -> bytes | Missing:
        """Return words as they stand on the wire, or why not."""
        ...


Identify = Callable[[bytes, Mapping[str, str]], bytes | ExceptionCode]
"""Answers a request PDU of function 43 from an identity: the PDU of the answer, or the exception."""


class Then(Enum):
    """What a connection does after its answers."""

    READ_ON = "nothing whole is left: wait for more bytes"
    GO_ON = "the limit is reached: more may wait"
    CLOSE = "the bytes that follow are no MODBUS-TCP header"


READ_ON, GO_ON, CLOSE = Then  # a look-up through the class would cost a tenth of the whole answer
Turn = tuple[bytes, int, Then]
"""The answers, the offset up to which the bytes are used, and what to do next."""


class Responder:
    """Answers for all connections of a server; it keeps no state of any of them."""

    def __init__(self, units: Mapping[int, Unit], identify: Identify, stats: TcpStats) -> None:
        self._units = units
        self._identify = identify
        self._requests = stats.requests
        self._exceptions = stats.exceptions

    def respond(self, data: bytes, at: int, limit: int, now: float) -> Turn:
        """Answer the whole requests that stand in `data` from `at`, `limit` of them at most, in their order."""
        answers: list[bytes] = []
        size = len(data)
        while len(answers) < limit and size - at >= MBAP_BEFORE_LENGTH_ENDS:
            if size - at >= READ_SIZE:
                transaction, protocol, length, unit, function, start, count = READ.unpack_from(data, at)
                if length == READ_LENGTH and protocol == 0 and function in (3, 4):  # nearly all requests
                    answers.append(self._read(transaction, unit, function, start, count, now))
                    at += READ_SIZE
                    continue
            transaction, protocol, length = HEAD.unpack_from(data, at)
            if protocol != 0 or not LEAST_LENGTH <= length <= MOST_LENGTH:
                return b"".join(answers), at, CLOSE
            end = at + MBAP_BEFORE_LENGTH_ENDS + length
            if end > size:
                break
            answers.append(self._other(transaction, data[at + MBAP_BEFORE_LENGTH_ENDS : end]))
            at = end
        then = GO_ON if len(answers) == limit and at < size else READ_ON
        return b"".join(answers), at, then

    def _read(self, transaction: int, unit: int, function: int, start: int, count: int, now: float) -> bytes:
        served = self._units.get(unit)
        if served is None:
            return self._refuse(transaction, unit, function, ExceptionCode.GATEWAY_PATH_UNAVAILABLE)
        if not 1 <= count <= MOST_REGISTERS:
            return self._refuse(transaction, unit, function, ExceptionCode.ILLEGAL_DATA_VALUE)
        if start + count > ADDRESSES:
            return self._refuse(transaction, unit, function, ExceptionCode.ILLEGAL_DATA_ADDRESS)
        words = served.read(start, count, now)
        if not isinstance(words, bytes):
            return self._refuse(transaction, unit, function, CODE_FOR[words])
        self._requests[function] += 1
        size = 2 * count
        return ANSWER.pack(transaction, 0, size + 3, unit, function, size) + words

    def _other(self, transaction: int, adu: bytes) -> bytes:
        """Answer a request that is no well-formed read of registers; `adu` begins with the unit id."""
        unit, function = adu[0], adu[1]
        served = self._units.get(unit)
        if served is None:
            code = ExceptionCode.GATEWAY_PATH_UNAVAILABLE
        elif function in (READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS):
            code = ExceptionCode.ILLEGAL_DATA_VALUE  # its length is wrong
        elif function == ENCAPSULATED_INTERFACE:
            answer = self._told(served, adu[1:])
            if isinstance(answer, bytes):
                self._requests[function] += 1
                return HEAD.pack(transaction, 0, 1 + len(answer)) + adu[:1] + answer
            code = answer
        else:
            code = ExceptionCode.ILLEGAL_FUNCTION
        return self._refuse(transaction, unit, function, code)

    def _told(self, served: Unit, pdu: bytes) -> bytes | ExceptionCode:
        """Answer function 43; who was identified and is silent since then may be another drive by now."""
        answer = self._identify(pdu, served.identity if served.link.is_connected else {})
        if answer is ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND and served.link is LinkState.LINE_DOWN:
            return ExceptionCode.GATEWAY_PATH_UNAVAILABLE
        return answer

    def _refuse(self, transaction: int, unit: int, function: int, code: ExceptionCode) -> bytes:
        self._requests[function] += 1
        self._exceptions[code] += 1
        return EXCEPTION.pack(transaction, 0, 3, unit, function | IS_EXCEPTION, code)
