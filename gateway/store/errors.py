"""What can be wrong with the store's file, in the operator's words."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gateway.errors import GatewayError

EXPLAINED = {  # primary result codes of SQLite
    sqlite3.SQLITE_BUSY: "another program is writing to it",
    sqlite3.SQLITE_READONLY: "it cannot be written to",
    sqlite3.SQLITE_IOERR: "the disk fails, or lets no more be written",
    sqlite3.SQLITE_FULL: "the disk is full",
    sqlite3.SQLITE_CANTOPEN: "it cannot be opened",
}
DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


class StoreAway(GatewayError):
    """The store cannot be used: refuse what must be counted, and try again later."""


class StoreDamaged(StoreAway):
    """The file is no sound database: set it aside and begin a new one."""


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn the errors of SQLite and of the system into the store's own."""
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        if code in DAMAGED:
            raise StoreDamaged(f"{path} is damaged: {error}") from error
        raise StoreAway(f"{path}: {EXPLAINED.get(code, error)}") from error
    except OSError as error:
        raise StoreAway(f"{path}: {error.strerror or error}") from error
