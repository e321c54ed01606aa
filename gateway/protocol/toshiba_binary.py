"""The TOSHIBA protocol in binary mode (E6581657 4.1.2, 4.1.3; VF-MB1 manual 4.2, 6.2).

The answer to P, W and G may be the same bytes as the request. Such an answer cannot be told from an adapter's echo
by its bytes: the exchange compares times with the wire, and writes are read back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from gateway.protocol import toshiba
from gateway.protocol.answers import Dialogue, Said, Shape
from gateway.protocol.checksum import sum8
from gateway.protocol.codec import Answering, Forms, NoSuchForm
from gateway.protocol.fields import ADDRESS, WORD, check, check_group, packed, unpacked
from gateway.protocol.frame_codec import FrameCodec
from gateway.protocol.pdu import (
    Exchange,
    Exchanged,
    Group,
    Identify,
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

START = b"/"
EVERYBODY = 0xFF
NUMBERS = range(0x40)  # 00H to 3FH
SINGLE = range(1, 2)
READ_GROUPS = range(1, 6)  # data selected by F875-F879
WRITE_GROUPS = range(1, 6)  # two that F870 and F871 select; with FA80 = 1 the five of the panel's text (7.3.1)
WRITE_STATUS = range(4)  # a bit for each of F870 and F871 that could not be written
PROPORTIONS = range(10001)  # 0.01 %
DUMMY = b"\x00\x00"  # data of G

ReadField = Callable[[bytes, bool], Said | None]


@dataclass(frozen=True, slots=True)
class ToshibaBinary(FrameCodec):
    """The codec. `reads_by_g`: read by G, which two-wire lines of older models need (E6581657 4.2)."""

    reads_by_g: bool = False

    name = "toshiba-binary"
    forms = Forms(
        NUMBERS, has_block=True, has_exchange=True, has_ram_write=True, has_proportional=True, says_tripped=True
    )

    def dialogue(self, request: Request) -> Dialogue:
        """Return the frame of a request and its answers: of all drives the one numbered 00 answers, and none to S."""
        command = self._command(request)
        body = START + self._number(request.number) + command
        frame = body + bytes((sum8(body),))
        if isinstance(request, Proportional):
            return Dialogue(frame, Answering.NEVER)
        number = toshiba.answerer(request.number)
        head = START if number is None else START + bytes((number,))
        refusals = tuple(_shapes(head, toshiba.REFUSAL, b"", 2, partial(_refusal, request.number)))
        if isinstance(request, WriteRam) and not request.is_answered:
            return Dialogue(frame, Answering.MAYBE, (), refusals)
        return Dialogue(frame, toshiba.answering(request.number), tuple(_normal(head, request, command)), refusals)

    def _number(self, target: Target) -> bytes:
        if target is None:
            return b""
        if isinstance(target, Group):
            check_group(self.name, target, self.forms.has_digit_groups)
            return bytes((EVERYBODY,))
        check(self.name, "inverter number", target, self.forms.numbers)
        return bytes((target,))

    def _command(self, request: Request) -> bytes:
        match request:
            case ReadWords(_, address, count):
                check(self.name, "count of a read", count, SINGLE)
                command, dummy = (toshiba.READ_TWO_WIRE, DUMMY) if self.reads_by_g else (toshiba.READ, b"")
                return command + packed(ADDRESS, address) + dummy
            case WriteRam(_, address, word):
                return toshiba.WRITE_RAM + packed(ADDRESS, address) + packed(WORD, word)
            case WriteStored(_, address, word):
                return toshiba.WRITE_STORED + packed(ADDRESS, address) + packed(WORD, word)
            case ReadBlock(_, _, count):
                return toshiba.BLOCK + bytes((0, self._read_groups(count)))
            case WriteBlock(_, _, words):
                return toshiba.BLOCK + bytes((self._write_groups(words), 0)) + packed(WORD, *words)
            case Exchange(_, _, count, _, words):
                groups = bytes((self._write_groups(words), self._read_groups(count)))
                return toshiba.BLOCK + groups + packed(WORD, *words)
            case Proportional(_, address, word, is_master_tripped):
                check(self.name, "proportion in 0.01 %", word, PROPORTIONS)
                command = toshiba.PROPORTIONAL.lower() if is_master_tripped else toshiba.PROPORTIONAL
                return command + packed(ADDRESS, address) + packed(WORD, word)
            case Identify():
                raise NoSuchForm(f"{self.name} has no identification: read the registers that tell the type")

    def _read_groups(self, count: int) -> int:
        check(self.name, "count of a block read", count, READ_GROUPS)
        return count

    def _write_groups(self, words: tuple[int, ...]) -> int:
        check(self.name, "count of a block write", len(words), WRITE_GROUPS)
        return len(words)


def _normal(head: bytes, request: Request, command: bytes) -> Iterable[Shape]:
    """Return what the normal answers to a command look like."""
    match request:
        case ReadWords():
            return _shapes(head, command[:1], command[1:3], 2, _words)
        case ReadBlock(_, _, count):
            return _block_shapes(head, count, _block_read)
        case WriteBlock(_, _, words):
            return _block_shapes(head, 0, partial(_block_written, len(words)))
        case Exchange(_, _, count, _, words):
            return _block_shapes(head, count, partial(_exchanged, len(words)))
    return _shapes(head, command[:1], command[1:], 0, _written)


def _shapes(head: bytes, command: bytes, fixed: bytes, data: int, read: ReadField) -> Iterable[Shape]:
    """Return the answers with a command in upper and lower case: fixed bytes, then that many of data, the sum."""
    for letter, is_tripped in toshiba.letters(command):
        start = head + letter + fixed
        yield Shape(start, len(start) + data + 1, partial(_sound, len(start), read, is_tripped))


def _block_shapes(head: bytes, count: int, read: ReadField) -> Iterable[Shape]:
    return _shapes(head, toshiba.BLOCK_ANSWER, bytes((count,)), 1 + 2 * count, read)


def _sound(data: int, read: ReadField, is_tripped: bool, frame: bytes) -> Said | None:
    """Return what a frame's data say, None where the sum is wrong."""
    return read(frame[data:-1], is_tripped) if sum8(frame[:-1]) == frame[-1] else None


def _words(data: bytes, is_tripped: bool) -> Said | None:
    return Words(unpacked(data), is_tripped)


def _written(_data: bytes, is_tripped: bool) -> Said | None:
    return Written((), is_tripped)


def _refusal(target: Target, data: bytes, is_tripped: bool) -> Said | None:
    return toshiba.refused(target, unpacked(data)[0], is_tripped)


def _failed(status: int, written: int) -> tuple[int, ...]:
    """Return the places of the words that the write status says were not written."""
    return tuple(place for place in range(written) if status >> place & 1)


def _block_read(data: bytes, is_tripped: bool) -> Said | None:
    return Words(unpacked(data[1:]), is_tripped) if data[0] in WRITE_STATUS else None


def _block_written(written: int, data: bytes, is_tripped: bool) -> Said | None:
    return Written(_failed(data[0], written), is_tripped) if data[0] in WRITE_STATUS else None


def _exchanged(written: int, data: bytes, is_tripped: bool) -> Said | None:
    if data[0] not in WRITE_STATUS:
        return None
    return Exchanged(unpacked(data[1:]), _failed(data[0], written), is_tripped)
