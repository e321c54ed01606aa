"""Why a listening port cannot be had, in words: who has it, and what to change."""

from __future__ import annotations

import contextlib
import errno
from pathlib import Path

from gateway.errors import GatewayError

LISTENING = "0A"  # state of a listening socket in /proc/net/tcp (proc(5))


def explain_bind_error(error: OSError, host: str, port: int, key: str) -> GatewayError:
    """Return what to tell the operator when `host`:`port`, configured under `key`, cannot be bound."""
    place = f"{host}:{port}"
    if error.errno == errno.EADDRINUSE:
        holder = _holder(port)
        who = f"is in use by {holder}" if holder else "is in use by another program"
        return GatewayError(f"{key}: {place} {who}; end that one, or choose another port under {key}")
    if error.errno == errno.EACCES:
        return GatewayError(f"{key}: {place} needs a privilege; choose one from 1024, or give CAP_NET_BIND_SERVICE")
    if error.errno == errno.EADDRNOTAVAIL:
        return GatewayError(f"{key}: {host} is no address of this machine; choose one that is, or 0.0.0.0 for all")
    return GatewayError(f"{key}: {place}: {error.strerror or error}")


def _holder(port: int) -> str | None:
    """Name the process that listens on a port, as far as this user may see."""
    inodes = {f"socket:[{inode}]" for inode in _listening_inodes(port)}
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if any(str(link.readlink()) in inodes for link in (entry / "fd").iterdir()):
                return f"{(entry / 'comm').read_text().strip()} (process {entry.name})"
    return None


def _listening_inodes(port: int) -> list[str]:
    inodes = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        with contextlib.suppress(OSError):
            for line in Path(table).read_text().splitlines()[1:]:
                fields = line.split()
                if fields[3] == LISTENING and int(fields[1].rpartition(":")[2], 16) == port:
                    inodes.append(fields[9])
    return inodes
