"""The thread that alone waits for a backlog's disk: it writes in batches, answers questions, and keeps the bounds."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gateway.backlog import Kept, Loss
from gateway.store.backlog_file import BacklogFile, begin_anew
from gateway.store.backlog_inbox import BacklogInbox
from gateway.store.backlog_schema import Limits
from gateway.store.errors import StoreAway, StoreDamaged

log = logging.getLogger("gateway.store")


@dataclass(frozen=True, slots=True)
class BacklogPace:
    """How long readings are gathered, a file that is away is left alone, and between looks at their age; seconds."""

    gather: float = 0.5
    retry: float = 1.0
    retry_at_most: float = 60.0
    look: float = 60.0


class BacklogListener(Protocol):
    """Who is told, in the event loop, how the file fares."""

    def stored(self, count: int, waiting: int) -> None:
        """Take that so many readings more are in the file for good, and how many wait there in all."""

    def dropped(self, loss: Loss, count: int) -> None:
        """Take that readings were dropped."""

    def opened(self, origin: str, waiting: int) -> None:
        """Take that the file can be used."""

    def away(self, problem: str) -> None:
        """Take why it cannot be used."""

    def ended(self) -> None:
        """Take that the thread has ended."""


class BacklogThread:
    """Owns the file, which is made when there is something to write.

    `post` has something called in the event loop.
    """

    def __init__(
        self, path: Path, limits: Limits, pace: BacklogPace, listener: BacklogListener, post: Callable[..., None]
    ) -> None:
        self.inbox = BacklogInbox()
        self._path = path
        self._limits = limits
        self._pace = pace
        self._listener = listener
        self._post = post
        self._file: BacklogFile | None = None
        self._is_damaged = False
        self._retry_at = float("-inf")
        self._pause = pace.retry
        self._look_at = float("-inf")
        self._has_failed = False
        self._is_shrinking = False
        self._owed: list[int] = []  # numbers that the file still has though they are to be let go

    def start(self) -> None:
        """Begin."""
        threading.Thread(target=self._run, name="backlog", daemon=True).start()

    def _run(self) -> None:
        is_ending = False
        if self._path.exists():
            self._tried(self._open)
        while not is_ending:
            is_ending = self._wait()
            self._turn()
        if self.inbox.waiting:
            log.error("%s: %d readings could not be written", self._path, self.inbox.waiting)
            self._post(self._listener.dropped, Loss.DISK, self.inbox.waiting)
        self._close()
        self._post(self._listener.ended)

    def _wait(self) -> bool:
        """Wait for something to do, or until the file is to be tried again; say whether it is to be the end."""
        if self._file is None and self._has_failed:
            return self.inbox.wait_in_vain(max(0.0, self._retry_at - time.monotonic()))
        return self.inbox.wait(self._pace.gather if self._is_shrinking else self._pace.look, self._pace.gather)

    def _turn(self) -> None:
        """Write and let go, then answer: what is asked for is then all there."""
        self._owed += self.inbox.gone()
        if self._file is not None or time.monotonic() >= self._retry_at:
            self._tried(self._write)
        self._answer()

    def _tried(self, work: Callable[[], None]) -> None:
        try:
            work()
        except StoreAway as error:
            self._lose(error)
        except Exception as error:  # whatever it is, it must not end the thread unseen
            log.exception("%s: the backlog has failed", self._path)
            self._lose(StoreAway(f"{self._path}: {error!r}"))

    def _write(self) -> None:
        if self._file is None and not self.inbox.waiting and not self._has_failed:
            return  # there is no file, and no need of one
        file = self._opened()
        while readings := self.inbox.first():
            done = file.append(readings)
            self.inbox.written(readings)
            self._post(self._listener.stored, done.stored, file.rows)
            if done.dropped:
                self._post(self._listener.dropped, Loss.SIZE, done.dropped)
        if self._owed:
            file.let_go(self._owed)
            self._owed.clear()
            self._post(self._listener.stored, 0, file.rows)
        self._look(file)
        self._is_shrinking = file.shrink()

    def _look(self, file: BacklogFile) -> None:
        """Drop what is too old, now and then."""
        if time.monotonic() < self._look_at:
            return
        self._look_at = time.monotonic() + self._pace.look
        if dropped := file.drop_older(int((time.time() - self._limits.max_age) * 1000)):
            self._post(self._listener.dropped, Loss.AGE, dropped)
            self._post(self._listener.stored, 0, file.rows)

    def _answer(self) -> None:
        """Answer what was asked; nothing where the file cannot be read."""
        question = self.inbox.question()
        if question is None:
            return
        found: list[Kept] = []
        try:
            if self._file is not None:
                found, damaged = self._file.take(question.after, question.count, question.without)
                self._owed += damaged
                if damaged:
                    self._post(self._listener.dropped, Loss.DAMAGED, len(damaged))
        except StoreAway as error:
            self._lose(error)
        self._post(question.then, found)

    def _opened(self) -> BacklogFile:
        if self._file is None:
            self._open()
        assert self._file is not None  # noqa: S101 - it was opened, or there was an error
        return self._file

    def _open(self) -> None:
        """Open the file, or a new one in the place of one that is damaged."""
        if self._is_damaged:
            log.error("%s", begin_anew(self._path, time.time()))
            self._is_damaged = False
        self._file = BacklogFile.open(self._path, self._limits)
        self._pause, self._has_failed = self._pace.retry, False
        self._look(self._file)
        self._post(self._listener.opened, self._file.origin, self._file.rows)

    def _lose(self, error: StoreAway) -> None:
        """Let the file go, and try it again after a while; one that is damaged is replaced at the next turn."""
        self._close()
        self._has_failed = True
        self._is_damaged |= isinstance(error, StoreDamaged)
        self._retry_at = time.monotonic() + self._pause
        self._pause = min(2 * self._pause, self._pace.retry_at_most)
        self._post(self._listener.away, str(error))

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
