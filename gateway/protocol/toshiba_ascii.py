"""The TOSHIBA protocol in ASCII mode (E6581657 4.1.1).

The answer to P and W of one drive is the same bytes as the request, for words are sent with all four digits.
It cannot be told from an adapter's echo by its bytes: the exchange compares times with the wire, and writes are
read back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from gateway.protocol import toshiba
from gateway.protocol.answers import Dialogue, Said, Shape
from gateway.protocol.checksum import sum8
from gateway.protocol.codec import Answering, Forms, NoSuchForm
from gateway.protocol.fields import ADDRESS, WORD, check, check_group, packed
from gateway.protocol.frame_codec import FrameCodec
from gateway.protocol.pdu import (
    Exchange,
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

START = b"("
SUM = b"&"
STOP = b")"
END = b"\r"
NUMBERS = range(100)
SINGLE = range(1, 2)
DIGITS = 4  # of a word
HEXADECIMAL = frozenset(b"0123456789ABCDEF")

ReadWord = Callable[[int, bool], Said | None]


@dataclass(frozen=True, slots=True)
class ToshibaAscii(FrameCodec):
    """The codec, with or without the omissible parts; an answer has those that its request had."""

    has_checksum: bool = True
    has_stop: bool = True

    name = "toshiba-ascii"
    forms = Forms(NUMBERS, has_ram_write=True, has_digit_groups=True, says_tripped=True)

    def dialogue(self, request: Request) -> Dialogue:
        """Return the frame of a request and its answers: of a group the drive with 0 in the place of `*` answers."""
        command = self._command(request)
        frame = self._closed(START + self._number(request.number) + command)
        number = toshiba.answerer(request.number)
        head = START if number is None else START + b"%02d" % number
        refusals = tuple(self._shapes(head, toshiba.REFUSAL, DIGITS, partial(_refusal, request.number)))
        if isinstance(request, WriteRam) and not request.is_answered:
            return Dialogue(frame, Answering.MAYBE, (), refusals)
        is_read = isinstance(request, ReadWords)
        normal = self._shapes(head, command, DIGITS if is_read else 0, _words if is_read else _written)
        return Dialogue(frame, toshiba.answering(request.number), tuple(normal), refusals)

    def _closed(self, text: bytes) -> bytes:
        """Return a text with its checksum, stop code and carriage return."""
        if self.has_checksum:
            text += SUM
            text += b"%02X" % sum8(text)
        return text + (STOP + END if self.has_stop else END)

    def _number(self, target: Target) -> bytes:
        if target is None:
            return b""
        if isinstance(target, Group):
            check_group(self.name, target, self.forms.has_digit_groups)
            return str(target).encode("ascii")
        check(self.name, "inverter number", target, self.forms.numbers)
        return b"%02d" % target

    def _command(self, request: Request) -> bytes:
        match request:
            case ReadWords(_, address, count):
                check(self.name, "count of a read", count, SINGLE)
                return toshiba.READ + _digits(ADDRESS, address)
            case WriteRam(_, address, word):
                return toshiba.WRITE_RAM + _digits(ADDRESS, address) + _digits(WORD, word)
            case WriteStored(_, address, word):
                return toshiba.WRITE_STORED + _digits(ADDRESS, address) + _digits(WORD, word)
            case ReadBlock() | WriteBlock() | Exchange():
                raise NoSuchForm(f"{self.name} has no block: read and write its words one by one")
            case Identify():
                raise NoSuchForm(f"{self.name} has no identification: read the registers that tell the type")
            case Proportional():
                raise NoSuchForm(f"{self.name} has no proportional command: write the frequency")

    def _shapes(self, head: bytes, text: bytes, digits: int, read: ReadWord) -> Iterable[Shape]:
        """Return the answers with a text in upper and lower case of its command, and that many digits behind it."""
        closing = len(self._closed(b""))
        for letter, is_tripped in toshiba.letters(text[:1]):
            start = head + letter + text[1:]
            size = len(start) + digits + closing
            yield Shape(start, size, partial(self._read, len(start), closing, read, is_tripped))

    def _read(self, data: int, closing: int, read: ReadWord, is_tripped: bool, frame: bytes) -> Said | None:
        """Return what a frame's word says, None where a digit, the sum or the end is wrong."""
        text = frame[:-closing]
        digits = text[data:]
        if not HEXADECIMAL.issuperset(digits) or self._closed(text) != frame:
            return None
        return read(int(digits or b"0", 16), is_tripped)


def _digits(what: str, value: int) -> bytes:
    return packed(what, value).hex().upper().encode("ascii")


def _words(word: int, is_tripped: bool) -> Said:
    return Words((word,), is_tripped)


def _written(_word: int, is_tripped: bool) -> Said:
    return Written((), is_tripped)


def _refusal(target: Target, code: int, is_tripped: bool) -> Said:
    return toshiba.refused(target, code, is_tripped)
