"""The pseudo-terminal that stands for a serial adapter: it can be opened by any program, pulled out and put back."""

from __future__ import annotations

import contextlib
import os
import pty
import termios
import tty
from pathlib import Path

from gateway.sim.port_watch import ClosingWatch, claim, is_claimed

READ_SIZE = 4096
RATES = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400)
RATE_OF_SPEED = {getattr(termios, f"B{rate}"): rate for rate in RATES}
LOCAL_MODES, OUTPUT_SPEED, CHARACTERS = 3, 5, 6  # places in what tcgetattr returns


class PtyPort:
    """The adapter's side of a pty. It keeps the other side open too, so that no master on it is no error."""

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self._own: int | None = None
        self._others: int | None = None
        self._closings: ClosingWatch | None = None
        self.name = ""
        self.plug()

    @property
    def descriptor(self) -> int | None:
        """Return what to wait on; None while it is unplugged."""
        return self._own

    @property
    def closings(self) -> int | None:
        """Return what to wait on for `restore`; None while it is unplugged."""
        return self._closings.descriptor if self._closings else None

    @property
    def baud(self) -> int | None:
        """Return the baud rate that the master has set, None for one that is not usual; 38400 before it sets any."""
        if self._own is None:
            return None
        return RATE_OF_SPEED.get(termios.tcgetattr(self._own)[OUTPUT_SPEED])

    def plug(self) -> None:
        """Open a pty with nothing between the bytes and the reader, and point the link at it."""
        if self._own is not None:
            return
        self._own, self._others = pty.openpty()
        tty.setraw(self._others)
        os.set_blocking(self._own, False)
        self.name = os.ttyname(self._others)
        claim(self._others)
        self._closings = ClosingWatch(self.name)
        if self._link is not None:
            try:
                self._point(self._link)
            except OSError:
                self.unplug()
                raise

    def _point(self, link: Path) -> None:
        """Set the link in one step: whoever opens it finds the old port or the new one. Another line's stays."""
        if link.is_symlink() and str(link.readlink()) != self.name and is_claimed(link):
            raise FileExistsError(f"{link} is the link of another simulated line; end it, or choose another link")
        fresh = link.with_name(f".{link.name}.{os.getpid()}")
        with contextlib.suppress(FileNotFoundError):
            fresh.unlink()
        fresh.symlink_to(self.name)
        if link.exists() and not link.is_symlink():
            fresh.unlink()
            raise FileExistsError(f"{link} exists and is no link")
        fresh.replace(link)

    def unplug(self) -> None:
        """Pull the adapter out: whoever has the port open gets errors, as with real hardware."""
        if self._own is not None and self._link is not None:
            self._remove(self._link)
        for descriptor in (self._own, self._others):
            if descriptor is not None:
                os.close(descriptor)
        self._own = self._others = None
        if self._closings is not None:
            self._closings.close()
            self._closings = None

    def _remove(self, link: Path) -> None:
        """Remove the link where it is still this port's: once that is closed, its name may be another line's."""
        with contextlib.suppress(FileNotFoundError):
            if link.is_symlink() and str(link.readlink()) == self.name:
                link.unlink()

    def restore(self) -> None:
        """Let a reader wait for bytes again, where the program that closed the port left it otherwise.

        A pty keeps its settings while this side is open. pyserial and libmodbus leave reading without waiting
        (VMIN = VTIME = 0), which `cat` takes for the end; a terminal program may leave lines. The rate stays.
        """
        if self._others is None or self._closings is None or not self._closings.has_closings():
            return
        settings = termios.tcgetattr(self._others)
        characters = settings[CHARACTERS]
        has_lines = settings[LOCAL_MODES] & termios.ICANON
        if has_lines or not (characters[termios.VMIN] or characters[termios.VTIME]):
            tty.setraw(self._others, termios.TCSANOW)

    def read(self) -> bytes:
        """Return what the master wrote, b"" for nothing."""
        if self._own is None:
            return b""
        try:
            return os.read(self._own, READ_SIZE)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> None:
        """Hand bytes to the master; where nobody reads, what does not fit is lost, as on a line."""
        if self._own is not None:
            with contextlib.suppress(BlockingIOError):
                os.write(self._own, data)
