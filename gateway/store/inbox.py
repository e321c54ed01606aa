"""What the event loop hands to the store's thread: counts and short texts for now, the audit in turn."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

from gateway.control.ledger import Counted, Entry
from gateway.control.wear import Key, Wear

WAITING = 10_000  # rows of the audit that may wait for the disk
TOGETHER = 1000  # rows that are written at once


@dataclass(frozen=True, slots=True)
class Write:
    """A count that is to be written, its times in UTC; `then` is told when that is done, or why it is not."""

    key: Key
    wear: Wear
    then: Counted | None = None


class Inbox:
    """What the event loop gives the thread. The loop never waits for it: nothing slow is done under its lock."""

    def __init__(self) -> None:
        self._news = threading.Condition()
        self._writes: list[Write] = []
        self._kept: dict[str, str] = {}
        self._entries: deque[Entry] = deque()
        self._is_ending = False
        self.dropped = 0
        self._untold = 0  # rows dropped since the audit was last told
        self._dropped_at = 0.0

    def write(self, write: Write) -> None:
        """Put a count."""
        with self._news:
            self._writes.append(write)
            self._news.notify()

    def keep(self, key: str, text: str) -> None:
        """Put a short text, in the place of an older one."""
        with self._news:
            self._kept[key] = text
            self._news.notify()

    def kept(self) -> dict[str, str]:
        """Return the texts that came since the last time."""
        with self._news:
            kept, self._kept = self._kept, {}
            return kept

    def append(self, entry: Entry) -> None:
        """Put a row of the audit, or drop it where too many wait."""
        with self._news:
            if len(self._entries) >= WAITING:
                self.dropped += 1
                self._untold += 1
                self._dropped_at = entry.time
                return
            self._entries.append(entry)
            self._news.notify()

    def end(self) -> None:
        """Ask the thread to end."""
        with self._news:
            self._is_ending = True
            self._news.notify()

    def take(self, gather: float, wait: float | None) -> tuple[list[Write], bool]:
        """Wait for counts, or the end: `wait` seconds, or else `gather` from the first row of the audit on."""
        with self._news:
            if wait is None:
                self._news.wait_for(lambda: self._is_urgent or self._entries)
            self._news.wait_for(lambda: self._is_urgent, gather if wait is None else wait)
            writes, self._writes = self._writes, []
            return writes, self._is_ending

    @property
    def _is_urgent(self) -> bool:
        return bool(self._writes or self._kept or self._is_ending)

    def first(self) -> list[Entry]:
        """Return the rows that have waited longest; they are kept until `written`."""
        with self._news:
            if self._untold and len(self._entries) < WAITING:
                text = f"{self._untold} rows were dropped: the store did not take them"
                self._entries.append(Entry.of_event("", "audit_dropped", text, self._dropped_at))
                self._untold = 0
            return [self._entries[place] for place in range(min(TOGETHER, len(self._entries)))]

    @property
    def waiting(self) -> int:
        """Return how many rows wait."""
        return len(self._entries)

    def written(self, count: int) -> None:
        """Let go of rows that are in the file."""
        with self._news:
            for _ in range(count):
                self._entries.popleft()
