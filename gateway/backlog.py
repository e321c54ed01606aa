"""What a broker missed while it was away: readings on their way into a store and out of it again. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol


def milliseconds(wall: float) -> int:
    """Return a time in whole milliseconds of UTC, cut off from exact microseconds: as times are spelt in payloads.

    What comes twice, live and as history, has the same time then.
    """
    part, whole = math.modf(wall)
    return int(whole) * 1000 + round(part * 1_000_000) // 1000


class Kind(Enum):
    """What a reading is: values of a drive, or something that happened to it. Commands have no kind: none is kept."""

    VALUES = "values"
    EVENT = "event"


@dataclass(frozen=True, slots=True)
class HistoricalReading:
    """What one answer of a drive brought, or what happened to it.

    `ms` is when that was, in milliseconds of UTC since 1970; `body` is JSON text.
    """

    drive: str
    kind: Kind
    ms: int
    body: str


@dataclass(frozen=True, slots=True)
class Kept:
    """A reading in the store; `number` says which, is never given to another, and grows."""

    number: int
    reading: HistoricalReading


class Loss(Enum):
    """Why a reading was dropped before it could be sent."""

    SIZE = "size"  # the store was full, and it was the oldest
    AGE = "age"  # it was older than `max_age`
    DISK = "disk"  # the store could not be written to
    DAMAGED = "damaged"  # what stood in the file was not what had been written
    UNKNOWN = "unknown"  # no drive or value of that name is configured any more


@dataclass(slots=True)
class BacklogStats:
    """What is counted of a backlog: `stored` came into the file for good, `waiting` are those not sent yet."""

    stored: int = 0
    sent: int = 0
    waiting: int = 0
    dropped: Counter[Loss] = field(default_factory=Counter)
    has_problem: bool = False


class Backlog(Protocol):
    """Keeps readings for one broker. Nothing here waits for a disk."""

    @property
    def stats(self) -> BacklogStats:
        """Return what was counted."""
        ...

    @property
    def origin(self) -> str:
        """Return what tells the numbers of this store from those of any other; "" until that is known."""
        ...

    def put(self, reading: HistoricalReading) -> None:
        """Keep a reading."""
        ...

    def ask(self, after: int, count: int, without: frozenset[str], then: Callable[[Sequence[Kept]], None]) -> None:
        """Have `then` called with the oldest readings behind a number, but for those of some drives."""
        ...

    def let_go(self, numbers: Sequence[int]) -> None:
        """Keep these no longer: the broker has them, or nothing can be done with them."""
        ...
