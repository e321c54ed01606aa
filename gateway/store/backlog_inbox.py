"""What the event loop hands to a backlog's thread: readings to be written, numbers to be let go, one question."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gateway.backlog import HistoricalReading, Kept
from gateway.store.backlog_schema import size_of

WAITING = 8 * 1024 * 1024  # bytes that may wait for the disk
TOGETHER = 500  # readings that are written at once
FULL = 4 * TOGETHER  # readings that wait no longer for more to come


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked of the file; `then` is told the answer in the event loop."""

    after: int
    count: int
    without: frozenset[str]
    then: Callable[[Sequence[Kept]], None]


class BacklogInbox:
    """What the event loop gives the thread. The loop never waits for it: nothing slow is done under its lock."""

    def __init__(self) -> None:
        self._news = threading.Condition()
        self._readings: deque[tuple[HistoricalReading, int]] = deque()
        self._size = 0
        self._gone: list[int] = []
        self._question: Question | None = None
        self._is_ending = False

    def put(self, reading: HistoricalReading) -> int:
        """Put a reading; return how many of the oldest had to give way."""
        size, dropped = size_of(reading), 0
        with self._news:
            self._readings.append((reading, size))
            self._size += size
            while self._size > WAITING:
                self._size -= self._readings.popleft()[1]
                dropped += 1
            self._news.notify()
        return dropped

    def let_go(self, numbers: Sequence[int]) -> None:
        """Put what is kept no longer."""
        with self._news:
            self._gone += numbers
            self._news.notify()

    def ask(self, question: Question) -> None:
        """Put a question; one that was not answered yet is not answered any more."""
        with self._news:
            self._question = question
            self._news.notify()

    def end(self) -> None:
        """Ask the thread to end."""
        with self._news:
            self._is_ending = True
            self._news.notify()

    def wait(self, limit: float, gather: float) -> bool:
        """Wait so long for anything to do, then for more to come; say whether it is to be the end."""
        with self._news:
            self._news.wait_for(lambda: self._readings or self._gone or self._is_urgent, limit)
            if self._readings or self._gone:
                self._news.wait_for(lambda: self._is_urgent or len(self._readings) >= FULL, gather)
            return self._is_ending

    def wait_in_vain(self, limit: float) -> bool:
        """Wait so long while nothing can be written; say whether it is to be the end."""
        with self._news:
            self._news.wait_for(lambda: self._is_urgent, limit)
            return self._is_ending

    @property
    def _is_urgent(self) -> bool:
        return self._is_ending or self._question is not None

    def first(self) -> list[HistoricalReading]:
        """Return the readings that have waited longest, to be written together; they are kept until `written`."""
        with self._news:
            return [self._readings[place][0] for place in range(min(TOGETHER, len(self._readings)))]

    def written(self, readings: Sequence[HistoricalReading]) -> None:
        """Let go of readings that are in the file; some may have given way meanwhile."""
        with self._news:
            for reading in readings:
                if self._readings and self._readings[0][0] is reading:
                    self._size -= self._readings.popleft()[1]

    def gone(self) -> list[int]:
        """Return what is to be let go, and forget it."""
        with self._news:
            gone, self._gone = self._gone, []
            return gone

    def question(self) -> Question | None:
        """Return the question, and forget it."""
        with self._news:
            question, self._question = self._question, None
            return question

    @property
    def waiting(self) -> int:
        """Return how many readings wait."""
        return len(self._readings)
