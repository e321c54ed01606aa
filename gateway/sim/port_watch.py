"""What becomes of the other side of a pty: who closed it (inotify), and whose it is (a lock on its first byte)."""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import struct
from pathlib import Path

IN_CLOSE = 0x08 | 0x10  # inotify(7): closed, whether it was open for writing or not
READ_SIZE = 4096
PTYS = Path("/dev/pts")
LOCK = "hhqqi4x"  # struct flock: type, whence, start, length, process


class ClosingWatch:
    """Becomes readable whenever a program has closed the port; on a system without inotify it never does."""

    def __init__(self, port: str) -> None:
        self.descriptor: int | None = None
        with contextlib.suppress(OSError, AttributeError):
            libc = ctypes.CDLL(None, use_errno=True)
            descriptor = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
            if descriptor >= 0:
                self.descriptor = descriptor
                libc.inotify_add_watch(descriptor, port.encode(), IN_CLOSE)

    def has_closings(self) -> bool:
        """Say whether a program has closed the port since the last call."""
        if self.descriptor is None:
            return False
        try:
            return bool(os.read(self.descriptor, READ_SIZE))
        except BlockingIOError:
            return False

    def close(self) -> None:
        """Watch no more."""
        if self.descriptor is not None:
            os.close(self.descriptor)
            self.descriptor = None


def claim(descriptor: int) -> None:
    """Mark a pty as a simulated line's for as long as the descriptor is open; a master's flock is another lock."""
    with contextlib.suppress(OSError):  # not on every system; a link is not protected then
        fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, struct.pack(LOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 1, 0))


def is_claimed(port: Path) -> bool:
    """Say whether a living simulated line has the pty that a path leads to; one that cannot be opened is nobody's."""
    if port.resolve().parent != PTYS:
        return False
    try:
        descriptor = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        asked = struct.pack(LOCK, fcntl.F_WRLCK, os.SEEK_SET, 0, 1, 0)
        kind = struct.unpack(LOCK, fcntl.fcntl(descriptor, fcntl.F_OFD_GETLK, asked))[0]
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return bool(kind != fcntl.F_UNLCK)
