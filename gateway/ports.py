"""Says why a TCP port cannot be listened on, which key would change it, and who holds it where that can be seen."""

from __future__ import annotations

import errno
import socket
from collections.abc import Iterator
from pathlib import Path

from gateway.errors import GatewayError

PROC = Path("/proc")
LISTENING = "0A"  # TCP_LISTEN in the state column of /proc/net/tcp


def explain_bind_error(error: OSError, host: str, port: int, key: str, proc: Path = PROC) -> GatewayError:
    """Put a failed bind into words for the operator; `key` is the configuration key that names host and port."""
    where = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    return GatewayError(f"{key}: cannot listen on {where}: {_reason(error, port, proc)}")


def _reason(error: OSError, port: int, proc: Path) -> str:
    if isinstance(error, socket.gaierror):
        return "the host name is not known here"
    if error.errno == errno.EADDRINUSE:
        who = holder(port, proc) or "a process that this user cannot see"
        return f"the port is in use by {who}: end that one, or choose another port"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "a port below 1024 needs the capability CAP_NET_BIND_SERVICE; choose one from 1024 on"
    if error.errno == errno.EADDRNOTAVAIL:
        return "this machine has no such address; 0.0.0.0 is all that it has"
    return error.strerror or str(error)


def holder(port: int, proc: Path = PROC) -> str | None:
    """Name the process that listens on a TCP port, as "name (pid 42)"; None where it cannot be seen."""
    wanted = {f"socket:[{inode}]" for inode in _listening_inodes(port, proc)}
    if not wanted:
        return None
    for process in sorted(proc.glob("[0-9]*")):
        if any(target in wanted for target in _descriptors(process)):
            return f"{_name(process)} (pid {process.name})"
    return None


def _listening_inodes(port: int, proc: Path) -> Iterator[str]:
    """Yield the inodes of the listening sockets with that port: columns 2, 4 and 10 of proc_net_tcp(5)."""
    for table in ("tcp", "tcp6"):
        try:
            lines = (proc / "net" / table).read_text(encoding="ascii").splitlines()[1:]
        except (OSError, UnicodeDecodeError):
            continue
        for fields in map(str.split, lines):
            if len(fields) > 9 and fields[3] == LISTENING and fields[1].endswith(f":{port:04X}"):
                yield fields[9]


def _descriptors(process: Path) -> Iterator[str]:
    """Yield what the descriptors of a process point at; nothing for another user's process."""
    try:
        for descriptor in (process / "fd").iterdir():
            yield str(descriptor.readlink())
    except OSError:  # not ours, or gone meanwhile
        return


def _name(process: Path) -> str:
    try:
        return (process / "comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return "a process"
