"""Tells the service manager how the daemon is, by the datagrams of sd_notify(3)."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Mapping

log = logging.getLogger("gateway.systemd")


def notify(state: str, environment: Mapping[str, str] = os.environ) -> bool:
    """Send a state such as "READY=1"; say whether it went out.

    Never raises and never waits: a service manager that does not listen must not hold up the drives.
    """
    name = environment.get("NOTIFY_SOCKET")
    if not name:
        return False
    if name[0] not in "/@":
        log.debug("NOTIFY_SOCKET %s: neither a path nor an abstract socket", name)
        return False
    target = "\0" + name[1:] if name[0] == "@" else name
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC) as to:
            to.sendto(state.encode(), target)
    except OSError as error:
        log.debug("NOTIFY_SOCKET %s: %s", name, error)
        return False
    return True


def watchdog_interval(environment: Mapping[str, str] = os.environ) -> float | None:
    """Return the seconds within which WATCHDOG=1 must come again; None where no watchdog is set for this process."""
    microseconds = environment.get("WATCHDOG_USEC", "")
    process = environment.get("WATCHDOG_PID", "")
    if process and process != str(os.getpid()):
        return None  # inherited from a parent that is watched itself
    if not (microseconds.isascii() and microseconds.isdigit()) or int(microseconds) == 0:
        return None
    return int(microseconds) / 1e6
