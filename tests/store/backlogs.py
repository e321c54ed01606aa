"""Backlogs on files of a test, and readings to put into them."""

from __future__ import annotations

import asyncio
import shutil
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from gateway.backlog import HistoricalReading, Kept, Kind
from gateway.store.backlog import FiledBacklog
from gateway.store.backlog_schema import PAGE, Limits
from gateway.store.backlog_thread import BacklogPace
from gateway.store.place import beside

QUICK = BacklogPace(gather=0.001, retry=0.005, retry_at_most=0.01, look=0.05)
LIMITS = Limits(1024 * PAGE, 3600.0)
NOBODY_WITHOUT: frozenset[str] = frozenset()


def reading(number: int, drive: str = "pump", ms: int | None = None, body: str | None = None) -> HistoricalReading:
    """Return a reading that can be told from others by its body; read now, unless it says otherwise."""
    at = int(time.time() * 1000) if ms is None else ms
    return HistoricalReading(drive, Kind.VALUES, at, body or f'{{"v":{{"output_frequency":"{number}"}}}}')


@asynccontextmanager
async def running(path: Path, limits: Limits = LIMITS) -> AsyncIterator[FiledBacklog]:
    """Start a backlog, and close it afterwards."""
    backlog = FiledBacklog(path, limits, pace=QUICK)
    backlog.start()
    try:
        yield backlog
    finally:
        await backlog.close()


async def asked(
    backlog: FiledBacklog, after: int = 0, count: int = 100, without: frozenset[str] = NOBODY_WITHOUT
) -> list[Kept]:
    """Return what the backlog answers."""
    told: asyncio.Future[list[Kept]] = asyncio.get_running_loop().create_future()
    backlog.ask(after, count, without, lambda kept: told.set_result(list(kept)))
    async with asyncio.timeout(10):
        return await told


def left_by_a_killed_process(path: Path, to: Path) -> Path:
    """Return a copy of a file as a process that is killed now would leave it: what was written, and no more."""
    to.mkdir()
    for suffix in ("", "-wal"):
        if beside(path, suffix).exists():
            shutil.copy(beside(path, suffix), beside(to / path.name, suffix))
    return to / path.name
