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
from gateway.protocol.answers import AnswerDecoder, Answers, Said, Shape
from gateway.protocol.checksum import sum8
from gateway.protocol.codec import Answering, Forms, NoSuchForm
from gateway.protocol.fields import ADDRESS, WORD, check, check_group, packed
from gateway.protocol.pdu import Group, ReadWords, Request, Target, Words, WriteRam, WriteStored, Written

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
class ToshibaAscii:
    """The codec, with or without the omissible parts; an answer has those that its request had."""

    has_checksum: bool = True
    has_stop: bool = True

    name = "toshiba-ascii"
    forms = Forms(NUMBERS, has_ram_write=True, has_digit_groups=True, says_tripped=True)

    def encode(self, request: Request) -> bytes:
        """Return the frame of a request."""
        return self._closed(START + self._number(request.number) + self._command(request))

    def answering(self, request: Request) -> Answering:
        """Say whether a request is answered: for a group only by the drive with 0 in the place of `*`."""
        is_unanswered = isinstance(request, WriteRam) and not request.is_answered
        return Answering.MAYBE if is_unanswered or isinstance(request.number, Group) else Answering.ALWAYS

    def answer_size(self, request: Request) -> int:
        """Return the characters of the normal answer."""
        return self._answers(request).size

    def least_answer(self, request: Request) -> int:
        """Return the characters of the shortest answer."""
        return self._answers(request).least

    def decoder(self, request: Request) -> AnswerDecoder:
        """Return a decoder that waits for the reply to this request."""
        return AnswerDecoder(self._answers(request))

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
                check(self.name, "words read by one R", count, SINGLE)
                return toshiba.READ + _digits(ADDRESS, address)
            case WriteRam(_, address, word):
                return toshiba.WRITE_RAM + _digits(ADDRESS, address) + _digits(WORD, word)
            case WriteStored(_, address, word):
                return toshiba.WRITE_STORED + _digits(ADDRESS, address) + _digits(WORD, word)
        raise NoSuchForm(f"{self.name} has no frame for {request}")

    def _answers(self, request: Request) -> Answers:
        echo = self.encode(request)
        number = toshiba.answerer(request.number)
        head = START if number is None else START + b"%02d" % number
        refusals = self._shapes(head, toshiba.REFUSAL, DIGITS, partial(_refusal, request.number))
        return Answers(echo, tuple(self._normal(head, request)), tuple(refusals))

    def _normal(self, head: bytes, request: Request) -> Iterable[Shape]:
        match request:
            case WriteRam(is_answered=False):
                return ()
            case ReadWords():
                return self._shapes(head, self._command(request), DIGITS, _words)
        return self._shapes(head, self._command(request), 0, _written)

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
