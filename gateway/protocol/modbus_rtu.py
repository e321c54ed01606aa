"""MODBUS-RTU as the drives speak it: reads in three forms and the identification."""

from __future__ import annotations

from gateway.errors import Refusal, Refused
from gateway.protocol.checksum import crc16
from gateway.protocol.codec import Answering, Forms, NoSuchForm
from gateway.protocol.pdu import Identify, Identity, ReadBlock, ReadWords, Reply, Request, Words

MAX_ADU = 256  # bytes, number to CRC (MODBUS over Serial Line V1.02)
READ = 0x03  # E6581657 5.1.1-5.1.3
IDENTIFICATION = 0x2B  # E6581657 5.1.7
MEI_TYPE = 0x0E
ERROR_FLAG = 0x80  # E6581657 5.3
ERROR_SIZE = 5
IDENTITY_HEADER = 8  # number, function, MEI type, code, conformity, frames, next object, number of objects
LONGEST_IDENTITY = 64  # characters; the printed ones have 35 and 37

REFUSALS = {
    1: Refusal.COMMAND,
    2: Refusal.ADDRESS,
    3: Refusal.RANGE,
    4: Refusal.UNABLE,
}


class ModbusRtu:
    """The codec."""

    name = "modbus-rtu"
    forms = Forms(range(1, 248), has_direct_block=True, has_block=True, has_exchange=True, has_identification=True)

    def encode(self, request: Request) -> bytes:
        """Return the frame of a request, CRC included."""
        match request:
            case ReadWords(int(number), address, count) | ReadBlock(int(number), address, count):
                body = bytes((number, READ)) + address.to_bytes(2, "big") + count.to_bytes(2, "big")
            case Identify(int(number), code):
                body = bytes((number, IDENTIFICATION, MEI_TYPE, code, 0))
            case _:
                raise NoSuchForm(f"MODBUS-RTU has no frame for {request}")
        return body + crc16(body)

    def answering(self, request: Request) -> Answering:
        """Say whether a request is answered."""
        return Answering.ALWAYS

    def answer_size(self, request: Request) -> int:
        """Return the characters of the normal answer; of an identification, the most that is taken."""
        match request:
            case Identify():
                return LONGEST_IDENTITY
            case ReadWords() | ReadBlock():
                return 5 + 2 * request.count
        raise NoSuchForm(f"MODBUS-RTU has no frame for {request}")

    def least_answer(self, request: Request) -> int:
        """Return the characters of the shortest answer."""
        return ERROR_SIZE

    def decoder(self, request: Request) -> _Decoder:
        """Return a decoder that waits for the reply to this request."""
        return _Decoder(request)


class _Decoder:
    """Finds the one frame that answers: number, function and count must match, and the CRC.

    Bytes in front (an adapter's echo, a glitch of the turnaround, a late answer of another drive) are
    passed over; a frame counts only whole.
    """

    def __init__(self, request: Request) -> None:
        function = IDENTIFICATION if isinstance(request, Identify) else READ
        if not isinstance(request, Identify | ReadWords | ReadBlock) or not isinstance(request.number, int):
            raise NoSuchForm(f"MODBUS-RTU has no answer to {request}")
        self._request = request
        self._error = bytes((request.number, function | ERROR_FLAG))
        if isinstance(request, Identify):
            self._header = bytes((request.number, function, MEI_TYPE, request.code))
        else:
            self._header = bytes((request.number, function, 2 * request.count))
        self._buffer = bytearray()

    @property
    def received(self) -> bytes:
        return bytes(self._buffer)

    def feed(self, data: bytes) -> None:
        self._buffer += data
        if len(self._buffer) > 2 * MAX_ADU:
            del self._buffer[:-MAX_ADU]

    def next_reply(self) -> Reply | None:
        """Return the reply, None while it is not whole; Refused when the drive answers with an error code."""
        for start in range(len(self._buffer)):
            if self._buffer.startswith(self._header, start):
                reply = self._reply_at(start)
                if reply is not None:
                    return reply
            elif self._buffer.startswith(self._error, start):
                self._refusal_at(start)
        return None

    def _frame(self, start: int, size: int) -> bytes | None:
        """Return the frame of that size without its CRC, or None where it is not whole or not sound."""
        end = start + size
        if end > len(self._buffer) or crc16(self._buffer[start : end - 2]) != self._buffer[end - 2 : end]:
            return None
        return bytes(self._buffer[start : end - 2])

    def _reply_at(self, start: int) -> Reply | None:
        if isinstance(self._request, Identify):
            return self._identity_at(start)
        frame = self._frame(start, 5 + 2 * self._request.count)
        if frame is None:
            return None
        return Words(tuple(int.from_bytes(frame[i : i + 2], "big") for i in range(3, len(frame), 2)))

    def _identity_at(self, start: int) -> Identity | None:
        """Walk the objects of an identification; its length is known only from them."""
        if start + IDENTITY_HEADER > len(self._buffer):
            return None
        objects: dict[int, str] = {}
        position = start + IDENTITY_HEADER
        for _ in range(self._buffer[start + IDENTITY_HEADER - 1]):
            if position + 2 > len(self._buffer):
                return None
            number, size = self._buffer[position : position + 2]
            value = self._buffer[position + 2 : position + 2 + size]
            objects[number] = value.decode("ascii", "replace")
            position += 2 + size
        if self._frame(start, position + 2 - start) is None:
            return None
        return Identity(objects.get(0, ""), objects.get(1, ""), objects.get(2, ""))

    def _refusal_at(self, start: int) -> None:
        frame = self._frame(start, ERROR_SIZE)
        if frame is not None:
            code = frame[2]
            reason = REFUSALS.get(code, Refusal.OTHER)
            raise Refused(f"number {self._request.number}: error {code:02X} ({reason.value})", reason)
