from __future__ import annotations

import os
import struct
from pathlib import Path

import pytest

from gateway.errors import GatewayError
from gateway.sim.capture import Capture, header, protocol, record
from gateway.sim.control import REQUEST
from gateway.sim.doings import BeginFault
from gateway.sim.journal import Entry, Way
from gateway.sim.options import MODBUS_RTU, TOSHIBA
from gateway.sim.settings import SimulatedLineConfig, from_options, install
from tests.sim.rig import binary, checked, framed
from tests.sim.test_wire import ANSWER, READ, heard


def test_a_file_begins_as_the_format_says() -> None:
    """Little-endian, microseconds, whole packets, IPv4 (www.tcpdump.org/linktypes.html: 228)."""
    assert header() == bytes.fromhex("D4C3B2A1 0200 0400 00000000 00000000 FFFF0000 E4000000")


def test_a_request_goes_from_the_master_to_the_line() -> None:
    """At its end, counted from when the line was opened."""
    written = record(Entry(Way.REQUEST, 1002.0, 1002.25, READ), 1000.0, MODBUS_RTU)
    seconds, microseconds, size, whole = struct.unpack("<IIII", written[:16])
    packet = written[16:]
    assert (seconds, microseconds, size, whole) == (2, 250_000, 36, 36)
    assert len(packet) == size
    assert (packet[0], packet[2:4], packet[9]) == (0x45, b"\0\x24", 17)  # IPv4, 36 bytes, UDP
    assert (packet[12:16], packet[16:20]) == (bytes((192, 0, 2, 1)), bytes((192, 0, 2, 2)))
    assert struct.unpack(">HHH", packet[20:26]) == (40_000, 502, 16)
    assert packet[28:] == READ


@pytest.mark.parametrize(("spoken", "port"), [(MODBUS_RTU, 502), (TOSHIBA, 829)])
def test_the_port_of_the_line_tells_the_protocol(spoken: int, port: int) -> None:
    """The answer comes from there."""
    packet = record(Entry(Way.HEARD, 0.0, 0.0, ANSWER), 0.0, spoken)[16:]
    assert struct.unpack(">HH", packet[20:24]) == (port, 40_000)


WHOLE = [
    *[(frame, MODBUS_RTU) for frame in (READ, ANSWER, framed("03 02 0000", 40), framed("83 02", 47))],
    *[(frame, TOSHIBA) for frame in (b"(RFD00)\r", b"(RFD000BB8)\r", b"(N0002\r", checked("01RFD00"))],
    *[(binary(body), TOSHIBA) for body in ("52 FD00", "01 52 FD00 0BB8", "59 02 00 0000 0BB8", "4E 00 04")],
]


@pytest.mark.parametrize("way", [Way.REQUEST, Way.HEARD])
@pytest.mark.parametrize("before", [MODBUS_RTU, TOSHIBA])
@pytest.mark.parametrize(("frame", "spoken"), WHOLE)
def test_a_whole_frame_tells_its_protocol(way: Way, before: int, frame: bytes, spoken: int) -> None:
    """By its check or stop code, whatever came before; MODBUS-RTU of number 40 or 47 begins as TOSHIBA does."""
    assert protocol(Entry(way, 0.0, 0.0, frame), before) == spoken


@pytest.mark.parametrize("before", [MODBUS_RTU, TOSHIBA])
@pytest.mark.parametrize("frame", [ANSWER[:3], b"RFD000BB8)\r", b"(RFD0", binary("52 FD00 0BB8")[:-1], bytes(5)])
def test_a_broken_answer_is_of_the_frame_before_it(before: int, frame: bytes) -> None:
    """That is its request: an answer of number 40 that is cut short is not TOSHIBA for its first byte."""
    assert protocol(Entry(Way.HEARD, 0.0, 0.0, frame), before) == before


@pytest.mark.parametrize("frame", [b"(RFD0", b"/RFD", binary("52 FD00") + binary("52 FD01") + b"/"])
def test_a_broken_request_with_a_start_code_is_toshiba(frame: bytes) -> None:
    """Nothing before it speaks for it."""
    assert protocol(Entry(Way.REQUEST, 0.0, 0.0, frame), MODBUS_RTU) == TOSHIBA


