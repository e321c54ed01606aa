"""What went over a simulated line, frame by frame, for whoever asks afterwards or listens."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import islice

KEPT = 10_000  # latest entries: some minutes of a busy line


class Way(Enum):
    """Whose bytes an entry has."""

    REQUEST = "request"  # the master's, as it sent them
    ANSWER = "answer"  # a drive's, as it gave them, before any fault
    HEARD = "heard"  # what reached the master
    EVENT = "event"  # nobody's: something was done to the line, `note` says what


@dataclass(frozen=True, slots=True)
class Entry:
    """One frame. Times are seconds on the line's clock; `note` says what is unusual, "" for nothing."""

    way: Way
    begin: float
    end: float
    data: bytes
    drive: int | None = None
    note: str = ""

    @property
    def is_told(self) -> bool:
        """Say whether it is news: an answer that is heard anyway is not."""
        return self.way is not Way.ANSWER or bool(self.note)

    @property
    def text(self) -> str | None:
        """Return an ASCII frame as text, without its CR; None for anything else."""
        body = self.data.removesuffix(b"\r")
        return body.decode() if body.isascii() and body.decode().isprintable() and body.startswith(b"(") else None


class Journal:
    """Keeps the latest entries, and tells listeners of each as it is made."""

    def __init__(self) -> None:
        self._entries: deque[Entry] = deque(maxlen=KEPT)
        self._listeners: list[Callable[[Entry], None]] = []

    def add(self, entry: Entry) -> None:
        """Keep an entry; the oldest one goes where there are too many."""
        self._entries.append(entry)
        for listener in self._listeners:
            listener(entry)

    def listen(self, listener: Callable[[Entry], None]) -> None:
        """Call `listener` with each entry from now on."""
        self._listeners.append(listener)

    def ignore(self, listener: Callable[[Entry], None]) -> None:
        """Call `listener` no more."""
        self._listeners.remove(listener)

    def last(self, count: int) -> Sequence[Entry]:
        """Return the latest entries, the oldest first."""
        return tuple(islice(self._entries, max(0, len(self._entries) - count), None))


ARROWS = {Way.REQUEST: "->", Way.ANSWER: "x-", Way.HEARD: "<-", Way.EVENT: "**"}


def told(entry: Entry, opened: float) -> str:
    """Write an entry as a line of text; its time is in seconds since the line was opened."""
    drive = "" if entry.drive is None else f" {entry.drive}:"
    data = entry.text or entry.data.hex(" ").upper()
    note = f" [{entry.note}]" if entry.note and entry.data else entry.note
    return f"{entry.begin - opened:10.4f} {ARROWS[entry.way]}{drive} {data}{note}".rstrip()
