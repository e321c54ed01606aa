"""Remembers what was sent until the broker is known to have it: none of it is lost with the connection. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")

MOST = 20_000  # readings; some seconds of the fastest lines, while a broker has fallen silent


@dataclass(frozen=True, slots=True)
class _Entry(Generic[T]):
    """One reading; `mark` is the number of its last message, None where it found no room among them."""

    what: T
    mark: int | None
    is_there: Callable[[], bool] | None


class Unconfirmed(Generic[T]):
    """Readings in their order, from when they were sent until they are known to be there, or have to be kept."""

    def __init__(self, most: int = MOST) -> None:
        self._entries: deque[_Entry[T]] = deque()
        self._most = most

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, what: T, mark: int | None, is_there: Callable[[], bool] | None = None) -> list[T]:
        """Take what was just sent, and return what has to be kept since there are too many.

        `mark` is how many messages were handed over so far; None: it was not among them. `is_there` says of a single
        message whether the broker has it.
        """
        self._entries.append(_Entry(what, mark, is_there))
        return [self._entries.popleft().what] if len(self._entries) > self._most else []

    def settle(self, there: int) -> list[T]:
        """Forget what the broker has, the first `there` messages; return what was never sent and has to be kept."""
        kept = []
        while self._entries:
            first = self._entries[0]
            if first.mark is None:
                kept.append(first.what)
            elif not (first.is_there() if first.is_there is not None else first.mark <= there):
                break
            self._entries.popleft()
        return kept

    def give_up(self) -> list[T]:
        """Return all that the broker is not known to have, in order: the connection is lost."""
        left = [entry.what for entry in self._entries]
        self._entries.clear()
        return left
