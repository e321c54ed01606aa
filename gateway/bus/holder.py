"""Says which other process has a device, from /proc, for whoever finds it taken."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def holder(port: str) -> str | None:
    """Say which other process has the device: the one with the lock, or else one that has it open."""
    found = _lock_holder(port)
    if found is None:
        device = os.path.realpath(port)
        others = (entry for entry in Path("/proc").glob("[0-9]*") if entry.name != str(os.getpid()))
        found = next((entry.name for entry in others if _has_open(entry, device)), None)
    if found is None:
        return None
    with contextlib.suppress(OSError):
        command = Path(f"/proc/{found}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        return f"process {found} ({command.strip()[:80]})"
    return f"process {found}"


def _lock_holder(port: str) -> str | None:
    """Return the id of the process that holds the exclusive lock, from /proc/locks (proc(5))."""
    with contextlib.suppress(OSError):
        inode = str(Path(port).stat().st_ino)
        for line in Path("/proc/locks").read_text().splitlines():
            fields = line.split()
            if fields[1] == "FLOCK" and fields[5].rpartition(":")[2] == inode:
                return fields[4]
    return None


def _has_open(process: Path, device: str) -> bool:
    """Say whether a process has the device open, as far as this user may see."""
    with contextlib.suppress(OSError):
        return any(os.path.realpath(link) == device for link in (process / "fd").iterdir())
    return False
