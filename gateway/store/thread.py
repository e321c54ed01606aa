"""The thread that alone waits for the disk: it opens the store's file, writes counts at once, the audit in turn."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gateway.control.wear import Key, Wear
from gateway.store.errors import StoreAway, StoreDamaged
from gateway.store.inbox import Inbox, Write
from gateway.store.schema import Saved
from gateway.store.state_file import StateFile, begin_anew

log = logging.getLogger("gateway.store")


@dataclass(frozen=True, slots=True)
class Pace:
    """How long rows of the audit are gathered, and how long a file that is away is left alone, in seconds."""

    gather: float = 1.0
    retry: float = 1.0
    retry_at_most: float = 60.0


class Listener(Protocol):
    """Who is told, in the event loop, how the file fares."""

    def opened(self, saved: Saved) -> None:
        """Take what the file holds."""

    def away(self, problem: str) -> None:
        """Take why the file cannot be used."""

    def ended(self) -> None:
        """Take that the thread has ended."""


class StoreThread:
    """Owns the file. `post` has something called in the event loop. Only `inbox` is touched from outside."""

    def __init__(
        self, path: Path, audit_rows: int, pace: Pace, listener: Listener, post: Callable[..., None]
    ) -> None:
        self.inbox = Inbox()
        self._path = path
        self._audit_rows = audit_rows
        self._pace = pace
        self._listener = listener
        self._post = post
        self._file: StateFile | None = None
        self._problem = ""
        self._is_damaged = False
        self._is_unchecked = True
        self._begins_at: int | None = None  # None: the counts are not known
        self._retry_at = float("-inf")
        self._pause = pace.retry
        self._owed: dict[Key, Wear] = {}  # counts that are not in the file yet
        self._owed_texts: dict[str, str] = {}  # and short texts

    def start(self) -> None:
        """Begin."""
        threading.Thread(target=self._run, name="store", daemon=True).start()

    def _run(self) -> None:
        is_ending = False
        while not is_ending:
            writes, is_ending = self.inbox.take(self._pace.gather, self._wait())
            self._turn(writes)
        if self._owed or self.inbox.waiting:
            text = "%s: %d counts and %d rows of the audit could not be written"
            log.error(text, self._path, len(self._owed), self.inbox.waiting)
        self._close()
        self._post(self._listener.ended)

    def _wait(self) -> float | None:
        """Return how long to wait for counts before the file is tried again; None while it is open."""
        return None if self._file is not None else max(0.0, self._retry_at - time.monotonic())

    def _turn(self, writes: list[Write]) -> None:
        """Write what has come, and say what became of it."""
        self._owed.update((write.key, write.wear) for write in writes)
        self._owed_texts.update(self.inbox.kept())
        is_due = self._file is not None or time.monotonic() >= self._retry_at
        problem = self._tried(self._write_counts) if is_due else self._problem
        for write in writes:
            if write.then is not None:
                self._post(write.then, problem)
        if not problem:
            self._tried(self._write_audit)

    def _tried(self, work: Callable[[], None]) -> str:
        """Do it; return "", or why the file is now away."""
        try:
            work()
        except StoreAway as error:
            self._lose(error)
        except Exception as error:  # whatever it is, it must not end the thread unseen
            log.exception("%s: the store has failed", self._path)
            self._lose(StoreAway(f"{self._path}: {error!r}"))
        else:
            return ""
        return self._problem

    def _write_counts(self) -> None:
        if self._file is None:
            self._file = self._opened()
        if self._owed:
            self._file.write(self._owed)
            self._owed.clear()
        if self._owed_texts:
            self._file.keep(self._owed_texts)
            self._owed_texts.clear()

    def _write_audit(self) -> None:
        while self._file is not None and (entries := self.inbox.first()):
            self._file.append(entries)
            self.inbox.written(len(entries))

    def _opened(self) -> StateFile:
        """Open the file, or a new one in the place of one that is damaged."""
        if self._is_damaged:
            told = begin_anew(self._path, time.time(), self._begins_at)
            log.error("%s; a new file is begun", told)
            self._is_damaged = False
        file = StateFile.open(self._path, self._audit_rows, time.time(), is_checked=self._is_unchecked)
        try:
            saved = file.read()
        except BaseException:
            file.close()
            raise
        self._is_unchecked = False
        self._begins_at = None if saved.lost else saved.begins_at
        self._pause = self._pace.retry
        self._post(self._listener.opened, saved)
        return file

    def _lose(self, error: StoreAway) -> None:
        """Let the file go, and try it again after a while."""
        self._close()
        self._problem = str(error)
        self._is_damaged |= isinstance(error, StoreDamaged)
        self._retry_at = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, self._pace.retry_at_most)
        self._post(self._listener.away, self._problem)

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
