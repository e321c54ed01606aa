"""What stands in the file of a backlog, and how much of it has to go. Opens nothing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil
from zlib import crc32

from gateway.backlog import HistoricalReading, Kept, Kind

VERSION = 1
APPLICATION = 0x54564753  # "TVGS": stands in the header of every file of samples
PAGE = 4096  # bytes

TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE readings (
  number INTEGER PRIMARY KEY AUTOINCREMENT, drive TEXT NOT NULL, kind TEXT NOT NULL, ms INTEGER NOT NULL,
  body TEXT NOT NULL, crc INTEGER NOT NULL
);
"""
NOTE = "INSERT OR REPLACE INTO meta (key, value) VALUES (?, ?)"
APPEND = "INSERT INTO readings (drive, kind, ms, body, crc) VALUES (?, ?, ?, ?, ?)"
LET_GO = "DELETE FROM readings WHERE number = ?"
DROP_OLDEST = "DELETE FROM readings WHERE number IN (SELECT number FROM readings ORDER BY number LIMIT ?)"
DROP_OLDER = "DELETE FROM readings WHERE ms < ?"
TAKE = "SELECT number, drive, kind, ms, body, crc FROM readings WHERE number > ? ORDER BY number LIMIT ?"
TAKE_WITHOUT = TAKE.replace("ORDER BY", "AND drive NOT IN (%s) ORDER BY")

ROW_COST = 40  # bytes of a row beside its texts, as reckoned: number, kind, time, checksum, the record's header
FILLING = 0.8  # share of a page that rows fill at the least
SPARE = 8  # pages for what is neither, as a tree's inner pages

Row = tuple[object, ...]


@dataclass(frozen=True, slots=True)
class Limits:
    """How much is kept: bytes of the file, and seconds. `is_synced`: what is stored outlasts a loss of power."""

    max_bytes: int
    max_age: float
    is_synced: bool = True

    @property
    def pages(self) -> int:
        """Return how many pages the file may have."""
        return max(2 * SPARE, self.max_bytes // PAGE)


def row_of(reading: HistoricalReading) -> Row:
    """Return the row of a reading, for APPEND."""
    drive, kind, ms, body = reading.drive, reading.kind.value, reading.ms, reading.body
    return drive, kind, ms, body, _crc(drive, kind, ms, body)


def kept_of(row: Row) -> Kept | None:
    """Return the reading in a row of TAKE; None where it is not as it was written: SQLite does not look at values."""
    number, drive, kind, ms, body, crc = row
    if not (isinstance(number, int) and isinstance(ms, int) and isinstance(drive, str) and isinstance(body, str)):
        return None
    if crc != _crc(drive, kind, ms, body) or kind not in KINDS:
        return None
    return Kept(number, HistoricalReading(drive, Kind(kind), ms, body))


KINDS = frozenset(kind.value for kind in Kind)


def _crc(drive: str, kind: object, ms: int, body: str) -> int:
    return crc32(f"{drive}\0{kind}\0{ms}\0{body}".encode(errors="surrogatepass"))


def size_of(reading: HistoricalReading) -> int:
    """Return about how many bytes of the file a reading takes."""
    return ROW_COST + len(reading.drive) + len(reading.body.encode(errors="surrogatepass"))


def to_drop(readings: Sequence[HistoricalReading], rows: int, used: int, limits: Limits) -> int:
    """Return how many of the oldest rows have to go before these are written; `used` is in pages."""
    lacking = used + pages_of(readings) + SPARE - limits.pages
    if lacking <= 0 or not rows:
        return 0
    return min(rows, ceil(rows * lacking / max(1, used)))


def pages_of(readings: Iterable[HistoricalReading]) -> int:
    """Return how many pages readings take at the most, as reckoned."""
    return ceil(sum(map(size_of, readings)) / (PAGE * FILLING))


def fitting(readings: Sequence[HistoricalReading], limits: Limits) -> Sequence[HistoricalReading]:
    """Return the newest of them that the file could hold if there were nothing else in it."""
    room = (limits.pages - SPARE) * PAGE * FILLING
    for place in range(len(readings) - 1, -1, -1):
        room -= size_of(readings[place])
        if room < 0:
            return readings[place + 1 :]
    return readings
