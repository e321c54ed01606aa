"""A capture is what the format says: blocks, options, interfaces, times; and each packet names its dissector."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.trace import packets, pcapng
from gateway.trace.capture import Capture
from gateway.trace.frames import Frame, Way
from gateway.trace.record import Verdict

READ = bytes.fromhex("01 03 FD 00 00 01 B5 A6")
ANSWER = bytes.fromhex("01 03 02 17 70 B6 50")


def blocks(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield kind and body of each block; both lengths of each must be there, and multiples of four."""
    while data:
        kind, size = struct.unpack("<II", data[:8])
        assert size % 4 == 0
        assert data[size - 4 : size] == data[4:8]
        yield kind, data[8 : size - 4]
        data = data[size:]


def options(data: bytes) -> dict[int, bytes]:
    """Return the options at the end of a block, by code; the end must be told."""
    found: dict[int, bytes] = {}
    while True:
        code, size = struct.unpack("<HH", data[:4])
        if code == 0:
            assert (size, data[4:]) == (0, b"")
            return found
        found[code] = data[4 : 4 + size]
        data = data[4 + size + -size % 4 :]


def frame(way: Way = Way.REQUEST, data: bytes = READ, verdict: Verdict = Verdict.ANSWERED, **more: Any) -> Frame:
    """Return a frame of line a."""
    return replace(Frame("a", way, 1.0, 2.0, data, "modbus-rtu", verdict), **more)


def test_a_file_begins_with_its_section_and_an_interface_for_each_line() -> None:
    """Little-endian, version 1.0, length not known beforehand; times in nanoseconds (draft-ietf-opsawg-pcapng 4)."""
    found = list(blocks(Capture(["a", "b"]).begin("why")))
    assert [kind for kind, _ in found] == [0x0A0D0D0A, 1, 1]
    assert found[0][1][:16] == bytes.fromhex("4D3C2B1A 0100 0000 FFFFFFFFFFFFFFFF")
    assert options(found[0][1][16:])[1] == b"why"
    for name, (_, body) in zip((b"a", b"b"), found[1:], strict=True):
        assert struct.unpack("<HHI", body[:8]) == (252, 0, 65_535)
        assert (options(body[8:])[2], options(body[8:])[9]) == (name, b"\x09")


def test_a_packet_has_its_line_its_time_its_direction_and_its_verdict() -> None:
    """The time in two halves, of the end of the frame; direction in the flags; the rest in words."""
    asked = frame(line="b", end=1_772_357_400.123456, gap=0.00201, meaning="pump-1 read FD00")
    ((kind, body),) = blocks(Capture(["a", "b"]).packets([asked]))
    place, high, low, kept, size = struct.unpack("<IIIII", body[:20])
    assert (kind, place, kept) == (6, 1, size)
    assert (high << 32) + low == 1_772_357_400_123_456_000
    found = options(body[20 + size + -size % 4 :])
    assert found[2] == struct.pack("<I", 2)  # outbound
    assert found[1] == b"pump-1 read FD00, gap 2.01 ms: answered"


def test_a_damaged_answer_is_marked_and_given_as_bytes() -> None:
    """Inbound, with the sign of a wrong CRC, for the dissector "data": it is not dissected as what it is not."""
    ((_, body),) = blocks(Capture(["a"]).packets([frame(Way.ANSWER, ANSWER[:4], Verdict.BAD_REPLY)]))
    size = struct.unpack("<I", body[12:16])[0]
    assert options(body[20 + size + -size % 4 :])[2] == struct.pack("<I", 1 | 1 << 24)
    assert body[20:].startswith(bytes.fromhex("000C 0004") + b"data")


def test_a_packet_of_a_line_that_the_file_does_not_know_is_left_out() -> None:
    """It could be told from no other."""
    assert Capture(["b"]).packets([frame()]) == b""


def tags(packet: bytes) -> tuple[dict[int, bytes], bytes]:
    """Return the tags of a packet, by code, and what is behind them."""
    found: dict[int, bytes] = {}
    while True:
        code, size = struct.unpack(">HH", packet[:4])
        if code == 0:
            return found, packet[4:]
        found[code] = packet[4 : 4 + size]
        packet = packet[4 + size :]


@pytest.mark.parametrize(
    ("protocol", "dissector", "port"),
    [
        ("modbus-rtu", b"mbrtu", 502),
        *[(name, b"data", 829) for name in ("toshiba-ascii", "toshiba-binary", "")],
    ],
)
def test_a_packet_names_the_dissector_and_goes_from_the_gateway_to_the_line(
    protocol: str, dissector: bytes, port: int
) -> None:
    """Addresses of RFC 5737; an answer goes the other way."""
    asked, data = tags(packets.packet(3, protocol, READ, is_request=True))
    assert data == READ
    assert asked[12].rstrip(b"\0") == dissector
    assert (asked[20], asked[21]) == (bytes((192, 0, 2, 1)), bytes((192, 0, 2, 5)))
    assert (asked[25], asked[26]) == (struct.pack(">I", 40_000), struct.pack(">I", port))
    answer, _ = tags(packets.packet(3, protocol, ANSWER, is_request=False))
    assert (answer[20], answer[21], answer[25], answer[26]) == (asked[21], asked[20], asked[26], asked[25])


@given(st.binary(max_size=200), st.text(max_size=200), st.floats(0, 4e9))
def test_whatever_is_written_can_be_read_back(data: bytes, comment: str, time: float) -> None:
    """Blocks stay aligned for every length."""
    ((_, body),) = blocks(pcapng.packet(0, time, data, pcapng.INBOUND, comment))
    assert body[20 : 20 + len(data)] == data
    found = options(body[20 + len(data) + -len(data) % 4 :])
    assert found.get(1, b"") == comment.encode()[: pcapng.LONGEST_OPTION]
