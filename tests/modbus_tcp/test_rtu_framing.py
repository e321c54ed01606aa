"""MODBUS-RTU over TCP: frames in any pieces, what closes the connection, and a foreign client."""

from __future__ import annotations

import asyncio
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus import FramerType
from pymodbus.client import AsyncModbusTcpClient

from gateway.config import ModbusTcpSection
from gateway.metrics import LineStats, Stats
from gateway.modbus_tcp.listeners import RtuListener
from gateway.modbus_tcp.rtu_connection import RtuConnection
from gateway.modbus_tcp.rtu_framing import LONGEST, RtuFraming, framed
from gateway.modbus_tcp.server import ModbusTcpServer
from gateway.protocol.checksum import crc16
from tests.modbus_tcp.plant import Listening, exchange, several
from tests.modbus_tcp.rig import Rig, StandingClock, Wire, fresh_image, read, request, until
from tests.soak import FACTOR

LIMIT = 20.0  # seconds for anything to happen
IDENTIFY = b"\x2b\x0e\x01\x00"


def frame(unit: int, pdu: bytes) -> bytes:
    """Write a frame as it is on a serial line."""
    body = bytes((unit,)) + pdu
    return body + crc16(body)


def pdu_of(start: int, count: int, function: int = 3) -> bytes:
    """Write a request to read."""
    return struct.pack(">BHH", function, start, count)


REQUESTS = [
    (1, pdu_of(0xFD00, 4)),
    (2, pdu_of(0xFD00, 1, 4)),
    (1, several(0xFA00, 0, 0)),
    (1, exchange(0xFD00, 1, 0xFA00, 1, 2, 3)),
    (1, IDENTIFY),
    (1, struct.pack(">BHH", 6, 0xFA00, 0)),
    (99, b"\x07"),
    (1, b"\x0f\0\0\0\x03\x01\x05"),
    (1, b"\x64\x01\x02\x03"),
    (255, pdu_of(0, 16)),
]
STREAM = b"".join(frame(*each) for each in REQUESTS)
AS_TCP = b"".join(request(0, *each) for each in REQUESTS)


def connect(rig: Rig) -> Wire:
    """Open a connection that speaks RTU."""
    wire = Wire()
    wire.connection = RtuConnection(rig.responder, rig.clock, rig.places, rig.writers)
    wire.connection.connection_made(wire)
    return wire


def whole() -> bytes:
    """Return what the stream is answered in one piece."""
    wire = connect(Rig())
    wire.connection.data_received(STREAM)
    assert not wire.is_closed
    return wire.sent


def test_frames_are_the_requests_of_modbus_tcp_without_a_header() -> None:
    """And answers lose theirs."""
    framing = RtuFraming()
    assert framing.receive(STREAM) == AS_TCP
    assert framing.out_of_step == ""
    assert framed(AS_TCP) == STREAM
    assert framed(b"") == b""


def test_the_answers_are_those_of_modbus_tcp() -> None:
    """Word for word, each with its CRC, in order."""
    rig = Rig()
    plain = rig.connect()
    plain.connection.data_received(AS_TCP)
    assert whole() == framed(plain.sent)


@pytest.mark.hazard("H26")
@pytest.mark.parametrize("at", range(1, len(STREAM)))
def test_every_split_point(at: int) -> None:
    """Two pieces give the same answers as one."""
    wire = connect(Rig())
    wire.connection.data_received(STREAM[:at])
    wire.connection.data_received(STREAM[at:])
    assert wire.sent == whole()


@pytest.mark.hazard("H26")
@given(st.lists(st.integers(0, len(STREAM)), max_size=20).map(sorted))
def test_any_pieces(cuts: list[int]) -> None:
    """However the stream is cut, byte by byte too."""
    for places in (cuts, range(len(STREAM))):
        wire = connect(Rig())
        for start, end in zip([0, *places], [*places, len(STREAM)], strict=True):
            if start < end:
                wire.connection.data_received(STREAM[start:end])
        assert wire.sent == whole()


@pytest.mark.hazard("H27")
def test_a_request_to_all_is_not_answered_and_nothing_is_done() -> None:
    """As on a serial line; what comes behind it is answered."""
    made = Listening()
    wire = Wire()
    wire.connection = made.server._connection(RtuConnection)
    wire.connection.connection_made(wire)
    to_all = frame(0, several(0xFA00, 0x8000)) + frame(0, pdu_of(0, 1))
    wire.connection.data_received(to_all + frame(255, pdu_of(0, 1)))
    assert wire.sent == frame(255, b"\x03\x02\0\0")
    assert made.door.asked == []


@pytest.mark.hazard("H26")
@pytest.mark.parametrize(
    "wrong",
    [
        frame(1, pdu_of(0xFD00, 1))[:-1] + b"\0",
        read(1, 1, 0xFD00, 1),  # MODBUS-TCP
        b"GET / HTTP/1.1\r\n\r\n" + bytes(300),
        bytes([1, 16, 0xFA, 0, 0, 1, 255]),
        b"\x01\x64" + bytes(LONGEST),
        frame(1, pdu_of(0xFD00, 1))[1:] + frame(1, pdu_of(0xFD00, 1)) * 32,
        b"\x16\x03\x01\x02\0\x01\0\x01\xfc" + bytes(300),  # TLS
    ],
)
def test_a_stream_out_of_step_is_closed_behind_what_was_right(wrong: bytes) -> None:
    """Nothing that follows is answered or done, not even what would be right by itself."""
    wire = connect(Rig())
    good = frame(1, pdu_of(0xFD00, 1))
    wire.connection.data_received(good + wrong)
    assert wire.is_closed
    assert wire.sent == frame(1, b"\x03\x02\x17\x70")
    wire.connection.data_received(good)
    assert wire.sent == frame(1, b"\x03\x02\x17\x70")


