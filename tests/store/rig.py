"""A store on a file of a test, and what is needed to look at it."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.clock import Alarm
from gateway.store.store import Store
from gateway.store.thread import Pace

QUICK = Pace(gather=0.001, retry=0.005, retry_at_most=0.01)
WALL = 1_700_000_000.0  # UTC seconds
ROWS = 1000


@dataclass
class HandClock:
    """A clock that a test moves: monotonic and UTC seconds apart."""

    moment: float = 5000.0
    utc: float = WALL

    def now(self) -> float:
        """Return monotonic seconds."""
        return self.moment

    def wall(self) -> float:
        """Return UTC seconds."""
        return self.utc

    def alarm(self) -> Alarm:
        """Nobody waits here."""
        raise NotImplementedError


@asynccontextmanager
async def running(path: Path, clock: HandClock | None = None, rows: int = ROWS) -> AsyncIterator[Store]:
    """Start a store, and close it afterwards."""
    store = Store(path, rows, clock or HandClock(), QUICK)
    store.start()
    try:
        yield store
    finally:
        await store.close()


@asynccontextmanager
async def open_store(path: Path, clock: HandClock | None = None, rows: int = ROWS) -> AsyncIterator[Store]:
    """Start a store, and wait until it is sound."""
    async with running(path, clock, rows) as store:
        await until(lambda: not store.problem)
        yield store


async def until(holds: Callable[[], object]) -> None:
    """Wait until something holds."""
    async with asyncio.timeout(10):
        while not holds():
            await asyncio.sleep(0.001)


async def reserved(store: Store, drive: str = "pump", number: int = 0x10) -> str:
    """Reserve a write; return what is told: "" or why not."""
    told: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    store.reserve(drive, number, told.set_result)
    async with asyncio.timeout(10):
        return await told


async def counted(path: Path, writes: int, drive: str = "pump", number: int = 0x10) -> None:
    """Let a file hold so many writes."""
    async with open_store(path) as store:
        for _ in range(writes):
            store.note(drive, number)


def rows_of(path: Path, question: str) -> list[tuple[Any, ...]]:
    """Ask the file as the sqlite3 shell would."""
    with closing(sqlite3.connect(path)) as connection:
        return list(connection.execute(question))


def audit(path: Path, columns: str = "verb, text") -> list[tuple[Any, ...]]:
    """Return the rows of the audit in their order."""
    return rows_of(path, f"SELECT {columns} FROM audit ORDER BY id")  # noqa: S608 - the tests' own columns
