"""Takes an exchange apart into its frames: who sent each, when, how long after the one before, and what it was."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from gateway.errors import Refused
from gateway.protocol.codec import Codec, Decoder
from gateway.protocol.pdu import Request
from gateway.trace.meaning import Meaning
from gateway.trace.record import Piece, Record, Told, Unasked, Verdict

WELL = (Verdict.ANSWERED, Verdict.REFUSED)
MOST_STRAY = 4  # answers that nobody waited for which are looked for in one place; what is behind them is noise


class Way(Enum):
    """Who sent a frame."""

    REQUEST = "->"  # the gateway
    ANSWER = "<-"  # a drive, or whatever else talks on the line


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame. Times are UTC seconds since 1970; of an answer `begin` is when its first piece was there.

    `gap` is the silence before a request, `after` the time from the end of the request to the end of an answer, both
    in seconds. `verdict` of a request is that of its exchange.
    """

    line: str
    way: Way
    begin: float
    end: float
    data: bytes
    protocol: str
    verdict: Verdict
    meaning: str = ""
    note: str = ""
    gap: float | None = None
    after: float | None = None

    @property
    def is_well_formed(self) -> bool:
        """Say whether it is a frame of its protocol as far as is known, and no damaged one."""
        return self.way is Way.REQUEST or self.verdict in (*WELL, Verdict.LATE, Verdict.EARLY, Verdict.ECHO)

    def as_table(self) -> dict[str, Any]:
        """Return it as JSON has it; `of_table` is the way back."""
        return {
            "line": self.line,
            "way": self.way.value,
            "begin": self.begin,
            "end": self.end,
            "data": self.data.hex(),
            "protocol": self.protocol,
            "verdict": self.verdict.value,
            "meaning": self.meaning,
            "note": self.note,
            "gap": self.gap,
            "after": self.after,
        }

    @classmethod
    def of_table(cls, table: dict[str, Any]) -> Frame:
        """Return the frame that a table stands for; ValueError, KeyError or TypeError where it stands for none."""
        way, verdict = Way(table["way"]), Verdict(table["verdict"])
        return cls(**table | {"way": way, "verdict": verdict, "data": bytes.fromhex(table["data"])})


@dataclass(frozen=True, slots=True)
class Cut:
    """Bytes with an answer in them: what is in front of it, the answer, and what is behind."""

    front: bytes
    answer: bytes
    behind: bytes


def cut(codec: Codec, request: Request, data: bytes) -> Cut | None:
    """Find the answer to a request in what was heard, as the exchange did; None where there is none."""
    decoder = codec.decoder(request)
    for piece in (data, b""):  # nothing at last: the line is silent
        decoder.feed(piece)
        if _is_whole(decoder):
            places = _places(data, decoder.received)
            return next((place for place in places if _is_alone(codec, request, place.answer)), None)
    return None


def _is_alone(codec: Codec, request: Request, data: bytes) -> bool:
    """Say whether bytes are an answer and nothing else."""
    decoder = codec.decoder(request)
    decoder.feed(data)
    if not _is_whole(decoder):
        decoder.feed(b"")
        if not _is_whole(decoder):
            return False
    return not decoder.received


def _is_whole(decoder: Decoder) -> bool:
    try:
        return decoder.next_reply() is not None
    except Refused:
        return True


def _places(data: bytes, left: bytes) -> Iterator[Cut]:
    """Yield where an answer may have been taken out of `data`, so that `left` remained: nowhere if too much came."""
    size = len(data) - len(left)
    for start in range(len(left) + 1):
        if data[:start] + data[start + size :] == left:
            yield Cut(data[:start], data[start : start + size], data[start + size :])


def frames(line: str, told: Told, meaning: Meaning, offset: float) -> Iterator[Frame]:
    """Yield the frames of something told, in the order of time; `offset` makes monotonic seconds UTC."""
    if isinstance(told, Unasked):
        yield from _unasked(line, told, offset)
        return
    protocol, end = told.codec.name, told.sent + offset
    says = meaning.of_request(told.request)
    yield Frame(
        line, Way.REQUEST, told.begun + offset, end, told.frame, protocol, told.verdict, says, told.note, told.gap
    )
    for begin, done, data, verdict in _heard(told):
        is_answer = verdict in WELL
        yield Frame(
            line, Way.ANSWER, begin + offset, done + offset, data, protocol, verdict,
            meaning.of_reply(told.request, told.reply) if is_answer and told.reply is not None else "",
            told.note if is_answer else "",
            after=done - told.sent,
        )  # fmt: skip


