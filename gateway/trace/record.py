"""What a line tells of each exchange: its bytes, its times, and how it ended; made while it runs, read later."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from gateway.errors import BadReply, GatewayError, LineDown, NoReply, Refused
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Reply, Request

LONGEST = 4096  # received bytes that are kept of one exchange: more is no frame of these drives

Piece = tuple[float, bytes]
"""Bytes that arrived together, and when they were there, in monotonic seconds."""


class Verdict(Enum):
    """What was made of an exchange, or of bytes that came."""

    ANSWERED = "answered"
    REFUSED = "refused"
    NOT_AWAITED = "no answer awaited"
    NO_REPLY = "no reply"
    BAD_REPLY = "bad reply"
    LINE_DOWN = "line down"
    BROKEN_OFF = "broken off"
    EARLY = "early"  # sooner than the wire allows
    ECHO = "echo"  # the request itself, by the adapter
    LATE = "late"  # an answer, but when it was awaited no more
    NOISE = "noise"  # bytes that are no answer to anything asked

    @classmethod
    def of(cls, error: GatewayError) -> Verdict:
        """Return what an exchange came to that ended in this error."""
        for kind, verdict in _OF_ERRORS.items():
            if isinstance(error, kind):
                return verdict
        return cls.BROKEN_OFF


_OF_ERRORS: dict[type[GatewayError], Verdict] = {
    NoReply: Verdict.NO_REPLY,
    BadReply: Verdict.BAD_REPLY,
    Refused: Verdict.REFUSED,
    LineDown: Verdict.LINE_DOWN,
}


class Hearing:
    """The pieces that arrive during one exchange, in the order of time.

    The first `early` of them were dropped as sooner than the wire allows; those from `ended` on came when the
    exchange had ended already.
    """

    __slots__ = ("early", "ended", "pieces", "room")

    def __init__(self) -> None:
        self.pieces: list[Piece] = []
        self.early = 0
        self.ended: int | None = None
        self.room = LONGEST

    def take(self, when: float, data: bytes) -> None:
        """Keep a piece, as long as there is room."""
        if self.room > 0:
            self.pieces.append((when, data[: self.room]))
            self.room -= len(data)

    def drop(self) -> None:
        """Mark what has come so far as early."""
        self.early = len(self.pieces)

    def end(self) -> None:
        """Mark the end of the exchange: what comes now was awaited no more."""
        self.ended = len(self.pieces)


@dataclass(slots=True)
class Record:
    """One exchange. Times are monotonic seconds: request begun and ended, exchange done; `gap` is the silence before.

    `reply` is what was understood, `note` the reason where it went wrong.
    """

    codec: Codec
    request: Request
    frame: bytes
    gap: float
    begun: float
    sent: float
    done: float
    heard: Hearing
    verdict: Verdict
    reply: Reply | None = None
    note: str = ""


@dataclass(slots=True)
class Unasked:
    """Bytes that came between two exchanges; `before` is the request that they may be a late answer to."""

    when: float
    data: bytes
    before: tuple[Codec, Request] | None = None


Told = Record | Unasked
Tap = Callable[[Told], None]
"""Is told of everything on one line; must return at once and never fail."""


def cost(told: Told) -> tuple[int, int]:
    """Return how many frames and bytes something told takes, as far as that is known without looking closer."""
    if isinstance(told, Unasked):
        return 1, len(told.data)
    return (2 if told.heard.pieces else 1), len(told.frame) + LONGEST - max(0, told.heard.room)
