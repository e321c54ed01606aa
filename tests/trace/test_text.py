"""What people read of a frame: the drive, the register, the value, the times, the verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Exchanged,
    Group,
    Identify,
    Identity,
    Proportional,
    ReadBlock,
    ReadWords,
    Reply,
    Request,
    Words,
    WriteBlock,
    WriteRam,
    WriteStored,
    Written,
)
from gateway.protocol.registry import PROTOCOLS
from gateway.trace.frames import Frame, Way, frames
from gateway.trace.meaning import Meaning
from gateway.trace.packets import NAMES
from gateway.trace.record import Unasked, Verdict
from gateway.trace.text import bytes_of, line_of, pieces_of, remark
from tests.trace.plays import ANSWER, answered, record

DRIVE = {"name": "pump-1", "number": 1, "model": "vf-nc3"}


def meaning() -> Meaning:
    """Return what numbers mean on a line with one drive."""
    table: dict[str, Any] = {"gateway": {"name": "t"}, "line": [{"name": "a", "port": "/dev/null", "drive": [DRIVE]}]}
    return Meaning(site.build(table, "test", Path()).lines[0])


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (ReadWords(1, 0xFD00), "pump-1 read FD00 output_frequency"),
        (ReadWords(1, 0x0130, 3), "pump-1 read 3 from 0130"),
        (ReadWords(7, 0xFD00), "number 7 read FD00"),
        (ReadWords(None, 0xFD00), "drive read FD00"),
        (ReadBlock(1, 0x1875, 5), "pump-1 read block of 5"),
        (WriteRam(1, 0xFA01, 3000), "pump-1 write FA01 frequency_command = 0BB8"),
        (WriteRam(EVERY_DRIVE, 0xFA00, 0), "** write FA00 = 0000"),
        (WriteRam(Group(ones=2), 0xFA00, 0), "*2 write FA00 = 0000"),
        (WriteStored(1, 0x0803, 15), "pump-1 write stored 0803 communication_timeout = 000F"),
        (WriteBlock(1, 0x1870, (0xC400, 2500)), "pump-1 write block C400 09C4"),
        (Exchange(1, 0x1875, 5, 0x1870, (0xC400, 2500)), "pump-1 write block C400 09C4, read block of 5"),
        (Identify(1), "pump-1 identify"),
        (Proportional(1, 0xFA01, 5000), "pump-1 proportional FA01 = 1388"),
    ],
)
def test_a_request_in_words(request_: Request, text: str) -> None:
    """Every request that there is."""
    assert meaning().of_request(request_).startswith(text)


@pytest.mark.parametrize(
    ("request_", "reply", "text"),
    [
        (ReadWords(1, 0xFD00), Words((6000,)), "pump-1 output_frequency 60.00 Hz"),
        (ReadWords(1, 0xFD00), Words((6000,), True), "pump-1 output_frequency 60.00 Hz (tripped)"),
        (ReadWords(1, 0xFD00, 2), Words((6000, 0xC000)), "pump-1 output_frequency 60.00 Hz, status C000"),
        (ReadWords(7, 0xFD00), Words((6000,)), "number 7 1770"),
        (ReadBlock(1, 0x1875, 2), Words((1, 2)), "pump-1 0001 0002"),
        (WriteRam(1, 0xFA01, 1), Written(), "pump-1 written"),
        (WriteBlock(1, 0x1870, (1, 2)), Written((1,)), "pump-1 written, not written: 2"),
        (Exchange(1, 0x1875, 2, 0x1870, (1,)), Exchanged((5, 6), (0,)), "pump-1 0005 0006, not written: 1"),
        (Identify(1), Identity("TOSHIBA", "VFnC3-2007P", "0100"), "pump-1 TOSHIBA VFnC3-2007P 0100"),
    ],
)
def test_a_reply_in_words(request_: Request, reply: Reply, text: str) -> None:
    """Every reply that there is; values in their units."""
    assert meaning().of_reply(request_, reply) == text


def test_a_line_has_time_line_direction_bytes_meaning_times_and_verdict() -> None:
    """A request and its answer."""
    request, answer = (line_of(frame) for frame in frames("a", answered(), meaning(), 1_772_357_390.0))
    assert request == (
        "2026-03-01T09:30:00.005000Z a -> 01 03 FD 00 00 01 B5 A6  "
        "pump-1 read FD00 output_frequency, gap 2.50 ms: answered"
    )
    assert answer == (
        "2026-03-01T09:30:00.020000Z a <- 01 03 02 17 70 B6 50  "
        "pump-1 output_frequency 60.00 Hz, 15.00 ms after the request"
    )


def test_what_went_wrong_stands_at_the_end_with_its_reason() -> None:
    """With the request; what came instead says what it is."""
    told = record((10.02, ANSWER[:4]), verdict=Verdict.BAD_REPLY, note="4 bytes that are no answer")
    request, answer = (remark(frame) for frame in frames("a", told, Meaning(), 0.0))
    assert request.endswith(": bad reply: 4 bytes that are no answer")
    assert answer == "15.00 ms after the request: bad reply"
    (stray,) = frames("a", Unasked(10.0, b"\xff"), Meaning(), 0.0)
    assert remark(stray) == "noise"


@pytest.mark.parametrize(
    ("data", "text"), [(b"(01RFD00)\r", "(01RFD00)"), (b"(\x1b[2J\r", "28 1B 5B 32 4A 0D"), (b"2F", "32 46")]
)
def test_ascii_frames_are_text_unless_they_would_drive_the_terminal(data: bytes, text: str) -> None:
    """Control characters are shown in hexadecimal."""
    assert bytes_of(Frame("a", Way.ANSWER, 0.0, 0.0, data, "toshiba-ascii", Verdict.ANSWERED)) == text


def test_the_pieces_are_those_that_came() -> None:
    """With their times from the beginning of the request."""
    told = record((10.01, ANSWER[:3]), (10.02, ANSWER[3:]))
    assert pieces_of("a", told) == [
        "a tx 01 03 FD 00 00 01 B5 A6",
        "a rx 01 03 02 at 10.00 ms",
        "a rx 17 70 B6 50 at 20.00 ms",
    ]
    assert pieces_of("a", Unasked(1.0, b"\xff")) == ["a rx FF between two exchanges"]


def test_every_protocol_is_known_to_the_packets() -> None:
    """None is shown without a name."""
    assert set(NAMES) - {""} == set(PROTOCOLS)