def _unasked(line: str, told: Unasked, offset: float) -> Iterator[Frame]:
    """Yield what came between two exchanges: late answers to the one before, and noise."""
    when, protocol = told.when + offset, "" if told.before is None else told.before[0].name
    parts: Iterable[Part] = [(told.data, Verdict.NOISE)]
    if told.before is not None:
        parts = _strays(*told.before, told.data, Verdict.LATE)
    for data, verdict in parts:
        yield Frame(line, Way.ANSWER, when, when, data, protocol, verdict)


Part = tuple[bytes, Verdict]
Heard = tuple[float, float, bytes, Verdict]


def _heard(told: Record) -> Iterator[Heard]:
    """Yield what was heard during an exchange: begin, end (monotonic seconds), bytes and what they were."""
    hearing = told.heard
    ended = len(hearing.pieces) if hearing.ended is None else hearing.ended
    yield from _early(hearing.pieces[: hearing.early], told)
    yield from _awaited(hearing.pieces[hearing.early : ended], told)
    yield from _afterwards(hearing.pieces[ended:], told)


def _early(pieces: Sequence[Piece], told: Record) -> Iterator[Heard]:
    """Yield the echo and the answers that came sooner than the wire allows; a write's echo and answer look alike."""
    data, echo = b"".join(data for _, data in pieces), told.frame
    has_echo = data.startswith(echo)
    if has_echo:
        yield from _timed(pieces, [(echo, Verdict.ECHO)])
    start = len(echo) if has_echo else 0
    yield from _timed(pieces, _strays(told.codec, told.request, data[start:], Verdict.EARLY, echo), start)


def _awaited(pieces: Sequence[Piece], told: Record) -> Iterator[Heard]:
    """Yield the answer, and what stands around it; without an answer, what came instead."""
    if not pieces:
        return
    begin, end, data = _joined(pieces)
    found = cut(told.codec, told.request, data) if told.verdict in WELL else None
    if found is None:
        is_echo = data == told.frame and told.verdict not in WELL
        yield begin, end, data, Verdict.ECHO if is_echo else _instead(told)
        return
    if found.front:
        first = _begin_of(pieces, len(found.front))
        yield begin, first, found.front, Verdict.ECHO if found.front == told.frame else Verdict.NOISE
        begin = first
    yield begin, end, found.answer, told.verdict
    if found.behind:
        yield end, end, found.behind, Verdict.NOISE


def _instead(told: Record) -> Verdict:
    return Verdict.BAD_REPLY if told.verdict is Verdict.BAD_REPLY else Verdict.NOISE


def _afterwards(pieces: Sequence[Piece], told: Record) -> Iterator[Heard]:
    data = b"".join(data for _, data in pieces)
    yield from _timed(pieces, _strays(told.codec, told.request, data, Verdict.LATE, told.frame))


def _strays(codec: Codec, request: Request, data: bytes, verdict: Verdict, echo: bytes = b"") -> Iterator[Part]:
    """Take bytes apart that nobody waited for: answers, with that verdict; an echo among the rest; noise."""
    for _ in range(MOST_STRAY):
        if (found := cut(codec, request, data)) is None:
            break
        yield from _no_answer(found.front, echo)
        yield found.answer, verdict
        data = found.behind
    yield from _no_answer(data, echo)


def _no_answer(data: bytes, echo: bytes) -> Iterator[Part]:
    """Yield an echo and the noise round it."""
    front, found, behind = data.partition(echo) if echo else (data, b"", b"")
    parts = ((front, Verdict.NOISE), (found, Verdict.ECHO), (behind, Verdict.NOISE))
    yield from (part for part in parts if part[0])


def _timed(pieces: Sequence[Piece], parts: Iterable[Part], start: int = 0) -> Iterator[Heard]:
    """Yield parts of pieces, that follow one another from the byte at `start`, with their times."""
    for data, verdict in parts:
        end = start + len(data)
        yield _begin_of(pieces, start), _begin_of(pieces, end - 1), data, verdict
        start = end


def _joined(pieces: Sequence[Piece]) -> tuple[float, float, bytes]:
    return pieces[0][0], pieces[-1][0], b"".join(data for _, data in pieces)


def _begin_of(pieces: Sequence[Piece], offset: int) -> float:
    """Return when the piece with the byte at that offset was there."""
    for when, data in pieces:
        if offset < len(data):
            return when
        offset -= len(data)
    return pieces[-1][0]
