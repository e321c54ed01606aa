"""The port itself: a frame leaves after the gap, and not after its time."""

from __future__ import annotations

import asyncio
import socket

import pytest

from gateway.bus.rfc2217 import ComPort, Settings
from gateway.bus.serial_line import DescriptorLine
from gateway.clock import SystemClock
from gateway.errors import LineDown, TooLate
from gateway.protocol.timing import LineTiming

LIMIT = 5.0  # seconds after which a wait is given up


@pytest.mark.hazard("H11")
async def test_what_is_not_to_leave_after_a_time_does_not() -> None:
    """The gap behind the first frame ends after it: the other end has the first and the third one only."""
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    clock, timing = SystemClock(), LineTiming(19200)
    line = DescriptorLine("wire", ours, timing, clock, is_pty=False)
    with theirs:
        begun = await line.write(b"1st")
        with pytest.raises(TooLate):
            await line.write(b"2nd", begun)
        await line.write(b"3rd", clock.now() + 60.0)
        line.close()
        assert await asyncio.to_thread(theirs.recv, 100) == b"1st3rd"


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ("FF FA 2C 65 00 00 25 80 FF F0", "its baud rate is 9600 and not 19200"),  # SET-BAUDRATE
        ("FF FA 2C 67 01 FF F0", "its parity is none and not even"),  # SET-PARITY
        ("FF FE 2C", "refuses RFC 2217"),  # DONT COM-PORT-OPTION
        ("FF FA 2C 6B" + "00" * 100, "does not end"),  # NOTIFY-MODEMSTATE without IAC SE
    ],
)
async def test_a_serial_server_that_becomes_unusable_takes_the_line_down(said: str, reason: str) -> None:
    """While an answer is awaited, at once; and whatever is done with the line next."""
    ours, theirs = socket.socketpair()
    ours.setblocking(False)
    clock, com_port = SystemClock(), ComPort(Settings(19200, "even", 1))
    line = DescriptorLine("wire", ours, LineTiming(19200), clock, is_pty=False, com_port=com_port)
    with theirs:
        reading = asyncio.create_task(line.read(clock.now() + 3 * LIMIT))
        await asyncio.sleep(0)
        theirs.sendall(bytes.fromhex(said))
        with pytest.raises(LineDown, match=reason):
            await asyncio.wait_for(reading, LIMIT)
        with pytest.raises(LineDown, match=reason):
            await line.write(b"1st")
        line.close()
