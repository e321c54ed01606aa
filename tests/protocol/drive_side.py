"""What drives answer, built from the manuals alone: no code of the codecs is used, so that it can judge them.

A dialect makes requests, the answers to them as frames, and says of any bytes what they say if they are exactly
an answer to a request.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from gateway.errors import Refusal, Refused
from gateway.protocol.codec import Codec, Decoder
from gateway.protocol.pdu import (
    Exchange,
    Exchanged,
    Identify,
    Identity,
    Proportional,
    ReadBlock,
    ReadWords,
    Reply,
    Request,
    Words,
    WriteBlock,
    WriteRam,
    Written,
)

Pick = Callable[[int, int], int]
"""Chooses an integer between two, both included: chance or hypothesis."""


@dataclass(frozen=True, slots=True)
class Denied:
    """A refusal as a value."""

    reason: Refusal
    is_tripped: bool | None


Heard = Reply | Denied


@dataclass(frozen=True, slots=True)
class Content:
    """What a drive puts into an answer."""

    words: tuple[int, ...] = ()
    status: int = 0
    is_tripped: bool = False
    texts: tuple[bytes, ...] = (b"TOSHIBA", b"VFnC3-2007P", b"0100")


def heard(decoder: Decoder, pieces: Iterable[bytes]) -> list[Heard]:
    """Feed pieces and return everything that the decoder says, in order."""
    said: list[Heard] = []
    for piece in pieces:
        decoder.feed(piece)
        while (reply := _next(decoder)) is not None:
            said.append(reply)
    return said


def _next(decoder: Decoder) -> Heard | None:
    try:
        return decoder.next_reply()
    except Refused as refused:
        return Denied(refused.reason, refused.is_tripped)


def _shifted(register: int) -> int:
    for _ in range(8):
        register, out = register >> 1, register & 1
        register ^= 0xA001 * out
    return register


SHIFTED = [_shifted(byte) for byte in range(256)]  # the eight steps for each byte that can be shifted out


def crc(body: bytes) -> bytes:
    """Follow the steps of E6581657 5.2."""
    register = 0xFFFF
    for byte in body:
        register = SHIFTED[register & 0xFF ^ byte] ^ register >> 8
    return bytes((register & 0xFF, register >> 8))


def pair(word: int) -> bytes:
    """Return a word, high byte first."""
    return bytes((word >> 8, word & 0xFF))


def pairs(words: Iterable[int]) -> bytes:
    """Return words, each with its high byte first."""
    return b"".join(pair(word) for word in words)


def unpaired(data: bytes) -> tuple[int, ...]:
    """Return the words of pairs of bytes."""
    return tuple(high << 8 | low for high, low in zip(data[::2], data[1::2], strict=False))


def wanted(request: Request) -> int:
    """Return how many words a request reads."""
    return request.count if isinstance(request, ReadWords | ReadBlock | Exchange) else 0


def is_unanswered(request: Request) -> bool:
    """Say whether a drive has no normal answer to a request."""
    return isinstance(request, Proportional) or (isinstance(request, WriteRam) and not request.is_answered)


class Dialect(ABC):
    """One codec and what the manual says about its answers."""

    codec: Codec
    error_codes: tuple[int, int] = (0, 5)  # one more than the manual knows

    @abstractmethod
    def request(self, pick: Pick) -> Request:
        """Make up a request that the protocol has."""

    @abstractmethod
    def frame(self, request: Request, content: Content) -> bytes:
        """Return the normal answer, b"" where nobody gives it."""

    @abstractmethod
    def refusal(self, request: Request, code: int, is_tripped: bool) -> bytes:
        """Return the answer of a drive that refuses, b"" where nobody answers."""

    @abstractmethod
    def contents(self, request: Request, frame: bytes) -> Iterator[Content]:
        """Return what would have to be in a frame if it were a normal answer."""

    @abstractmethod
    def codes(self, request: Request, frame: bytes) -> Iterator[tuple[int, bool]]:
        """Return the error code and the tripped state of a frame if it were a refusal."""

    @abstractmethod
    def denied(self, code: int, is_tripped: bool) -> Denied:
        """Return what a refusal says."""

    @abstractmethod
    def sealed(self, frame: bytes) -> bytes:
        """Return a frame with the checksum that its bytes ask for."""

    def content(self, request: Request, pick: Pick) -> Content:
        """Make up what an answer may contain."""
        words = tuple(pick(0, 0xFFFF) for _ in range(wanted(request)))
        return Content(words, pick(0, 3), bool(pick(0, 1)))

    def sizes(self, request: Request) -> set[int]:
        """Return the lengths that an answer can have."""
        content = Content((0,) * wanted(request))
        return {len(self.frame(request, content)), len(self.refusal(request, 0, False))} - {0}

    def said(self, request: Request, frame: bytes) -> Heard | None:
        """Return what bytes say that are exactly an answer to a request."""
        for content in self.contents(request, frame):
            if self.frame(request, content) == frame:
                return self.reply(request, content)
        for code, is_tripped in self.codes(request, frame):
            if self.refusal(request, code, is_tripped) == frame:
                return self.denied(code, is_tripped)
        return None

    def answers_in(self, request: Request, data: bytes) -> list[Heard]:
        """Return what all exact answers say that are anywhere in the data."""
        first = self.codec.encode(request)[0]
        sizes = self.sizes(request)
        found = (
            self.said(request, data[start : start + size])
            for start, byte in enumerate(data)
            if byte == first
            for size in sizes
            if start + size <= len(data)
        )
        return [said for said in found if said is not None]

    def reply(self, request: Request, content: Content) -> Reply:
        """Return the reply that a normal answer is to be decoded to."""
        is_tripped = content.is_tripped if self.codec.forms.says_tripped else None
        match request:
            case ReadWords() | ReadBlock():
                return Words(content.words, is_tripped)
            case Exchange():
                return Exchanged(content.words, self.failed(request.words, content), is_tripped)
            case WriteBlock():
                return Written(self.failed(request.words, content), is_tripped)
            case Identify():
                vendor, device, version = (text.decode() for text in content.texts)
                return Identity(vendor, device, version)
        return Written((), is_tripped)

    def failed(self, words: tuple[int, ...], content: Content) -> tuple[int, ...]:
        """Return which words the write status says were not written (Y only)."""
        return tuple(place for place in range(len(words)) if content.status & 1 << place)
