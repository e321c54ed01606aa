"""Cases of docs/protocols.md that no other test shows: what the gateway puts on the line, and what it never does."""

from __future__ import annotations

import re
import socket
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.serial_line import DescriptorLine
from gateway.clock import SystemClock
from gateway.protocol.codec import Answering, Codec, NoSuchForm
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Identify,
    Proportional,
    ReadBlock,
    ReadWords,
    Request,
    WriteBlock,
    WriteRam,
    WriteStored,
)
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.timing import LineTiming
from gateway.sim.frames import is_whole
from tests.protocol.dialects import DIALECTS

MANUAL_ASCII = re.compile(rb"\(([0-9]{2}|[0-9]\*|\*[0-9]|\*\*)?(R[0-9A-F]{4}|[WP][0-9A-F]{8})&[0-9A-F]{2}\)\r")
BINARY_COMMANDS = set(b"RWPXSs")
FUNCTIONS = {0x03, 0x06, 0x10, 0x17, 0x2B}


@st.composite
def requests(draw: st.DrawFn) -> Request:
    """Make up a request of any protocol."""

    def pick(least: int, most: int) -> int:
        return draw(st.integers(least, most))

    return draw(st.sampled_from(DIALECTS)).request(pick)


@given(requests())
def test_what_is_sent_is_a_frame_of_the_manual_and_whole(request_: Request) -> None:
    """By the judgement of the simulated drive; a protocol that has no such request says so."""
    for codec in PROTOCOLS.values():
        try:
            frame = codec.encode(request_)
        except NoSuchForm:
            continue
        assert is_whole(frame)


@given(requests())
def test_no_other_command_is_sent(request_: Request) -> None:
    """ASCII: R, W, P with number, four digits, sum, stop code; binary: R, W, P, X, S, s; five functions of MODBUS."""
    for codec in PROTOCOLS.values():
        try:
            frame = codec.encode(request_)
        except NoSuchForm:
            continue
        if codec.name == "toshiba-ascii":
            assert MANUAL_ASCII.fullmatch(frame)
        elif codec.name == "toshiba-binary":
            assert frame[1 if request_.number is None else 2] in BINARY_COMMANDS
        else:
            assert frame[1] in FUNCTIONS


@pytest.mark.parametrize("codec", PROTOCOLS.values(), ids=PROTOCOLS)
@pytest.mark.parametrize(
    "request_",
    [
        ReadWords(EVERY_DRIVE, 0xFD00),
        ReadBlock(EVERY_DRIVE, 0x1875, 2),
        WriteRam(EVERY_DRIVE, 0xFA01, 100),
        WriteStored(EVERY_DRIVE, 0x0880, 1),
        WriteBlock(EVERY_DRIVE, 0x1870, (1, 2)),
        Exchange(EVERY_DRIVE, 0x1875, 2, 0x1870, (1, 2)),
        Identify(EVERY_DRIVE),
        Proportional(EVERY_DRIVE, 0xFA01, 100),
    ],
    ids=lambda request: type(request).__name__,
)
def test_no_answer_to_a_frame_for_all_is_a_fault(codec: Codec, request_: Request) -> None:
    """One drive may answer in TOSHIBA, none does in MODBUS-RTU: nobody is waited for in vain and called lost."""
    try:
        assert codec.answering(request_) is not Answering.ALWAYS
    except NoSuchForm:
        assert codec.name == "modbus-rtu" or not isinstance(request_, WriteRam | WriteStored)


@pytest.mark.e2e
@pytest.mark.parametrize("baud", [9600, 19200, 38400])
async def test_a_frame_leaves_in_one_piece_and_not_before_the_gap(baud: int) -> None:
    """One write each, on a socket that keeps pieces apart: nothing pauses for 1.5 characters inside a frame."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    ours.setblocking(False)
    timing = LineTiming(baud)
    line = DescriptorLine("pair", ours, timing, SystemClock(), is_pty=False)
    frames = [codec.encode(ReadWords(1, 0xFD00)) for codec in PROTOCOLS.values()]
    begins = [await line.write(frame) for frame in frames]
    line.close()
    with theirs:
        assert [theirs.recv(256) for _ in frames] == frames
    for frame, (begin, following) in zip(frames, pairwise(begins), strict=False):
        assert following - begin >= timing.request(len(frame)) + timing.gap
