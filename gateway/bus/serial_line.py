"""A serial device or a serial server as a line: opening, the gap, reading and writing; the only I/O of the bus."""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import socket
import termios
from pathlib import Path

import serial

from gateway import site
from gateway.clock import Clock
from gateway.config import address
from gateway.errors import BadReply, LineDown, TooLate
from gateway.protocol.timing import LineTiming

READ_SIZE = 4096  # bytes taken from the port at once; an answer has at most 64
NEVER_QUIET = 1.0  # seconds without a gap, after which waiting for one is given up
CONNECT_TIMEOUT = 5.0  # seconds for a serial server to accept
PTY_MAJORS = range(136, 144)  # Linux device numbers of pseudo-terminals

PARITIES = {"even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD, "none": serial.PARITY_NONE}


async def open_line(line: site.Line, clock: Clock) -> DescriptorLine:
    """Open the port of a line, exclusively; LineDown says why not, and who holds it."""
    loop = asyncio.get_running_loop()
    opened: serial.Serial | socket.socket
    if line.is_network:
        opened = await loop.run_in_executor(None, _connect, line)
    else:
        opened = await loop.run_in_executor(None, _open_device, line)
    return DescriptorLine(line.port, opened, line.timing, clock, is_pty=_is_pty(line.port))


def _open_device(line: site.Line) -> serial.Serial:
    """Open a serial device: 8 bits, the configured parity; 2 stop bits where there is no parity bit.

    A pseudo-terminal drops parity and refuses a change that changes nothing else: it is opened as 8N2.
    """
    parity = "none" if _is_pty(line.port) else line.parity
    stop_bits = serial.STOPBITS_TWO if parity == "none" else serial.STOPBITS_ONE
    try:
        port = serial.Serial(
            line.port, line.baud, parity=PARITIES[parity], stopbits=stop_bits, timeout=0, exclusive=True
        )
    except (OSError, serial.SerialException, termios.error, ValueError) as error:
        raise LineDown(f"{line.port}: {_reason(line.port, error)}") from error
    if not _is_pty(line.port):
        with contextlib.suppress(OSError, ValueError, serial.SerialException, termios.error):
            port.set_low_latency_mode(True)  # not every driver has it
    os.set_blocking(port.fileno(), False)
    return port


def _reason(port: str, error: Exception) -> str:
    if not Path(port).exists():
        return "no such device; is the adapter plugged in, and line.port right?"
    if isinstance(error, PermissionError) or getattr(error, "errno", None) == 13:
        return "permission denied; the user of the gateway must be in the group that owns the device (dialout)"
    holder = _holder(port)
    if "exclusively lock" in str(error) or getattr(error, "errno", None) in (11, 16):
        return f"in use by {holder or 'another process'}; two masters on one line cannot work: end the other one"
    return str(error)


def _holder(port: str) -> str | None:
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


def _is_pty(port: str) -> bool:
    with contextlib.suppress(OSError):
        return os.major(Path(port).stat().st_rdev) in PTY_MAJORS
    return False


def _connect(line: site.Line) -> socket.socket:
    host, port = address(line.port.removeprefix("socket://"))
    try:
        connection = socket.create_connection((host, port), CONNECT_TIMEOUT)
    except (OSError, UnicodeError) as error:
        raise LineDown(f"{line.port}: {error}; is the serial server on, and line.port right?") from error
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setblocking(False)
    return connection


class DescriptorLine:
    """A line behind a file descriptor; see gateway.bus.line.Line for the contract."""

    def __init__(
        self, name: str, opened: serial.Serial | socket.socket, timing: LineTiming, clock: Clock, *, is_pty: bool
    ) -> None:
        self.name = name
        self.is_pty = is_pty
        self._opened = opened
        self._fd: int = opened.fileno()
        self._timing = timing
        self._clock = clock
        self._alarm = clock.alarm()
        self._loop = asyncio.get_running_loop()
        self._arrived = bytearray()
        self._waiter: asyncio.Future[None] | None = None
        self._failure: LineDown | None = None
        self._is_closed = False
        self._quiet_since = clock.now()
        self._loop.add_reader(self._fd, self._take)

    async def quiet(self) -> float:
        """Wait for the gap; return since when the line is quiet (monotonic)."""
        self._check()
        patience = self._clock.now() + NEVER_QUIET
        while (when := self._quiet_since + self._timing.gap) > self._clock.now():
            if when > patience:
                raise BadReply(f"{self.name}: the line is never quiet: something babbles, or another master talks")
            await self._alarm.wait_until(when)  # what arrives meanwhile moves the end of the gap
            self._check()
        return self._quiet_since

    async def write(self, frame: bytes, not_after: float = math.inf) -> float:
        """Wait for the gap, discard what has arrived, send; return when the first bit left (monotonic)."""
        await self.quiet()
        self._arrived.clear()
        begun = self._clock.now()
        if begun > not_after:
            raise TooLate(f"{self.name}: the line was free too late")
        try:
            sent = os.write(self._fd, frame)
        except OSError as error:
            raise self._fail(f"cannot send: {error.strerror}") from error
        if sent != len(frame):
            raise self._fail(f"took {sent} of {len(frame)} bytes")
        self._quiet_since = begun + self._timing.request(len(frame))
        return begun

    async def read(self, deadline: float) -> bytes:
        """Return what arrives next, b"" when nothing has arrived by the deadline (monotonic seconds)."""
        self._check()
        if not self._arrived and (left := deadline - self._clock.now()) > 0:
            self._waiter = self._loop.create_future()
            timer = self._loop.call_later(left, self._wake)
            try:
                await self._waiter
            finally:
                timer.cancel()
                self._waiter = None
            self._check()
        data = bytes(self._arrived)
        self._arrived.clear()
        return data

    async def drain(self, silence: float, limit: float) -> int:
        """Throw away what arrives until `silence` seconds are quiet, or `limit` seconds are over; count it."""
        end = self._clock.now() + limit
        thrown = 0
        while (now := self._clock.now()) < end:
            data = await self.read(min(now + silence, end))
            if not data:
                break
            thrown += len(data)
        return thrown

    def close(self) -> None:
        """Close the port."""
        if self._is_closed:
            return
        self._is_closed = True
        self._loop.remove_reader(self._fd)
        self._alarm.close()
        with contextlib.suppress(OSError, serial.SerialException, termios.error):
            self._opened.close()

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _fail(self, reason: str) -> LineDown:
        if self._failure is None:
            self._failure = LineDown(f"{self.name}: {reason}")
            self._loop.remove_reader(self._fd)
        return self._failure

    def _take(self) -> None:
        """Take what the kernel has; the gap counts from now, the latest that the last character can have ended."""
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._fail(f"gone: {error.strerror}")
        else:
            if data:
                self._quiet_since = max(self._quiet_since, self._clock.now())
                if len(self._arrived) < READ_SIZE:
                    self._arrived += data
            else:
                self._fail("closed by the other side")
        self._wake()

    def _wake(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)
