"""A serial device or a serial server as a line: opening, the gap, reading and writing; the only I/O of the bus."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import os
import socket
import termios
from dataclasses import dataclass
from pathlib import Path

import serial

from gateway import site
from gateway.bus.adapter import (
    NotSwitched,
    Rts,
    RtsSwitch,
    end_kernel_mode,
    is_kernel_mode,
    keep_levels_after_close,
    set_kernel_mode,
    set_low_latency,
)
from gateway.bus.holder import holder
from gateway.bus.rfc2217 import ComPort
from gateway.bus.serial_server import connect, is_on_this_machine
from gateway.clock import Clock
from gateway.errors import BadReply, LineDown, TooLate
from gateway.protocol.timing import LineTiming

log = logging.getLogger("gateway.bus")

READ_SIZE = 4096  # bytes taken from the port at once; an answer has at most 64
NEVER_QUIET = 1.0  # seconds without a gap, after which waiting for one is given up
NEVER_SENT = 0.1  # seconds after its computed end in which a frame must have left
SENT_STEP = 0.0002  # seconds between two looks whether it has
PTY_MAJORS = range(136, 144)  # Linux device numbers of pseudo-terminals

PARITIES = {"even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD, "none": serial.PARITY_NONE}


async def open_line(line: site.Line, clock: Clock) -> DescriptorLine:
    """Open the port of a line, exclusively; LineDown says why not, and who holds it."""
    if line.is_network:
        connection, com_port = await connect(line, _stop_bits(line.parity))
        port = DescriptorLine(line.port, connection, line.timing, clock, is_pty=False, com_port=com_port)
        port.may_be_simulated = is_on_this_machine(connection)
        return port
    loop = asyncio.get_running_loop()
    device = await loop.run_in_executor(None, _open_device, line)
    return DescriptorLine(line.port, device.port, line.timing, clock, is_pty=_is_pty(line.port), switching=device)


@dataclass(frozen=True, slots=True)
class Device:
    """A serial device that is open, and how it switches between sending and receiving.

    `delay` is what the driver waits for before each first bit, in seconds; `switch` is RTS, where the gateway has it.
    """

    port: serial.Serial
    is_low_latency: bool | None = None
    delay: float = 0.0
    switch: RtsSwitch | None = None


def _stop_bits(parity: str) -> int:
    """Return 2 where there is no parity bit: a character has 11 bits either way."""
    return 2 if parity == "none" else 1


def _open_device(line: site.Line) -> Device:
    """Open a serial device: 8 bits, the configured parity; 2 stop bits where there is no parity bit.

    A pseudo-terminal drops parity and refuses a change that changes nothing else: it is opened as 8N2.
    """
    is_pty = _is_pty(line.port)
    parity = "none" if is_pty else line.parity
    port = serial.Serial(
        None, line.baud, parity=PARITIES[parity], stopbits=_stop_bits(parity), timeout=0, exclusive=True
    )
    port.port = line.port
    if line.rs485 in ("kernel", "rts"):
        port.rts = not line.rts_on_send  # a transceiver does not see it change while the port is opened
    try:
        port.open()
    except (OSError, serial.SerialException, termios.error, ValueError) as error:
        raise LineDown(f"{line.port}: {_reason(line.port, error)}") from error
    try:
        os.set_blocking(port.fileno(), False)
        return _set_up(port, line, is_pty=is_pty)
    except NotSwitched as error:
        port.close()
        raise LineDown(f"{line.port}: {error}") from error
    except (OSError, termios.error) as error:
        port.close()
        raise LineDown(f"{line.port}: {_reason(line.port, error)}") from error


def _set_up(port: serial.Serial, line: site.Line, *, is_pty: bool) -> Device:
    """Have the line switched as configured, and nothing held back; NotSwitched where that is not to be had."""
    fd, rts = port.fileno(), Rts(line.rts_on_send, line.rts_delay_before, line.rts_delay_after)
    switch, delay = None, 0.0
    if line.rs485 == "kernel":
        set_kernel_mode(fd, line.port, rts, hears_itself=line.local_echo == "on")
        delay = rts.delay_before
    elif line.rs485 != "auto":
        end_kernel_mode(fd, line.port)
    elif is_kernel_mode(fd):
        log.info("line %s: the kernel's driver switches the line, as the system has set it", line.name)
    if line.rs485 == "rts":
        switch = RtsSwitch(fd, rts)
        switch.check(line.port)
        if not rts.on_send:
            keep_levels_after_close(fd)
    if is_pty:
        return Device(port, None, delay, switch)
    latency = set_low_latency(fd, line.port)
    if latency.is_low is False:
        log.warning("line %s: %s: %s; %s", line.name, line.port, latency.said, latency.remedy)
    else:
        log.info("line %s: %s: %s", line.name, line.port, latency.said)
    return Device(port, latency.is_low, delay, switch)


def _reason(port: str, error: Exception) -> str:
    if not Path(port).exists():
        return "no such device; is the adapter plugged in, and line.port right?"
    if isinstance(error, PermissionError) or getattr(error, "errno", None) == 13:
        return "permission denied; the user of the gateway must be in the group that owns the device (dialout)"
    if "exclusively lock" in str(error) or getattr(error, "errno", None) in (11, 16):
        who = holder(port) or "another process"
        return f"in use by {who}; two masters on one line cannot work: end the other one"
    return str(error)


def _is_pty(port: str) -> bool:
    with contextlib.suppress(OSError):
        return os.major(Path(port).stat().st_rdev) in PTY_MAJORS
    return False


class DescriptorLine:
    """A line behind a file descriptor; see gateway.bus.line.Line for the contract."""

    def __init__(
        self,
        name: str,
        opened: serial.Serial | socket.socket,
        timing: LineTiming,
        clock: Clock,
        *,
        is_pty: bool,
        switching: Device | None = None,
        com_port: ComPort | None = None,
    ) -> None:
        self.name = name
        self.is_pty = is_pty
        self.may_be_simulated = is_pty
        self.is_low_latency = switching.is_low_latency if switching else None
        self._opened = opened
        self._fd: int = opened.fileno()
        self._timing = timing
        self._clock = clock
        self._alarm = clock.alarm()
        self._loop = asyncio.get_running_loop()
        self._delay = switching.delay if switching else 0.0
        self._switch = switching.switch if switching else None
        self._com_port = com_port
        self._arrived = bytearray()
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
        if self._switch is None:
            return self._send(frame, not_after)
        try:
            return await self._switched(self._switch, frame, not_after)
        except OSError as error:
            raise self._fail(f"cannot switch RTS: {error.strerror}") from error

    async def _switched(self, switch: RtsSwitch, frame: bytes, not_after: float) -> float:
        """Send a frame with RTS round it: from before its first bit until its last has left."""
        switch.send()
        try:
            await self._pause(self._clock.now() + switch.rts.delay_before)
            begun = self._send(frame, not_after)
            await self._pause(self._quiet_since)
            patience = self._quiet_since + NEVER_SENT
            while not switch.has_sent() and self._clock.now() < patience:
                await self._pause(self._clock.now() + SENT_STEP)
            await self._pause(self._clock.now() + switch.rts.delay_after)
        finally:
            switch.receive()
        return begun

    async def _pause(self, when: float) -> None:
        while self._clock.now() < when:
            await self._alarm.wait_until(when)
            self._check()

    def _send(self, frame: bytes, not_after: float) -> float:
        """Hand a frame to the port, in one piece; return when its first bit leaves. TooLate: it was not sent."""
        self._arrived.clear()
        data = self._com_port.escaped(frame) if self._com_port else frame
        begun = self._clock.now() + self._delay
        if begun > not_after:
            raise TooLate(f"{self.name}: the line was free too late")
        try:
            sent = os.write(self._fd, data)
        except OSError as error:
            raise self._fail(f"cannot send: {error.strerror}") from error
        if sent != len(data):
            raise self._fail(f"took {sent} of {len(data)} bytes")
        self._quiet_since = begun + self._timing.request(len(frame))
        return begun

    async def read(self, deadline: float) -> bytes:
        """Return what arrives next, b"" when nothing has arrived by the deadline (monotonic seconds)."""
        self._check()
        while not self._arrived and self._clock.now() < deadline:
            await self._alarm.wait_until(deadline)  # not by the loop's timers: uvloop's count whole milliseconds
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
            if not data:
                self._fail("closed by the other side")
            elif self._com_port is not None and not (data := self._of_line(self._com_port, data)):
                return
            if data:
                self._quiet_since = max(self._quiet_since, self._clock.now())
                if len(self._arrived) < READ_SIZE:
                    self._arrived += data
        self._alarm.ring()

    def _of_line(self, com_port: ComPort, data: bytes) -> bytes:
        """Return the bytes of the line in what a serial server sent, and answer the rest; fail with the server."""
        data = com_port.feed(data)
        if com_port.problem:
            self._fail(f"the serial server went on, but {com_port.problem}")
            self._alarm.ring()
            return b""
        if out := com_port.outgoing():
            with contextlib.suppress(OSError):  # what it means is seen at the next request
                os.write(self._fd, out)
        return data
