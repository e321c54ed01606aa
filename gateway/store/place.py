"""The place of the store's file: its lock, the names beside it, and where a damaged one goes."""

from __future__ import annotations

import contextlib
import fcntl
import os
from datetime import UTC, datetime
from glob import escape
from pathlib import Path

from gateway.store.errors import StoreAway


def locked(path: Path) -> int:
    """Return the descriptor of a lock that only one process has; StoreAway says who has it."""
    if not path.parent.is_dir():
        raise StoreAway(f"{path}: there is no folder {path.parent}")
    if path.exists() and not path.is_file():
        raise StoreAway(f"{path} is not a file")
    lock = os.open(beside(path, ".lock"), os.O_RDWR | os.O_CREAT, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.ftruncate(lock, 0)
        os.pwrite(lock, str(os.getpid()).encode(), 0)
    except BlockingIOError:
        owner = os.pread(lock, 20, 0).decode(errors="replace")
        os.close(lock)
        raise StoreAway(f"{path} is in use by another process ({owner})") from None
    except BaseException:
        os.close(lock)
        raise
    return lock


def set_aside(path: Path, now: float) -> Path:
    """Rename the file and then its write-ahead log; return the new name, or that of before where that was all."""
    before = set_aside_before(path)
    if before and not path.exists() and not beside(path, "-wal").exists():
        return before[-1]
    stamp = datetime.fromtimestamp(now, UTC).strftime("%Y%m%dT%H%M%SZ")
    number = sum(1 for _ in path.parent.glob(_asides(path))) + 1
    aside = beside(path, f".damaged-{stamp}-{number}")
    for suffix in ("", "-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            beside(path, suffix).rename(beside(aside, suffix))
    sync(path.parent)
    return aside


def set_aside_before(path: Path) -> list[Path]:
    """Return the files that were set aside, the oldest first."""
    return sorted(name for name in path.parent.glob(_asides(path)) if not name.name.endswith(("-wal", "-shm")))


def _asides(path: Path) -> str:
    return f"{escape(path.name)}.damaged-*"


def beside(path: Path, suffix: str) -> Path:
    """Return the name of a file that belongs to another."""
    return path.with_name(path.name + suffix)


def sync(folder: Path) -> None:
    """Make names in a folder last."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
