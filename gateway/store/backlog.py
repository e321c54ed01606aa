"""The backlog of one broker as the event loop sees it: what it missed while it was away, in a file, bounded.

It is outside the control path: where its disk is full, read-only or hangs, readings are dropped, which is counted and
warned of, and everything else goes on. Setpoints and commands never come here.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from gateway.backlog import BacklogStats, HistoricalReading, Kept, Loss
from gateway.config import BrokerSection, MqttSection
from gateway.site import Site
from gateway.store.backlog_inbox import Question
from gateway.store.backlog_schema import Limits
from gateway.store.backlog_thread import BacklogPace, BacklogThread
from gateway.store.store import store_path

log = logging.getLogger("gateway.store")

MIB, HOUR = 1024**2, 3600.0  # bytes, seconds
CLOSE_WITHIN = 3.0  # seconds for what waits to be written when the gateway ends
PACE = BacklogPace()
SAID_AGAIN = 10_000  # readings dropped since the last warning


def backlog_name(gateway: str, section: BrokerSection) -> str:
    """Return what tells the file of one broker of one gateway from others: "hall-3-mqtt-cloud"."""
    broker = section.name if isinstance(section, MqttSection) else None
    return "-".join(filter(None, (gateway, section.table, broker)))


def backlog_path(site: Site, section: BrokerSection, environment: Mapping[str, str] = os.environ) -> Path:
    """Return where the file is: as configured, else with the store, by the names of gateway and broker."""
    if section.store.path is not None:
        return site.folder / section.store.path
    name = f"backlog-{backlog_name(site.config.gateway.name, section)}.sqlite"
    return store_path(site.config.store, site.folder, environment).parent / name


def summary(site: Site, section: BrokerSection, environment: Mapping[str, str] = os.environ) -> str:
    """Say in a line what is kept for a broker while it is away."""
    if not section.store.enabled:
        return "nothing is kept while the broker is away"
    path, size = backlog_path(site, section, environment), section.store.max_bytes / MIB
    return f"kept while the broker is away: {path}, at most {size:.4g} MiB and {section.store.max_age / HOUR:.4g} h"


class FiledBacklog:
    """A backlog in a file. All of it is for the event loop; nothing here waits for the disk."""

    def __init__(
        self, path: Path, limits: Limits, stats: BacklogStats | None = None, pace: BacklogPace = PACE
    ) -> None:
        self.path = path
        self.origin = ""
        self.stats = stats if stats is not None else BacklogStats()
        self._thread = BacklogThread(path, limits, pace, self, self._post)
        self._rows = 0  # in the file
        self._problem = ""
        self._untold = 0
        self._ended = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    @classmethod
    def of(cls, site: Site, section: BrokerSection, stats: BacklogStats) -> FiledBacklog:
        """Return the backlog of a broker as configured."""
        store = section.store
        return cls(backlog_path(site, section), Limits(store.max_bytes, store.max_age, is_synced=store.sync), stats)

    def start(self) -> None:
        """Begin; a file that is there is opened, and one that is not when there is something to keep."""
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    async def close(self) -> None:
        """Write what waits and let the file go; a disk that hangs is not waited for."""
        if self._loop is None:
            return
        self._thread.inbox.end()
        try:
            await asyncio.wait_for(self._ended.wait(), CLOSE_WITHIN)
        except TimeoutError:
            log.warning("%s: the disk does not answer; the last readings may be lost", self.path)

    # ---- what the adapters ask

    def put(self, reading: HistoricalReading) -> None:
        """Keep a reading; where too many wait for the disk the oldest give way."""
        if dropped := self._thread.inbox.put(reading):
            self.dropped(Loss.DISK, dropped)
        self._count()

    def ask(self, after: int, count: int, without: frozenset[str], then: Callable[[Sequence[Kept]], None]) -> None:
        """Have `then` called with the oldest readings behind a number, but for those of some drives."""
        self._thread.inbox.ask(Question(after, count, without, then))

    def let_go(self, numbers: Sequence[int]) -> None:
        """Keep these no longer."""
        self._thread.inbox.let_go(numbers)

    # ---- what the thread tells, in the event loop

    def _post(self, call: Callable[..., None], *arguments: object) -> None:
        """Have something called in the event loop; called by the thread, perhaps after the loop has ended."""
        assert self._loop is not None  # noqa: S101 - set before the thread is started
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(call, *arguments)

    def stored(self, count: int, waiting: int) -> None:
        """Take that so many readings more are in the file for good, and how many there are in all."""
        self.stats.stored += count
        self._rows = waiting
        self._count()

    def _count(self) -> None:
        self.stats.waiting = self._rows + self._thread.inbox.waiting

    def dropped(self, loss: Loss, count: int) -> None:
        """Count readings that were dropped, and warn of the first and then of many."""
        is_first = not self.stats.dropped[loss]
        self.stats.dropped[loss] += count
        self._untold += count
        if is_first or self._untold >= SAID_AGAIN:
            text = "%s: readings are dropped (%s), %d so far"
            log.warning(text, self.path, loss.value, self.stats.dropped[loss])
            self._untold = 0

    def opened(self, origin: str, waiting: int) -> None:
        """Take that the file can be used."""
        if self._problem:
            log.info("%s is open again", self.path)
        self._problem, self.stats.has_problem, self.origin = "", False, origin
        self.stored(0, waiting)

    def away(self, problem: str) -> None:
        """Take why the file cannot be used."""
        if problem != self._problem:
            log.warning("%s: what the broker misses is not stored, all else goes on", problem)
        self._problem, self.stats.has_problem = problem, True

    def ended(self) -> None:
        """Take that the thread has ended."""
        self._ended.set()
