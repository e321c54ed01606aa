"""The SQLite file of the store: how it is opened, read and written. Every call may wait for the disk.

A file that is damaged is set aside under another name, never deleted, and a new one begun. What the damaged one still
tells is taken over, but no count is believed to be 0: the new file says that counts were lost, until an operator
accepts a number that no parameter was written more often than (`accept`).
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gateway.control.ledger import Entry
from gateway.control.wear import Key, Wear
from gateway.store import schema
from gateway.store.errors import StoreAway, StoreDamaged, translated
from gateway.store.place import beside, locked, set_aside, set_aside_before, sync
from gateway.store.schema import Saved
from gateway.store.transaction import transaction

BUSY_WAIT = 2.0  # seconds for another program, such as the sqlite3 shell, to finish what it writes
LONGEST_LOG = 1_000_000  # bytes of the write-ahead log that are kept when it is empty


@dataclass(slots=True)
class StateFile:
    """An open file, locked for this process; readers such as the sqlite3 shell may look on."""

    path: Path
    audit_rows: int
    _connection: sqlite3.Connection
    _lock: int

    @classmethod
    def open(cls, path: Path, audit_rows: int, now: float, *, is_checked: bool = True) -> StateFile:
        """Open the file, made anew where there is none; StoreAway or StoreDamaged say what is wrong with it.

        `now` is UTC seconds. `is_checked`: the whole file is looked through. It is also written to, since one that
        cannot be written to is of no use.
        """
        with translated(path):
            lock = locked(path)
            try:
                if not path.exists():
                    if beside(path, "-wal").exists() or set_aside_before(path):
                        raise StoreDamaged(f"{path} is missing, though it was there")
                    _create(path, Saved())
                file = cls(path, audit_rows, _connected(path, is_checked=is_checked), lock)
            except BaseException:
                os.close(lock)
                raise
            try:
                with transaction(file._connection) as connection:
                    connection.execute(schema.NOTE, ("opened", schema.in_utc(now)))
                    connection.execute(schema.NOTE, ("audit_rows", str(audit_rows)))
            except BaseException:
                file.close()
                raise
            return file

    def read(self) -> Saved:
        """Return all counts."""
        with translated(self.path):
            return _saved(self._connection, self.path)

    def write(self, counts: Mapping[Key, Wear]) -> None:
        """Write counts, all together and for good when this returns; none goes down."""
        with translated(self.path), transaction(self._connection) as connection:
            connection.executemany(schema.COUNT, schema.rows_of(counts))

    def keep(self, texts: Mapping[str, str]) -> None:
        """Write short texts, each in the place of an older one."""
        with translated(self.path), transaction(self._connection) as connection:
            connection.executemany(schema.NOTE, [(schema.KEPT + key, text) for key, text in texts.items()])

    def append(self, entries: Sequence[Entry]) -> None:
        """Append to the audit, and let go the oldest of too many rows."""
        with translated(self.path), transaction(self._connection) as connection:
            connection.executemany(schema.APPEND, [schema.row_of(entry) for entry in entries])
            connection.execute(schema.TRIM, (self.audit_rows,))

    def accept(self, writes: int) -> None:
        """Take every parameter to have been written `writes` times at least: the counts are then whole again."""
        saved = self.read()
        counts = {key: replace(wear, writes=max(writes, wear.writes)) for key, wear in saved.wear.items()}
        with translated(self.path), transaction(self._connection) as connection:
            connection.executemany(schema.COUNT, schema.rows_of(counts))
            connection.execute(schema.NOTE, ("begins_at", str(max(writes, saved.begins_at))))
            connection.execute("DELETE FROM meta WHERE key = 'lost'")

    def close(self) -> None:
        """Close the file and let others have it."""
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()
        os.close(self._lock)


def look(path: Path) -> Saved:
    """Return what a file holds, without a lock, also while the gateway has it; StoreAway where there is none."""
    with translated(path), contextlib.closing(_connected_to_read(path)) as connection:
        return _saved(connection, path)


def begin_anew(path: Path, now: float, begins_at: int | None) -> str:
    """Set a damaged file aside and begin a new one with what the old one still tells; say what was done.

    `begins_at` is None where the counts are not known otherwise: the new file then says that they were lost.
    """
    with translated(path):
        lock = locked(path)
        try:
            aside = set_aside(path, now)
            counts = _salvaged(aside)
            highest = max((wear.writes for wear in counts.values()), default=0)
            told = f"{path} was damaged and is kept as {aside}"
            if begins_at is None:
                told += f"; {len(counts)} counts could be read from it, the highest {highest}"
            _create(path, Saved(counts, begins_at or 0, told if begins_at is None else ""))
        finally:
            os.close(lock)
    return told


def _connected(path: Path, *, is_checked: bool) -> sqlite3.Connection:
    """Open the database; StoreAway where it is not ours, StoreDamaged where it is not sound."""
    if not path.stat().st_size:
        raise StoreDamaged(f"{path} is empty")
    connection = sqlite3.connect(path, timeout=BUSY_WAIT, isolation_level=None)
    try:
        (application,) = connection.execute("PRAGMA application_id").fetchone()
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if application != schema.APPLICATION:
            raise StoreAway(f"{path} is no store of this gateway and is left as it is; set store.path to another")
        if version != schema.VERSION:
            known = f"schema {version}; this one knows {schema.VERSION}"
            raise StoreAway(f"{path} was written by another version of the gateway ({known}) and is left as it is")
        if is_checked and connection.execute("PRAGMA quick_check(1)").fetchone() != ("ok",):
            raise StoreDamaged(f"{path} is damaged")
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute(f"PRAGMA journal_size_limit = {LONGEST_LOG}")
        connection.execute("PRAGMA synchronous = FULL")
    except BaseException:
        connection.close()
        raise
    return connection


def _connected_to_read(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", timeout=BUSY_WAIT, uri=True)


def _saved(connection: sqlite3.Connection, path: Path) -> Saved:
    connection.text_factory = _text
    meta = dict(connection.execute("SELECT key, value FROM meta"))
    counts = [schema.count_of(row) for row in connection.execute(schema.COUNTS)]
    begins_at = meta.get("begins_at", "")
    if None in counts or not begins_at.isdecimal():
        raise StoreDamaged(f"{path} is damaged: a count is not as it was written")
    kept = {key.removeprefix(schema.KEPT): text for key, text in meta.items() if key.startswith(schema.KEPT)}
    return Saved(dict(filter(None, counts)), int(begins_at), meta.get("lost", ""), kept)


def _text(raw: bytes) -> str:
    """Read what may be no text at all in a damaged file."""
    return raw.decode(errors="replace")


def _create(path: Path, saved: Saved) -> None:
    """Make a file under another name, and give it its own when it is whole: so an empty one is always damaged."""
    new = beside(path, ".new")
    for rest in (new, beside(new, "-journal")):
        rest.unlink(missing_ok=True)
    with contextlib.closing(sqlite3.connect(new, isolation_level=None)) as connection:
        connection.execute("PRAGMA synchronous = FULL")
        connection.executescript(f"BEGIN; {schema.TABLES} COMMIT;")
        connection.execute(f"PRAGMA application_id = {schema.APPLICATION}")
        connection.execute(f"PRAGMA user_version = {schema.VERSION}")
        connection.executemany(schema.COUNT, schema.rows_of(saved.wear))
        connection.execute(schema.NOTE, ("begins_at", str(saved.begins_at)))
        if saved.lost:
            connection.execute(schema.NOTE, ("lost", saved.lost))
    new.rename(path)
    sync(path.parent)


def _salvaged(aside: Path) -> dict[Key, Wear]:
    """Return the counts that a damaged file still tells."""
    found: dict[Key, Wear] = {}
    with contextlib.suppress(sqlite3.Error), contextlib.closing(_connected_to_read(aside)) as connection:
        connection.text_factory = _text
        rows = connection.execute(schema.COUNTS)
        found.update(count for row in rows if (count := schema.count_of(row)) is not None)
    return found
