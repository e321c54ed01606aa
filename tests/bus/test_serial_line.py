"""A port's line: RTS round each frame, what a driver adds, and ports that do not do as configured."""

from __future__ import annotations

import asyncio
import errno
import os
import pty
import socket
import termios
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.bus.adapter import Rts, RtsSwitch
from gateway.bus.serial_line import DescriptorLine, Device, open_line
from gateway.clock import SystemClock
from gateway.errors import LineDown
from gateway.protocol.timing import LineTiming
from tests import virtual

TIMING = LineTiming(19200)
FRAME = bytes.fromhex("01 03 FD 00 00 01 B5 A6")


class Transceiver:
    """A driver whose RTS switches a transceiver: when it did, in virtual time. RTS is asserted while sending."""

    def __init__(self) -> None:
        self.switched: list[tuple[float, bool]] = []
        self.is_gone = False
        self.looks_until_empty = 0

    def ioctl(self, fd: int, operation: int, buffer: array[int], mutate: bool) -> None:
        """Take a level of RTS, and tell after some looks that the frame has left."""
        if self.is_gone:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        if operation in (termios.TIOCMBIS, termios.TIOCMBIC):
            self.switched.append((asyncio.get_running_loop().time(), operation == termios.TIOCMBIS))
        else:
            buffer[0] = self.looks_until_empty <= 0
            self.looks_until_empty -= 1


def on_line(play: Callable[[DescriptorLine, Transceiver], Any], rts: Rts) -> Any:
    """Run a play on a line in virtual time, with a pair of sockets in place of the wire."""

    async def main() -> Any:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        transceiver = Transceiver()
        device = Device(ours, switch=RtsSwitch(ours.fileno(), rts, transceiver.ioctl))
        line = DescriptorLine("pair", ours, TIMING, virtual.VirtualClock(), is_pty=False, switching=device)
        with ours, theirs:
            try:
                return await play(line, transceiver)
            finally:
                line.close()

    return virtual.run(main())


@pytest.mark.parametrize("looks", [0, 5])
def test_rts_is_there_before_the_first_bit_and_until_the_last_has_left(looks: int) -> None:
    """And gone before a drive may answer; a driver that still sends is waited for."""

    async def play(line: DescriptorLine, transceiver: Transceiver) -> None:
        transceiver.looks_until_empty = looks
        begun = await line.write(FRAME)
        (on, is_on), (off, is_still_on) = transceiver.switched
        assert is_on
        assert not is_still_on
        sent = begun + TIMING.request(len(FRAME))
        assert on == pytest.approx(begun - 0.001)
        assert sent + 0.0005 <= off < sent + TIMING.gap

    on_line(play, Rts(True, 0.001, 0.0005))


def test_rts_is_let_go_when_a_request_is_broken_off() -> None:
    """A line that is left sending would silence everybody."""

    async def play(line: DescriptorLine, transceiver: Transceiver) -> None:
        writing = asyncio.create_task(line.write(FRAME))
        await asyncio.sleep(TIMING.gap + TIMING.request(2))
        assert [is_on for _, is_on in transceiver.switched] == [True]
        writing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await writing
        assert [is_on for _, is_on in transceiver.switched] == [True, False]

    on_line(play, Rts())


def test_an_adapter_that_goes_while_rts_is_switched_takes_the_line_down() -> None:
    """The port is opened again, as for any other loss."""

    async def play(line: DescriptorLine, transceiver: Transceiver) -> None:
        transceiver.is_gone = True
        with pytest.raises(LineDown, match="cannot switch RTS: Input/output error"):
            await line.write(FRAME)

    on_line(play, Rts())


def test_what_a_driver_waits_before_a_frame_counts_as_silence() -> None:
    """In the kernel's mode the first bit leaves that much later, and so does the last."""

    async def main() -> None:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        device = Device(ours, delay=0.003)
        line = DescriptorLine("pair", ours, TIMING, virtual.VirtualClock(), is_pty=False, switching=device)
        with ours, theirs:
            now = asyncio.get_running_loop().time
            await line.quiet()
            begun = await line.write(FRAME)
            assert begun == pytest.approx(now() + 0.003)
            await line.quiet()
            assert now() >= begun + TIMING.request(len(FRAME)) + TIMING.gap
            line.close()

    virtual.run(main())


def test_reading_ends_at_its_deadline_and_not_before() -> None:
    """Also where something rings the alarm and brings nothing."""

    async def main() -> None:
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        line = DescriptorLine("pair", ours, TIMING, virtual.VirtualClock(), is_pty=False)
        with ours, theirs:
            loop = asyncio.get_running_loop()
            deadline = loop.time() + 0.0123
            loop.call_later(0.005, line._alarm.ring)
            assert await line.read(deadline) == b""
            assert loop.time() == pytest.approx(deadline)
            loop.call_later(0.005, theirs.send, b"\1")
            assert await line.read(loop.time() + 1) == b"\1"
            line.close()

    virtual.run(main())


@pytest.fixture
def terminal() -> Iterator[str]:
    """Return the name of a pseudo-terminal: a device whose driver has neither RS485 nor RTS."""
    ours, theirs = pty.openpty()
    yield os.ttyname(theirs)
    os.close(theirs)
    os.close(ours)


def configured(port: str, **more: Any) -> site.Line:
    """Return a line of one drive behind a port."""
    drive = {"name": "d1", "number": 1, "model": "vf-nc3"}
    table = {"gateway": {"name": "t"}, "line": [{"name": "a", "port": port, "drive": [drive], **more}]}
    return site.build(table, "test", Path()).lines[0]


@pytest.mark.e2e
@pytest.mark.parametrize(("rs485", "said"), [("kernel", "has no RS485 mode"), ("rts", "does not set RTS")])
async def test_a_driver_that_cannot_switch_the_line_takes_it_down_with_what_to_do(
    terminal: str, rs485: str, said: str
) -> None:
    """The port, the driver, the reason, and the other settings; and it is given back."""
    with pytest.raises(LineDown, match=f"{terminal}: driver unknown {said}.*rs485 = "):
        await open_line(configured(terminal, rs485=rs485), SystemClock())
    for usable in ("auto", "off"):
        port = await open_line(configured(terminal, rs485=usable), SystemClock())
        assert port.is_low_latency is None
        port.close()