def test_what_is_no_frame_is_kept_short() -> None:
    """Junk without end fits into a packet."""
    assert len(record(Entry(Way.REQUEST, 0.0, 0.0, bytes(100_000)), 0.0, MODBUS_RTU)) == 16 + 28 + 4096


def line_ports(path: Path) -> list[int]:
    """Return the port of the line in each packet of a capture."""
    data, ports = path.read_bytes()[len(header()) :], []
    while data:
        size = struct.unpack("<I", data[8:12])[0]
        ports.append(min(struct.unpack(">HH", data[36:40])))
        data = data[16 + size :]
    return ports


@pytest.mark.parametrize(
    ("drive", "asked", "port"),
    [
        ("1:vf-nc3:toshiba", b"(01RFD00)\r", 829),
        ("1:vf-nc3:toshiba", binary("01 52 FD00"), 829),
        ("1:vf-nc3", READ, 502),
    ],
)
def test_what_is_broken_on_a_line_goes_the_way_of_the_line(
    tmp_path: Path, drive: str, asked: bytes, port: int
) -> None:
    """Noise before the first request, and an answer of which two bytes, or none of the first ones, are left."""
    line = install(from_options([drive]), 0.0)
    line.capture(tmp_path / "line.pcap")
    line.wire.babble(5, 0.0)
    list(heard(line.wire, 1.0))
    for begin, fault in ((1.0, {"kind": "truncate", "value": 2}), (2.0, {"kind": "babble"})):
        request = REQUEST.validate_python({"do": "fault", "count": 1, **fault})
        assert isinstance(request, BeginFault)
        line.do(request, begin)
        line.wire.feed(asked, begin)
        list(heard(line.wire, begin + 0.9))
    line.capture(None)
    assert line_ports(tmp_path / "line.pcap") == [port] * 5


def test_a_capture_has_what_is_on_the_line_and_ends_when_told(tmp_path: Path) -> None:
    """Requests and what the master hears, not what a fault took or what was done; nothing before and behind."""
    path = tmp_path / "line.pcap"
    events = [
        {"at": "1s", "do": "capture", "file": str(path)},
        {"at": "2s", "do": "fault", "kind": "drop", "count": 1},
        {"at": "4s", "do": "capture"},
    ]
    table = {"drive": [{"number": 1, "model": "vf-nc3"}], "event": events}
    wire = install(SimulatedLineConfig.model_validate(table), 0.0).wire
    for begin in range(6):
        wire.feed(READ, begin + 0.5)
        list(heard(wire, begin + 1.0))
    data, frames = path.read_bytes()[len(header()) :], []
    while data:
        size = struct.unpack("<I", data[8:12])[0]
        frames.append(data[16 + 28 : 16 + size])
        data = data[16 + size :]
    assert frames == [READ, ANSWER, READ, READ, ANSWER]


def test_a_second_capture_ends_the_first(tmp_path: Path) -> None:
    """Frames go to one file at a time."""
    line = install(SimulatedLineConfig.model_validate({"drive": [{"number": 1, "model": "vf-nc3"}]}), 0.0)
    first, second = tmp_path / "first.pcap", tmp_path / "second.pcap"
    line.capture(first)
    line.capture(second)
    line.wire.feed(READ, 0.0)
    line.wire.due(1.0)
    line.capture(None)
    assert first.read_bytes() == header()
    assert len(second.read_bytes()) > len(header())


def test_a_capture_that_can_be_written_no_more_ends_the_line_with_its_reason(tmp_path: Path) -> None:
    """A capture with holes would be believed."""
    os.mkfifo(tmp_path / "line.pcap")
    reader = os.open(tmp_path / "line.pcap", os.O_RDONLY | os.O_NONBLOCK)
    capture = Capture(tmp_path / "line.pcap", 0.0)
    os.close(reader)
    with pytest.raises(GatewayError, match=r"the capture cannot be written: .*Broken pipe"):
        capture.write(Entry(Way.HEARD, 0.0, 0.0, ANSWER))
    capture.close()
