"""What stands in the store's file: its tables, and how counts and entries of the audit become rows. Opens nothing."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from zlib import crc32

from gateway.control.ledger import Entry
from gateway.control.wear import Key, Wear

VERSION = 1
APPLICATION = 0x54564757  # "TVGW": stands in the header of every file of ours

TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE eeprom_writes (
  drive TEXT NOT NULL, number INTEGER NOT NULL, writes INTEGER NOT NULL CHECK (writes >= 0),
  pace REAL NOT NULL, last REAL NOT NULL, crc INTEGER NOT NULL, PRIMARY KEY (drive, number)
) WITHOUT ROWID;
CREATE TRIGGER eeprom_writes_only_go_up BEFORE UPDATE ON eeprom_writes
  WHEN NEW.writes < OLD.writes OR NEW.drive IS NOT OLD.drive OR NEW.number IS NOT OLD.number
  BEGIN SELECT RAISE(ABORT, 'counts only go up'); END;
CREATE TRIGGER eeprom_writes_are_kept BEFORE DELETE ON eeprom_writes
  BEGIN SELECT RAISE(ABORT, 'counts are kept'); END;
CREATE TABLE audit (
  id INTEGER PRIMARY KEY AUTOINCREMENT, time TEXT NOT NULL, drive TEXT NOT NULL, kind TEXT NOT NULL,
  source TEXT NOT NULL, verb TEXT NOT NULL, command_id TEXT NOT NULL, value TEXT NOT NULL, before TEXT NOT NULL,
  words TEXT NOT NULL, read_back TEXT NOT NULL, status TEXT NOT NULL, reason TEXT NOT NULL, text TEXT NOT NULL
);
CREATE TRIGGER audit_is_not_changed BEFORE UPDATE ON audit
  BEGIN SELECT RAISE(ABORT, 'the audit is not changed'); END;
CREATE TRIGGER audit_keeps_what_is_recent BEFORE DELETE ON audit
  WHEN OLD.id > (SELECT max(id) FROM audit) - (SELECT CAST(value AS INTEGER) FROM meta WHERE key = 'audit_rows')
  BEGIN SELECT RAISE(ABORT, 'the audit is kept'); END;
"""
COUNT = """
INSERT INTO eeprom_writes (drive, number, writes, pace, last, crc) VALUES (?, ?, ?, ?, ?, ?)
ON CONFLICT (drive, number) DO UPDATE SET writes = excluded.writes, pace = excluded.pace, last = excluded.last,
  crc = excluded.crc WHERE excluded.writes >= writes
"""
COUNTS = "SELECT drive, number, writes, pace, last, crc FROM eeprom_writes"
APPEND = """
INSERT INTO audit (time, drive, kind, source, verb, command_id, value, before, words, read_back, status, reason, text)
VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
"""
TRIM = "DELETE FROM audit WHERE id <= (SELECT max(id) FROM audit) - ?"
KEPT = "kept "  # begins the key of a short text in `meta` that another part of the gateway keeps
NOTE = "INSERT OR REPLACE INTO meta (key, value) VALUES (?, ?)"

Row = tuple[object, ...]


@dataclass(frozen=True, slots=True)
class Saved:
    """What a file holds. Times are UTC seconds; `begins_at` is what a parameter without a count is taken to have.

    `lost` says how counts were lost, "" where they are whole. `kept` are short texts of other parts of the gateway.
    """

    wear: Mapping[Key, Wear] = field(default_factory=dict)
    begins_at: int = 0
    lost: str = ""
    kept: Mapping[str, str] = field(default_factory=dict)


def rows_of(counts: Mapping[Key, Wear]) -> list[Row]:
    """Return the rows of counts, for COUNT."""
    return [(*key, wear.writes, wear.pace, wear.last, _crc(key, wear)) for key, wear in counts.items()]


def count_of(row: Row) -> tuple[Key, Wear] | None:
    """Return the count in a row of COUNTS; None where it is not as it was written: SQLite does not look at values."""
    drive, number, writes, pace, last, crc = row
    if not (isinstance(drive, str) and isinstance(number, int) and isinstance(writes, int)):
        return None
    if not (isinstance(pace, float) and isinstance(last, float)):
        return None
    key, wear = (drive, number), Wear(writes, pace, last)
    return (key, wear) if crc == _crc(key, wear) else None


def _crc(key: Key, wear: Wear) -> int:
    return crc32(repr((*key, wear.writes, wear.pace, wear.last)).encode())


def row_of(entry: Entry) -> Row:
    """Return the row of an entry of the audit, for APPEND: words as JSON, name to four hexadecimal digits."""
    before, words, read_back = (
        json.dumps({name: f"{word:04X}" for name, word in of.items()})
        for of in (entry.before, entry.words, entry.read_back)
    )
    asked = (entry.source, entry.verb, entry.id, entry.value)
    became = (entry.status, entry.reason, entry.text)
    row = (in_utc(entry.time), entry.drive, entry.kind, *asked, before, words, read_back, *became)
    return tuple(text.encode(errors="backslashreplace").decode() for text in row)  # JSON may hold half a character


def in_utc(seconds: float) -> str:
    """Return UTC seconds as ISO 8601 with milliseconds."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
