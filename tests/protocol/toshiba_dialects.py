"""What a drive answers in both modes of the TOSHIBA protocol (E6581657 4)."""

from __future__ import annotations

import re
from collections.abc import Iterator

from gateway.errors import Refusal
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Group,
    Proportional,
    ReadBlock,
    ReadWords,
    Request,
    WriteBlock,
    WriteRam,
    WriteStored,
)
from gateway.protocol.toshiba_ascii import ToshibaAscii
from gateway.protocol.toshiba_binary import ToshibaBinary
from tests.protocol.drive_side import (
    Content,
    Denied,
    Dialect,
    Pick,
    is_unanswered,
    pair,
    pairs,
    unpaired,
    wanted,
)

TOSHIBA_REASONS = {
    0: Refusal.UNABLE,
    1: Refusal.RANGE,
    2: Refusal.ADDRESS,
    3: Refusal.COMMAND,
    4: Refusal.CHECKSUM,
}


class Toshiba(Dialect):
    """What both modes share: targets, letters, error codes."""

    highest_number: int

    def target(self, pick: Pick) -> int | Group | None:
        """Make up whom a request is for; mostly a drive of its own."""
        groups = [EVERY_DRIVE]
        if self.codec.forms.has_digit_groups:
            groups += [Group(pick(0, 9), None), Group(None, pick(0, 9))]
        choice = pick(0, 9)
        if choice == 0:
            return None
        return pick(0, self.highest_number) if choice < 8 else groups[pick(0, len(groups) - 1)]

    def number(self, request: Request) -> int | None:
        """Return the number in an answer: of a group the smallest that its digits allow (4.4)."""
        match request.number:
            case Group(tens, ones):
                return 10 * (tens or 0) + (ones or 0)
        return request.number

    def letter(self, request: Request) -> str:
        """Return the command that an answer carries while the drive is not tripped."""
        match request:
            case ReadWords():
                return "R"
            case WriteRam():
                return "P"
            case WriteStored():
                return "W"
        return "Y"

    def denied(self, code: int, is_tripped: bool) -> Denied:
        return Denied(TOSHIBA_REASONS.get(code, Refusal.OTHER), is_tripped)


def cased(letter: str, is_tripped: bool) -> str:
    """Return a command in lower case where the drive is tripped (4.1)."""
    return letter.lower() if is_tripped else letter


class Ascii(Toshiba):
    """The TOSHIBA protocol in ASCII mode (E6581657 4.1.1)."""

    highest_number = 99

    def __init__(self, has_checksum: bool = True, has_stop: bool = True) -> None:
        self.codec = ToshibaAscii(has_checksum, has_stop)
        self.has_checksum = has_checksum
        self.has_stop = has_stop

    def request(self, pick: Pick) -> Request:
        target, address, word = self.target(pick), pick(0, 0xFFFF), pick(0, 0xFFFF)
        requests: list[Request] = [
            ReadWords(target, address),
            WriteRam(target, address, word, bool(pick(0, 3))),
            WriteStored(target, address, word),
        ]
        return requests[pick(0, 2)]

    def closed(self, text: str) -> bytes:
        """Return a text from its bracket on, with what ends it."""
        if self.has_checksum:
            text += "&"
            text += f"{sum(map(ord, text)) % 256:02X}"
        return (text + (")" if self.has_stop else "") + "\r").encode("latin-1")

    def sealed(self, frame: bytes) -> bytes:
        return self.closed(frame[: len(frame) - len(self.closed(""))].decode("latin-1"))

    def opened(self, request: Request) -> str:
        """Return the bracket and the number."""
        number = self.number(request)
        return "(" if number is None else f"({number:02}"

    def frame(self, request: Request, content: Content) -> bytes:
        if is_unanswered(request):
            return b""
        assert isinstance(request, ReadWords | WriteRam | WriteStored)
        word = content.words[0] if isinstance(request, ReadWords) else request.word
        letter = cased(self.letter(request), content.is_tripped)
        return self.closed(f"{self.opened(request)}{letter}{request.address:04X}{word:04X}")

    def refusal(self, request: Request, code: int, is_tripped: bool) -> bytes:
        return self.closed(f"{self.opened(request)}{cased('N', is_tripped)}{code:04X}")

    def contents(self, request: Request, frame: bytes) -> Iterator[Content]:
        word = self.last_word(frame)
        for is_tripped in (False, True) if word is not None else ():
            yield Content((word,) if wanted(request) and word is not None else (), is_tripped=is_tripped)

    def codes(self, request: Request, frame: bytes) -> Iterator[tuple[int, bool]]:
        word = self.last_word(frame)
        for is_tripped in (False, True) if word is not None else ():
            yield word or 0, is_tripped

    def last_word(self, frame: bytes) -> int | None:
        """Return the four digits in front of what ends a frame; a sign is no digit, though Python reads it."""
        end = len(frame) - len(self.closed(""))
        digits = frame[end - 4 : end]
        return int(digits, 16) if re.fullmatch(rb"[0-9A-F]{4}", digits) else None


