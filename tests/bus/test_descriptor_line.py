"""The port itself: a frame leaves after the gap, and not after its time."""

from __future__ import annotations

import asyncio
import socket

import pytest

from gateway.bus.serial_line import DescriptorLine
from gateway.clock import SystemClock
from gateway.errors import TooLate
from gateway.protocol.timing import LineTiming


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