@pytest.mark.hazard("H26")
def test_what_may_wait_for_the_end_of_a_frame_is_bounded() -> None:
    """By seed: no unexpected exception, and never more than a frame is kept."""
    chance = random.Random(26)
    for _ in range(3_000 * FACTOR):
        data = bytearray(STREAM)
        for _ in range(chance.randint(1, 5)):
            at = chance.randrange(len(data))
            data[at : at + chance.randint(0, 3)] = chance.randbytes(chance.randint(0, 3))
        framing = RtuFraming()
        while data and not framing.out_of_step:
            size = chance.randint(1, 80)
            requests = framing.receive(bytes(data[:size]))
            del data[:size]
            assert len(framing._received) <= LONGEST
            assert framed(requests) in STREAM or requests


@pytest.mark.hazard("H26")
@pytest.mark.parametrize("data", [frame(1, pdu_of(0xFD00, 1))[:-1], frame(1, pdu_of(0xFD00, 1))[1:]])
def test_a_frame_that_does_not_end_in_time_ends_the_connection(data: bytes) -> None:
    """A byte was lost: its master has given up long since, and comes again."""
    rig = Rig()
    wire = connect(rig)
    wire.connection.data_received(frame(1, pdu_of(0xFD00, 1)) + data)
    rig.clock.moment += 1.0
    assert wire.connection.overdue(rig.clock.moment, 60.0) is None
    wire.connection.data_received(b"")
    rig.clock.moment += 0.1
    assert wire.connection.overdue(rig.clock.moment, 60.0) == "a frame that has not ended within 1 s"


def test_what_is_asked_again_is_returned_as_a_frame_and_written_where_the_end_comes_behind_it() -> None:
    """By the short way as by the long one: the same frame, and before the connection closes."""
    rig = Rig()
    wire = connect(rig)
    asked, now = frame(1, pdu_of(0xFD00, 4)), rig.clock.now()
    assert wire.connection.answer_now(asked, now) is None
    told = wire.sent
    assert wire.connection.answer_now(asked, now) == told
    wire.connection.data_received(asked)
    assert wire.sent == told + told
    assert wire.connection.answer_now(asked + bytes(LONGEST + 1), now) is None
    assert wire.sent == told * 3
    assert wire.is_closed
    assert wire.connection.answer_now(asked, now) is None
    assert wire.sent == told * 3


@pytest.mark.hazard("H25")
def test_between_frames_the_idle_timeout_holds() -> None:
    """A frame in two pieces is whole."""
    rig = Rig()
    wire = connect(rig)
    for piece in (frame(1, pdu_of(0xFD00, 1))[:-1], frame(1, pdu_of(0xFD00, 1))[-1:]):
        wire.connection.data_received(piece)
    rig.clock.moment += 60
    assert wire.connection.overdue(rig.clock.moment, 60.0) is None
    rig.clock.moment += 1
    assert wire.connection.overdue(rig.clock.moment, 60.0) == "no request for 60 s"


@pytest.mark.e2e
async def test_pymodbus_by_rtu_over_tcp() -> None:
    """A foreign client with RTU frames; its writes come to the door, and limits are those of the whole server."""
    made = Listening()
    section = ModbusTcpSection.model_validate({"listen": "off", "rtu": {"listen": "127.0.0.1:0"}, "connections": 1})
    server = ModbusTcpServer(section, made.image, made.stats, made.clock, door=made.door)
    async with asyncio.timeout(LIMIT):
        await server.start()
        port = server.port_of(RtuListener)
        try:
            async with AsyncModbusTcpClient("127.0.0.1", port=port, framer=FramerType.RTU) as modbus:
                assert len((await modbus.read_holding_registers(0, count=16, device_id=255)).registers) == 16
                assert (await modbus.read_holding_registers(0xFD00, device_id=9)).exception_code == 0x0A
                asking = asyncio.create_task(modbus.write_register(0xFA01, 3000, device_id=1))
                await until(lambda: bool(made.door.asked))
                assert (await made.end()).words == (3000,)
                assert not (await asking).isError()
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                assert await reader.read() == b""
                writer.close()
        finally:
            await server.stop()


@pytest.mark.e2e
async def test_rights_hold_for_rtu_over_tcp() -> None:
    """They are those of clients without TLS."""
    rights = [{"functions": [3], "units": [1], "registers": [[0xFD00, 0xFD01]]}]
    section = ModbusTcpSection.model_validate({"listen": "off", "rtu": {"listen": "127.0.0.1:0"}, "right": rights})
    server = ModbusTcpServer(section, fresh_image(), Stats(0.0, {"a": LineStats()}), StandingClock())
    async with asyncio.timeout(LIMIT):
        await server.start()
        try:
            async with AsyncModbusTcpClient("127.0.0.1", port=server.port, framer=FramerType.RTU) as modbus:
                told = await modbus.read_holding_registers(0xFD00, count=2, device_id=1)
                assert told.registers == [6000, 3]
                assert (await modbus.read_holding_registers(0xFD00, count=3, device_id=1)).exception_code == 1
                assert (await modbus.read_input_registers(0xFD00, count=2, device_id=1)).exception_code == 1
        finally:
            await server.stop()