class Binary(Toshiba):
    """The TOSHIBA protocol in binary mode (E6581657 4.1.2, 4.1.3)."""

    highest_number = 0x3F

    def __init__(self, reads_by_g: bool = False) -> None:
        self.codec = ToshibaBinary(reads_by_g)
        self.reads_by_g = reads_by_g

    def request(self, pick: Pick) -> Request:
        target, address, word = self.target(pick), pick(0, 0xFFFF), pick(0, 0xFFFF)
        words = tuple(pick(0, 0xFFFF) for _ in range(pick(1, 2)))
        requests: list[Request] = [
            ReadWords(target, address),
            ReadBlock(target, 0, pick(1, 5)),
            WriteRam(target, address, word, bool(pick(0, 3))),
            WriteStored(target, address, word),
            WriteBlock(target, 0, words),
            Exchange(target, 0, pick(1, 5), 0, words),
        ]
        return requests[pick(0, 5)]

    def closed(self, request: Request, letter: str, is_tripped: bool, data: bytes) -> bytes:
        """Return a frame with its number and its sum."""
        number = self.number(request)
        head = b"/" if number is None else bytes((0x2F, number))
        body = head + cased(letter, is_tripped).encode() + data
        return body + bytes((sum(body) % 256,))

    def sealed(self, frame: bytes) -> bytes:
        return frame[:-1] + bytes((sum(frame[:-1]) % 256,))

    def letter(self, request: Request) -> str:
        return "G" if self.reads_by_g and isinstance(request, ReadWords) else super().letter(request)

    def frame(self, request: Request, content: Content) -> bytes:
        if is_unanswered(request):
            return b""
        match request:
            case ReadWords():
                data = pair(request.address) + pairs(content.words)
            case WriteRam() | WriteStored():
                data = pair(request.address) + pair(request.word)
            case _:
                data = bytes((len(content.words), content.status)) + pairs(content.words)
        return self.closed(request, self.letter(request), content.is_tripped, data)

    def refusal(self, request: Request, code: int, is_tripped: bool) -> bytes:
        return b"" if isinstance(request, Proportional) else self.closed(request, "N", is_tripped, pair(code))

    def contents(self, request: Request, frame: bytes) -> Iterator[Content]:
        count = wanted(request)
        if len(frame) < 2 + 2 * count:
            return
        words = unpaired(frame[-1 - 2 * count : -1]) if count else ()
        status = frame[-2 - 2 * count]
        is_block = self.letter(request) == "Y"
        for is_tripped in (False, True) if not is_block or status <= 3 else ():
            yield Content(words, status if is_block else 0, is_tripped)

    def codes(self, request: Request, frame: bytes) -> Iterator[tuple[int, bool]]:
        for is_tripped in (False, True):
            yield unpaired(frame[-3:-1])[0], is_tripped
