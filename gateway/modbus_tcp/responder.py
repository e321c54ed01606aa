"""Decides what is answered to the bytes of a MODBUS-TCP client: requests in, answers out, no I/O and no clock."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Protocol

from gateway.image import LinkState, Missing, Reading
from gateway.metrics import TcpStats
from gateway.modbus_tcp.codes import CODE_FOR, ExceptionCode
from gateway.modbus_tcp.requests import WRITING

# MODBUS Messaging on TCP/IP Implementation Guide V1.0b, 3.1.3: transaction, protocol, length, unit; then the PDU.
TRANSACTION = 2  # bytes
HEAD = struct.Struct(">HH")  # protocol and length; the length counts what stands behind it, the unit id first
HEAD_END = 6  # bytes, with the transaction
LEAST_LENGTH = 2  # unit id and function code
MOST_LENGTH = 254  # unit id and a PDU of 253 bytes
READ = struct.Struct(">BHH")  # PDU of a request to read registers
UNIT_AT = 4  # bytes behind the transaction
FUNCTION_AT = 5
READ_END = 12  # bytes of such a request, from transaction to count

READ_HOLDING_REGISTERS = 0x03
READ_INPUT_REGISTERS = 0x04
ENCAPSULATED_INTERFACE = 0x2B
IS_EXCEPTION = 0x80
MOST_REGISTERS = 125  # MODBUS Application Protocol V1.1b3, 6.3
KNOWN_AT_MOST = 1024  # requests; a client that asks for everything does not fill the memory


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

    def reading(self, start: int, count: int) -> Reading:
        """Return what reads these words again and again, and always as `read` would."""
        ...


Again = Callable[[float], bytes | None]
"""Answers a request to read that was answered before, all but the transaction; None where `respond` has to."""

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


class Order(Protocol):
    """The requests of one client that are not answered yet: what comes behind them waits too."""

    def __len__(self) -> int:
        """Return how many they are."""
        ...

    def take(self, transaction: bytes, frame: bytes, now: float) -> bytes:
        """Take a request that writes, or has to wait; return all that may be sent by now."""
        ...


class Responder:
    """Answers for all connections of a server; it keeps no state of any of them.

    Masters ask the same again and again: a read that was answered once is known by its bytes.
    """

    def __init__(self, units: Mapping[int, Unit], identify: Identify, stats: TcpStats) -> None:
        self._units = units
        self._identify = identify
        self._requests = stats.requests
        self._exceptions = stats.exceptions
        self._known: dict[bytes, Again] = {}

    @property
    def known(self) -> Mapping[bytes, Again]:
        """Return what answers reads again that were answered before, by their bytes behind the transaction."""
        return self._known

    def respond(self, data: bytes, at: int, limit: int, now: float, order: Order | None = None) -> Turn:
        """Answer the whole requests that stand in `data` from `at`, `limit` of them at most, in their order.

        What writes goes to `order`, and so does all that comes behind it; without one nothing can be written.
        """
        answers: list[bytes] = []
        size = len(data)
        while len(answers) < limit and size - at >= HEAD_END:
            behind = at + TRANSACTION
            protocol, length = HEAD.unpack_from(data, behind)
            if protocol != 0 or not LEAST_LENGTH <= length <= MOST_LENGTH:
                return b"".join(answers), at, CLOSE
            end = at + HEAD_END + length
            if end > size:
                break
            frame = data[behind:end]
            if order is not None and (frame[FUNCTION_AT] in WRITING or order):
                answers.append(order.take(data[at:behind], frame, now))
            else:
                answers.append(data[at:behind] + self.answer(frame, now))
            at = end
        then = GO_ON if len(answers) == limit and at < size else READ_ON
        return b"".join(answers), at, then

    def answer(self, frame: bytes, now: float) -> bytes:
        """Answer a frame, from its protocol id on, at once; nobody here carries out a write."""
        unit, function = frame[UNIT_AT], frame[FUNCTION_AT]
        served = self._units.get(unit)
        if served is None:
            return self.told(frame, ExceptionCode.GATEWAY_PATH_UNAVAILABLE)
        if function in (READ_HOLDING_REGISTERS, READ_INPUT_REGISTERS):
            return self.told(frame, self._read(served, frame, now))
        if function == ENCAPSULATED_INTERFACE:
            return self.told(frame, self._identified(served, frame[FUNCTION_AT:]))
        return self.told(frame, ExceptionCode.ILLEGAL_FUNCTION)

    def told(self, frame: bytes, told: bytes | ExceptionCode) -> bytes:
        """Count the answer to a frame, and put its header in front: all but the transaction."""
        unit, function = frame[UNIT_AT], frame[FUNCTION_AT]
        self._requests[function] += 1
        if isinstance(told, ExceptionCode):
            self._exceptions[told] += 1
            return HEAD.pack(0, 3) + bytes([unit, function | IS_EXCEPTION, told])
        return HEAD.pack(0, 1 + len(told)) + bytes([unit]) + told

    def _read(self, served: Unit, frame: bytes, now: float) -> bytes | ExceptionCode:
        if len(frame) != READ_END - TRANSACTION:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        function, start, count = READ.unpack_from(frame, FUNCTION_AT)
        if not 1 <= count <= MOST_REGISTERS:
            return ExceptionCode.ILLEGAL_DATA_VALUE
        words = served.read(start, count, now)
        if isinstance(words, Missing):
            return CODE_FOR[words]
        told = bytes([function, 2 * count])
        if len(self._known) < KNOWN_AT_MOST:
            head = HEAD.pack(0, 3 + 2 * count) + frame[UNIT_AT : UNIT_AT + 1] + told
            self._known[frame] = self._again(served.reading(start, count), function, head)
        return told + words

    def _again(self, reading: Reading, function: int, head: bytes) -> Again:
        """Make what answers a read again; the answer is kept for as long as the same words are read."""
        requests = self._requests
        read: bytes | Missing = b""
        answer = head

        def again(now: float) -> bytes | None:
            nonlocal read, answer
            words = reading(now)
            if words is not read:
                if not isinstance(words, bytes):
                    return None
                read, answer = words, head + words
            requests[function] += 1
            return answer

        return again

    def _identified(self, served: Unit, pdu: bytes) -> bytes | ExceptionCode:
        """Answer function 43; who was identified and is silent since then may be another drive by now."""
        answer = self._identify(pdu, served.identity if served.link.is_connected else {})
        if answer is ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND and served.link is LinkState.LINE_DOWN:
            return ExceptionCode.GATEWAY_PATH_UNAVAILABLE
        return answer
