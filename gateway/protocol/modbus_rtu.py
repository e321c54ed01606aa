"""MODBUS-RTU as the drives speak it (E6581657 5).

The answer to 06H is the same bytes as the request. It cannot be told from an adapter's echo by its bytes: the
exchange compares times with the wire, and writes are read back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from gateway.errors import Refusal, Refused
from gateway.protocol.answers import Dialogue, Said, Shape
from gateway.protocol.checksum import crc16
from gateway.protocol.codec import Answering, Forms, NoSuchForm
from gateway.protocol.fields import ADDRESS, LAST_WORD, WORD, check, check_group, packed, unpacked
from gateway.protocol.frame_codec import FrameCodec
from gateway.protocol.pdu import (
    Exchange,
    Exchanged,
    Group,
    Identify,
    Identity,
    Proportional,
    ReadBlock,
    ReadWords,
    Request,
    Target,
    Words,
    WriteBlock,
    WriteRam,
    WriteStored,
    Written,
)

MAX_ADU = 256  # bytes, number to CRC (MODBUS over Serial Line V1.02)
EVERYBODY = 0
NUMBERS = range(1, 248)

READ = 0x03  # E6581657 5.1.1-5.1.3
WRITE = 0x06  # 5.1.4.1
WRITE_WORDS = 0x10  # 5.1.4.2, 5.1.5
EXCHANGE = 0x17  # 5.1.6
IDENTIFICATION = 0x2B  # 5.1.7
MEI_TYPE = 0x0E
ERROR_FLAG = 0x80  # 5.3
ERROR_SIZE = 5

DIRECT_WORDS = range(1, 9)  # 5.1.1, 5.1.3
BLOCK_WORDS = range(2, 6)  # 5.1.2
BLOCK_WRITE_WORDS = range(2, 3)  # 5.1.5
READ_CODES = range(4)  # 5.1.7

IDENTITY_HEADER = 8  # number, function, MEI type, read code, and the fixed bytes
IDENTITY_FIXED = b"\x01\x00\x00\x03"  # conformity, no further frames, no next object, three objects
OBJECTS = range(3)  # vendor, device, version
LONGEST_IDENTITY = 64  # characters; the printed ones have 35 and 37

REFUSALS = {
    1: Refusal.COMMAND,
    2: Refusal.ADDRESS,
    3: Refusal.RANGE,
    4: Refusal.UNABLE,
}


@dataclass(frozen=True, slots=True)
class ModbusRtu(FrameCodec):
    """The codec. `writes_by_10h`: write single words by 10H in place of 06H (E6581657 5.1.4.2)."""

    writes_by_10h: bool = False

    name = "modbus-rtu"
    forms = Forms(
        NUMBERS,
        has_direct_block=True,
        has_block=True,
        has_exchange=True,
        writes_all_or_none=True,
        has_identification=True,
    )

    def dialogue(self, request: Request) -> Dialogue:
        """Return the frame of a request and its answers: number 0 has none, a fault reset is only refused."""
        body = bytes((self._number(request),)) + self._body(request)
        frame = body + crc16(body)
        if isinstance(request.number, Group):
            return Dialogue(frame, Answering.NEVER)
        refusal = Shape(_error_start(body), ERROR_SIZE, partial(_refusal, request.number))
        if isinstance(request, WriteRam) and not request.is_answered:
            return Dialogue(frame, Answering.MAYBE, (), (refusal,))
        return Dialogue(frame, Answering.ALWAYS, (_normal(body, request),), (refusal,))

    def _number(self, request: Request) -> int:
        match request.number:
            case int(number):
                check(self.name, "inverter number", number, self.forms.numbers)
                return number
            case Group() as group:
                check_group(self.name, group, self.forms.has_digit_groups)
                if not isinstance(request, WriteRam | WriteStored | WriteBlock):
                    raise NoSuchForm(f"{self.name}: number 0 is for writes only, for nobody answers: {request}")
                return EVERYBODY
        raise NoSuchForm(f"{self.name}: a request needs an inverter number: {request}")

    def _body(self, request: Request) -> bytes:
        match request:
            case ReadWords(_, address, count):
                check(self.name, "count of a direct read", count, DIRECT_WORDS)
                check(self.name, "last communication number of a read", address + count - 1, range(LAST_WORD + 1))
                return bytes((READ,)) + packed(ADDRESS, address, count)
            case ReadBlock(_, address, count):
                check(self.name, "count of a block read", count, BLOCK_WORDS)
                return bytes((READ,)) + packed(ADDRESS, address, count)
            case WriteRam(_, address, word) | WriteStored(_, address, word):
                if self.writes_by_10h:
                    return bytes((WRITE_WORDS,)) + _counted(address, (word,))
                return bytes((WRITE,)) + packed(ADDRESS, address) + packed(WORD, word)
            case WriteBlock(_, address, words):
                check(self.name, "count of a block write", len(words), BLOCK_WRITE_WORDS)
                return bytes((WRITE_WORDS,)) + _counted(address, words)
            case Exchange(_, read_address, count, address, words):
                check(self.name, "count of a block read", count, BLOCK_WORDS)
                check(self.name, "count of a block write", len(words), BLOCK_WRITE_WORDS)
                return bytes((EXCHANGE,)) + packed(ADDRESS, read_address, count) + _counted(address, words)
            case Identify(_, code):
                check(self.name, "read code of an identification", code, READ_CODES)
                return bytes((IDENTIFICATION, MEI_TYPE, code, 0))
            case Proportional():
                raise NoSuchForm(f"{self.name} has no proportional command: write the frequency")


def _counted(address: int, words: tuple[int, ...]) -> bytes:
    """Return the number, the count of words, the count of bytes and the words of a write."""
    data = packed(WORD, *words)
    return packed(ADDRESS, address, len(words)) + bytes((len(data),)) + data


def _error_start(body: bytes) -> bytes:
    number, function = body[:2]
    return bytes((number, function | ERROR_FLAG))


def _normal(body: bytes, request: Request) -> Shape:
    """Return what the normal answer to a frame looks like."""
    head = body[:2]
    match request:
        case Identify():
            return Shape(body[:4] + IDENTITY_FIXED, LONGEST_IDENTITY, _identity, _identity_size)
        case ReadWords() | ReadBlock():
            return Shape(head + bytes((2 * request.count,)), 5 + 2 * request.count, _words)
        case Exchange():
            return Shape(head + bytes((2 * request.count,)), 5 + 2 * request.count, _exchanged)
    return Shape(body[:6], 8, _written)  # number, function, address, and the word of 06H or the count of 10H


def _is_sound(frame: bytes) -> bool:
    return crc16(frame[:-2]) == frame[-2:]


def _words(frame: bytes) -> Said | None:
    return Words(unpacked(frame[3:-2])) if _is_sound(frame) else None


def _exchanged(frame: bytes) -> Said | None:
    return Exchanged(unpacked(frame[3:-2])) if _is_sound(frame) else None


def _written(frame: bytes) -> Said | None:
    return Written() if _is_sound(frame) else None


def _refusal(target: Target, frame: bytes) -> Said | None:
    code = frame[2]
    reason = REFUSALS.get(code, Refusal.OTHER)
    return Refused(f"number {target}: error {code:02X} ({reason.value})", reason) if _is_sound(frame) else None


def _identity_size(beginning: bytes) -> int:
    """Walk the objects of an identification, which alone tell its length; 0 where they cannot be those of a drive."""
    size = IDENTITY_HEADER
    for place in OBJECTS:
        size += 2  # the object's number and length
        if size > len(beginning):
            break
        if beginning[size - 2] != place:
            return 0
        size += beginning[size - 1]
    size += 2
    return size if size <= LONGEST_IDENTITY else 0


def _identity(frame: bytes) -> Said | None:
    texts, at = [], IDENTITY_HEADER
    for _ in OBJECTS:
        end = at + 2 + frame[at + 1]
        texts.append(frame[at + 2 : end])
        at = end
    if not _is_sound(frame) or not all(text.isascii() for text in texts):
        return None
    vendor, device, version = (text.decode("ascii") for text in texts)
    return Identity(vendor, device, version)
