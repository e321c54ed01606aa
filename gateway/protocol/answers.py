"""Finds the one answer to a request in the bytes that a line brings; a protocol says what its answers look like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.errors import Refused
from gateway.protocol.codec import Answering
from gateway.protocol.pdu import Reply

LIMIT = 512  # bytes that a decoder holds at the most: two of the longest frames that MODBUS-RTU allows
KEPT = 256  # bytes that it keeps of more: no answer is longer

Said = Reply | Refused


@dataclass(frozen=True, slots=True)
class Shape:
    """What one kind of answer looks like: how it begins, and how many bytes it has.

    `read` returns what a whole one says, None where a checksum or a field is wrong. Where lengths vary, `size` is
    the longest, and `measure` returns how many bytes a beginning asks for: 0 where it is no answer.
    """

    start: bytes
    size: int
    read: Callable[[bytes], Said | None]
    measure: Callable[[bytes], int] | None = None

    def size_of(self, beginning: bytes) -> int:
        """Return how many bytes an answer with this beginning needs as far as is known, 0 where it is none."""
        return self.size if self.measure is None else self.measure(beginning)


@dataclass(frozen=True, slots=True)
class Dialogue:
    """The frame of one request, and all that may come back for it; no shape begins as another does."""

    frame: bytes
    answering: Answering
    normal: tuple[Shape, ...] = ()
    refusals: tuple[Shape, ...] = ()

    @property
    def size(self) -> int:
        """Return the characters of the normal answer, 0 where there is none."""
        return max((shape.size for shape in self.normal), default=0)

    @property
    def least(self) -> int:
        """Return the characters of the shortest answer, a refusal included, 0 where there is none."""
        return min((shape.size for shape in self.normal + self.refusals), default=0)


@dataclass(frozen=True, slots=True)
class _Held:
    """An answer that may be an echo and what follows it: believed if the line falls silent right behind it."""

    said: Said
    start: int
    end: int


class AnswerDecoder:
    """Waits for the answer to one request, from left to right: how the bytes were cut makes no difference.

    Bytes in front (glitches, answers of others, the adapter's echo of the request) are passed over. What looks
    like an answer is waited for until it is whole, so that nothing inside it is taken for one; only when the line
    is silent (an empty piece was fed) are the bytes behind such a beginning looked at. An answer that has the same
    bytes as its request cannot be told from an echo and counts as an answer: wire time and reading back tell.
    """

    def __init__(self, dialogue: Dialogue) -> None:
        self._echo = dialogue.frame
        self._shapes = dialogue.normal + dialogue.refusals
        self._buffer = bytearray()
        self._at = 0  # bytes before it belong to no answer
        self._held: _Held | None = None
        self._is_silent = False

    def feed(self, data: bytes) -> None:
        """Take bytes as they come; none say that the line is silent."""
        self._is_silent = not data
        self._buffer += data
        if len(self._buffer) > LIMIT:
            surplus = len(self._buffer) - KEPT
            del self._buffer[:surplus]
            self._at = max(0, self._at - surplus)
            self._held = None

    @property
    def received(self) -> bytes:
        """Return what was fed and is not part of a reply."""
        return bytes(self._buffer)

    def next_reply(self) -> Reply | None:
        """Return the reply, None while it is not whole; raise Refused when the drive says no."""
        while left := self._left():
            size, said = self._answer(left)
            if said is not None:
                answer = _Held(said, self._at, self._at + size)
                if not self._is_doubtful(left, size):
                    return self._take(answer)
                self._held = answer
            is_unfinished = size > len(left) or (len(left) < len(self._echo) and self._echo.startswith(left))
            if is_unfinished and not self._is_silent:
                return None
            self._at += len(self._echo) if left.startswith(self._echo) else 1
        if self._is_silent and self._held is not None and self._held.end == len(self._buffer):
            return self._take(self._held)
        return None

    def _left(self) -> bytes:
        """Return the bytes from the next one that can begin an answer or an echo; none where there is none."""
        start = self._buffer.find(self._echo[:1], self._at) if self._shapes else -1
        self._at = start if start >= 0 else len(self._buffer)
        return bytes(self._buffer[self._at :])

    def _answer(self, left: bytes) -> tuple[int, Said | None]:
        """Return how many bytes the answer at the front has and what it says; 0 where none begins here."""
        for shape in self._shapes:
            if left.startswith(shape.start):
                size = shape.size_of(left)
                if not 0 < size <= len(left):
                    return size, None
                said = shape.read(left[:size])
                return (0, None) if said is None else (size, said)
            if shape.start.startswith(left):
                return len(shape.start), None
        return 0, None

    def _is_doubtful(self, left: bytes, size: int) -> bool:
        """Say whether an answer at the front may be an echo: a part of it, or it and the beginning of an answer."""
        echo = self._echo
        if size <= len(echo):
            return size < len(echo) and echo.startswith(left[: len(echo)])
        if not left.startswith(echo):
            return False
        behind = left[len(echo) : size]
        return any(
            shape.start.startswith(behind[cut:]) or behind.startswith(shape.start, cut)
            for cut in range(len(behind))
            for shape in self._shapes
        )

    def _take(self, answer: _Held) -> Reply:
        """Remove an answer from the buffer and return its reply, or raise its refusal."""
        del self._buffer[answer.start : answer.end]
        self._at = answer.start
        self._held = None
        if isinstance(answer.said, Refused):
            raise answer.said
        return answer.said
