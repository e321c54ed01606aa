"""The SQLite file of a backlog: how it is opened, written, read and made smaller. Every call may wait for the disk.

It is a file of its own, apart from the counters of the EEPROM: what is written here often must not hold those up, nor
be damaged together with them. A write-ahead log makes each batch whole or nothing, whenever the process is killed;
`Limits.is_synced` makes it outlast a loss of power as well.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gateway.backlog import HistoricalReading, Kept
from gateway.store import backlog_schema as schema
from gateway.store.backlog_schema import Limits
from gateway.store.errors import StoreAway, StoreDamaged, translated
from gateway.store.place import beside, locked, set_aside, set_aside_before, sync
from gateway.store.transaction import transaction

BUSY_WAIT = 1.0  # seconds for another program to finish what it writes
LONGEST_LOG = 1_000_000  # bytes of the write-ahead log that are kept when it is empty
VACUUM = 256  # pages that are given back at a stretch
EMPTY = 64  # pages that may stay empty: they are soon filled again


@dataclass(frozen=True, slots=True)
class Appended:
    """What became of readings: how many are in the file for good, and how many of all the oldest had to go."""

    stored: int
    dropped: int


class BacklogFile:
    """An open file, locked for this process."""

    def __init__(self, path: Path, limits: Limits, connection: sqlite3.Connection, lock: int) -> None:
        self.path = path
        self.rows = 0
        self.origin = ""
        self._limits = limits
        self._connection = connection
        self._lock = lock

    @classmethod
    def open(cls, path: Path, limits: Limits) -> BacklogFile:
        """Open the file, made anew where there is none; StoreAway or StoreDamaged say what is wrong with it."""
        with translated(path):
            lock = locked(path)
            try:
                if not path.exists():
                    _create(path)
                file = cls(path, limits, _connected(path, limits), lock)
            except BaseException:
                os.close(lock)
                raise
            try:
                file._begin()
            except BaseException:
                file.close()
                raise
            return file

    def _begin(self) -> None:
        (self.rows,) = self._connection.execute("SELECT count(*) FROM readings").fetchone()
        found = self._connection.execute("SELECT value FROM meta WHERE key = 'origin'").fetchone()
        if found is None:
            raise StoreDamaged(f"{self.path} is damaged: it does not say which it is")
        (self.origin,) = found

    def append(self, readings: Sequence[HistoricalReading]) -> Appended:
        """Write readings, whole and for good when this returns; the oldest give way where they do not fit."""
        fitting = schema.fitting(readings, self._limits)
        with translated(self.path):
            dropped = self._written(fitting)
        return Appended(len(fitting), dropped + len(readings) - len(fitting))

    def _written(self, readings: Sequence[HistoricalReading]) -> int:
        rows = self.rows
        with transaction(self._connection) as connection:
            dropped = 0
            while count := schema.to_drop(readings, rows - dropped, self._used(), self._limits):
                dropped += connection.execute(schema.DROP_OLDEST, (count,)).rowcount
            connection.executemany(schema.APPEND, map(schema.row_of, readings))
        self.rows = rows - dropped + len(readings)
        return dropped

    def take(self, after: int, count: int, without: frozenset[str] = frozenset()) -> tuple[list[Kept], list[int]]:
        """Return the oldest readings behind a number, but for some drives', and the numbers of damaged rows."""
        question = schema.TAKE_WITHOUT % ", ".join("?" * len(without)) if without else schema.TAKE
        with translated(self.path):
            rows = self._connection.execute(question, (after, *sorted(without), count)).fetchall()
        found = [(row[0], schema.kept_of(row)) for row in rows]
        return [kept for _, kept in found if kept is not None], [number for number, kept in found if kept is None]

    def let_go(self, numbers: Sequence[int]) -> int:
        """Keep these no longer; return how many there were."""
        with translated(self.path), transaction(self._connection) as connection:
            gone = connection.executemany(schema.LET_GO, [(number,) for number in numbers]).rowcount
        self.rows -= gone
        return gone

    def drop_older(self, ms: int) -> int:
        """Drop what is older than that, in milliseconds of UTC; return how many."""
        with translated(self.path), transaction(self._connection) as connection:
            gone = connection.execute(schema.DROP_OLDER, (ms,)).rowcount
        self.rows -= gone
        return gone

    def shrink(self) -> bool:
        """Give some of the pages that are empty back to the disk; say whether there are more."""
        with translated(self.path):
            empty = self._pragma("freelist_count")
            if empty <= max(EMPTY, self._used()):
                return False
            self._connection.executescript(f"PRAGMA incremental_vacuum({VACUUM})")  # `execute` would do one page
            return True

    def close(self) -> None:
        """Close the file and let others have it."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()
        os.close(self._lock)

    def _used(self) -> int:
        return self._pragma("page_count") - self._pragma("freelist_count")

    def _pragma(self, name: str) -> int:
        (value,) = self._connection.execute(f"PRAGMA {name}").fetchone()
        return int(value)


def begin_anew(path: Path, now: float) -> str:
    """Set a damaged file aside, in the place of one set aside before, so that a new one can be made; say so."""
    with translated(path):
        lock = locked(path)
        try:
            before = set_aside_before(path)
            aside = set_aside(path, now)
            for old in before:
                for suffix in ("", "-wal", "-shm") if old != aside else ():
                    beside(old, suffix).unlink(missing_ok=True)
        finally:
            os.close(lock)
    return f"{path} was damaged and is kept as {aside}; what it held is not sent"


def _connected(path: Path, limits: Limits) -> sqlite3.Connection:
    """Open the database; StoreAway where it is not ours, StoreDamaged where it is not sound."""
    if not path.stat().st_size:
        raise StoreDamaged(f"{path} is empty")
    connection = sqlite3.connect(path, timeout=BUSY_WAIT, isolation_level=None)
    try:
        connection.text_factory = _text
        (application,) = connection.execute("PRAGMA application_id").fetchone()
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if application != schema.APPLICATION:
            raise StoreAway(f"{path} is no backlog of this gateway and is left as it is; set store.path to another")
        if version != schema.VERSION:
            raise StoreAway(f"{path} was written by another version of the gateway ({version}) and is left as it is")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute(f"PRAGMA journal_size_limit = {LONGEST_LOG}")
        connection.execute(f"PRAGMA synchronous = {'FULL' if limits.is_synced else 'NORMAL'}")
        connection.execute(f"PRAGMA max_page_count = {limits.pages}")
    except BaseException:
        connection.close()
        raise
    return connection


def _text(raw: bytes) -> str:
    """Read what may be no text at all in a damaged file."""
    return raw.decode(errors="replace")


def _create(path: Path) -> None:
    """Make a file under another name, and give it its own when it is whole: so an empty one is always damaged."""
    new = beside(path, ".new")
    for rest in (new, beside(new, "-journal")):
        rest.unlink(missing_ok=True)
    with contextlib.closing(sqlite3.connect(new, isolation_level=None)) as connection:
        connection.execute(f"PRAGMA page_size = {schema.PAGE}")
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        connection.execute("PRAGMA synchronous = FULL")
        connection.executescript(f"BEGIN; {schema.TABLES} COMMIT;")
        connection.execute(f"PRAGMA application_id = {schema.APPLICATION}")
        connection.execute(f"PRAGMA user_version = {schema.VERSION}")
        connection.execute(schema.NOTE, ("origin", secrets.token_hex(4)))
    beside(path, "-wal").unlink(missing_ok=True)  # of a file that somebody has removed
    beside(path, "-shm").unlink(missing_ok=True)
    new.rename(path)
    sync(path.parent)
