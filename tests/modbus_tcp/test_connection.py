"""One connection: splits and merges, turns, limits and time-outs, without a socket."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.image import LinkState
from gateway.modbus_tcp import responder
from gateway.modbus_tcp.connection import DRAIN_WITHIN, IN_FLIGHT, WRITE_BUFFER
from tests.modbus_tcp.rig import Desk, Rig, Wire, answer, answers, read, request, until, write

IDLE = 60.0
STREAM = b"".join(
    [
        read(1, 1, 0xFD00, 4),
        read(2, 2, 0xFD00, 1),
        request(3, 1, bytes([0x2B, 0x0E, 1, 0])),
        request(4, 1, bytes([16, 0xFA, 0, 0, 1, 2, 0, 0])),
        read(5, 255, 0, 64),
        request(6, 99, b"\x07"),
        read(7, 1, 0xFFFF, 1, 4),
    ]
)


def whole() -> bytes:
    """Return what the stream is answered when it comes in one piece."""
    wire = Rig().connect()
    wire.connection.data_received(STREAM)
    return wire.sent


@pytest.mark.hazard("H26")
def test_merged_requests_are_answered_in_one_write_and_in_order() -> None:
    """Seven requests in one segment: seven answers, each with its transaction id."""
    wire = Rig().connect()
    wire.connection.data_received(STREAM)
    assert [transaction for transaction, _, _ in answers(wire.sent)] == [1, 2, 3, 4, 5, 6, 7]
    assert len(wire.writes) == 1


@pytest.mark.hazard("H26")
@pytest.mark.parametrize("at", range(1, len(STREAM)))
def test_every_split_point(at: int) -> None:
    """Two pieces give the same answers as one."""
    wire = Rig().connect()
    wire.connection.data_received(STREAM[:at])
    wire.connection.data_received(STREAM[at:])
    assert wire.sent == whole()


@pytest.mark.hazard("H26")
def test_byte_by_byte() -> None:
    """The smallest pieces; each request is answered with its last byte."""
    wire = Rig().connect()
    for byte in STREAM:
        wire.connection.data_received(bytes([byte]))
    assert wire.sent == whole()
    assert len(wire.writes) == 7


@pytest.mark.hazard("H26")
@given(st.lists(st.integers(0, len(STREAM)), max_size=12).map(sorted))
def test_any_pieces(cuts: list[int]) -> None:
    """However the stream is cut."""
    wire = Rig().connect()
    for start, end in zip([0, *cuts], [*cuts, len(STREAM)], strict=True):
        if start < end:
            wire.connection.data_received(STREAM[start:end])
    assert wire.sent == whole()


@pytest.mark.hazard("H25")
async def test_sixteen_in_flight_are_answered_at_once_and_the_others_in_turn() -> None:
    """Two connections with 40 requests each take turns; nothing is read meanwhile, nothing is lost."""
    rig = Rig()
    first, second = rig.connect(), rig.connect()
    burst = b"".join(read(i, 1, 0xFD00, 4) for i in range(40))
    first.connection.data_received(burst)
    second.connection.data_received(burst)
    for _ in range(3):
        assert len(first.writes) == len(second.writes)
        assert len(answers(first.writes[-1])) <= IN_FLIGHT
        await asyncio.sleep(0)
    for wire in (first, second):
        assert [len(answers(write)) for write in wire.writes] == [16, 16, 8]
        assert [transaction for transaction, _, _ in answers(wire.sent)] == list(range(40))
        assert not wire.is_reading_paused


async def test_reading_stops_while_requests_wait() -> None:
    """What may wait is bounded by one read of the socket."""
    wire = Rig().connect()
    wire.connection.data_received(b"".join(read(i, 1, 0xFD00, 4) for i in range(17)))
    assert wire.is_reading_paused
    await asyncio.sleep(0)
    assert not wire.is_reading_paused


async def test_a_piece_that_comes_while_requests_wait_keeps_its_place() -> None:
    """A loop may deliver once more after it was asked not to."""
    wire = Rig().connect()
    wire.connection.data_received(b"".join(read(i, 1, 0xFD00, 4) for i in range(20)))
    wire.connection.data_received(read(20, 1, 0xFD00, 4)[:5])
    await asyncio.sleep(0)
    wire.connection.data_received(read(20, 1, 0xFD00, 4)[5:])
    assert [transaction for transaction, _, _ in answers(wire.sent)] == list(range(21))


@pytest.mark.hazard("H19")
@pytest.mark.parametrize("function", [3, 4])
def test_a_request_that_is_known_is_answered_from_the_image_as_it_is_now(function: int) -> None:
    """Its own transaction id, the new value, and no value at all when that is old or the line is down."""
    rig = Rig()
    wire, drive = rig.connect(), rig.image.by_unit[1]

    def ask(transaction: int) -> bytes:
        wire.writes.clear()
        wire.connection.data_received(read(transaction, 1, 0xFD00, 1, function))
        ((told, _, pdu),) = answers(wire.sent)
        assert told == transaction
        return pdu

    assert ask(1) == ask(2) == bytes([function, 2, 0x17, 0x70])
    answer(drive, output_frequency=1)
    assert ask(3) == bytes([function, 2, 0, 1])
    rig.clock.moment += 1.1
    assert ask(4) == bytes([function | 0x80, 0x0B])
    answer(drive, rig.clock.moment, output_frequency=2)
    assert ask(5) == bytes([function, 2, 0, 2])
    drive.set_link(LinkState.LINE_DOWN)
    assert ask(6) == bytes([function | 0x80, 0x0A])
    assert rig.stats.tcp.requests == {function: 6}


@pytest.mark.hazard("H26")
async def test_an_answer_is_returned_where_nothing_stands_in_front_of_it() -> None:
    """Else it is written, in its order: behind half a request, behind a write, and while nothing may be sent."""
    rig, desk = Rig(), Desk()
    rig.writers[1] = desk
    wire = rig.connect()
    again = read(2, 1, 0xFD00, 1)
    now = rig.clock.now()
    assert wire.connection.answer_now(read(1, 1, 0xFD00, 1), now) is None  # asked for the first time
    assert wire.connection.answer_now(again, now) == b"\0\2" + wire.sent[2:]
    assert len(wire.writes) == 1
    assert wire.connection.answer_now(again[:7], now) is None
    assert wire.connection.answer_now(again[7:] + again, now) is None
    assert [transaction for transaction, _, _ in answers(wire.sent)] == [1, 2, 2]
    assert wire.connection.answer_now(write(3, 1, 0xFA01, 5), now) is None
    assert wire.connection.answer_now(again, now) is None
    assert len(answers(wire.sent)) == 3
    desk.finish()
    await asyncio.sleep(0)
    assert [transaction for transaction, _, _ in answers(wire.sent)] == [1, 2, 2, 3, 2]
    wire.connection.pause_writing()
    assert wire.connection.answer_now(again, now) is None
    assert len(answers(wire.sent)) == 5
    wire.connection.resume_writing()
    assert len(answers(wire.sent)) == 6


def test_an_answer_that_is_returned_keeps_the_connection_alive() -> None:
    """As of the turn's moment."""
    rig = Rig()
    wire = rig.connect()
    wire.connection.data_received(read(1, 1, 0xFD00, 1))
    assert wire.connection.answer_now(read(2, 1, 0xFD00, 1), rig.clock.now() + 0.5) is not None
    assert wire.connection.overdue(rig.clock.now() + IDLE + 0.5, IDLE) is None
    assert wire.connection.overdue(rig.clock.now() + IDLE + 0.6, IDLE) is not None


def test_requests_that_are_known_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond the limit all is answered as before."""
    monkeypatch.setattr(responder, "KNOWN_AT_MOST", 3)
    rig = Rig()
    wire = rig.connect()
    for round_ in range(2):
        for start in range(64):
            wire.connection.data_received(read(round_, 255, start, 1))
    assert len(answers(wire.sent)) == 128
    assert len(rig.responder._known) == 3


@pytest.mark.hazard("H25")
def test_a_known_request_counts_against_a_client_that_does_not_read() -> None:
    """The short way stops where the long one does."""
    rig = Rig()
    wire = rig.connect()
    wire.is_read = False
    asked = 0
    while not wire.is_reading_paused:
        wire.connection.data_received(read(7, 255, 0, 64))
        asked += 1
    wire.connection.data_received(read(8, 255, 0, 64))
    assert len(answers(wire.sent)) == asked
    wire.fetch()
    assert len(answers(wire.sent)) == asked + 1


@pytest.mark.hazard("H26")
def test_a_wrong_header_closes_behind_the_answers() -> None:
    """What was right in front of it is answered; nothing that comes later is."""
    wire = Rig().connect()
    wire.connection.data_received(read(1, 1, 0xFD00, 1) + b"GET / HTTP/1.1\r\n")
    assert [transaction for transaction, _, _ in answers(wire.sent)] == [1]
    assert wire.is_closed
    assert not wire.is_cut


@pytest.mark.hazard("H25")
async def test_a_client_that_does_not_read_is_served_no_further_and_cut() -> None:
    """At most 64 KiB and one turn wait for it; after 4 s it is overdue."""
    rig = Rig()
    wire = rig.connect()
    wire.is_read = False
    burst = b"".join(read(i, 255, 0, 64) for i in range(2000))
    wire.connection.data_received(burst)
    before = -1
    while before != len(wire.writes):
        before = len(wire.writes)
        await asyncio.sleep(0)
    turn = IN_FLIGHT * (9 + 128)
    assert WRITE_BUFFER < wire.waiting <= WRITE_BUFFER + turn
    assert wire.is_reading_paused
    rig.clock.moment += DRAIN_WITHIN
    assert wire.connection.overdue(rig.clock.moment, IDLE) is None
    rig.clock.moment += 0.001
    assert "not read" in (wire.connection.overdue(rig.clock.moment, IDLE) or "")
    wire.connection.cut("test")
    assert wire.is_cut


@pytest.mark.hazard("H25")
async def test_a_client_that_reads_in_time_gets_everything() -> None:
    """It is served on as it reads, and no longer overdue."""
    rig = Rig()
    wire = rig.connect()
    wire.is_read = False
    wire.connection.data_received(b"".join(read(i, 255, 0, 64) for i in range(2000)))
    await until(lambda: wire.waiting > WRITE_BUFFER)
    rig.clock.moment += DRAIN_WITHIN
    wire.fetch()
    rig.clock.moment += DRAIN_WITHIN
    await until(lambda: not wire.is_reading_paused)
    assert [transaction for transaction, _, _ in answers(wire.sent)] == list(range(2000))
    assert wire.connection.overdue(rig.clock.moment, IDLE) is None


@pytest.mark.hazard("H25")
async def test_a_client_that_has_not_read_its_last_answers_is_not_read_from() -> None:
    """Nothing waits but answers: it may go on asking when it has read them."""
    wire = Rig().connect()
    wire.is_read = False
    asked = 0
    while not wire.is_reading_paused:
        wire.connection.data_received(request(asked, 1, bytes([0x2B, 0x0E, 1, 0])))
        asked += 1
    assert len(answers(wire.sent)) == asked
    wire.fetch()
    assert not wire.is_reading_paused
    wire.connection.data_received(request(asked, 1, bytes([0x2B, 0x0E, 1, 0])))
    assert len(answers(wire.sent)) == asked + 1


@pytest.mark.hazard("H25")
def test_only_a_whole_request_keeps_a_connection_alive() -> None:
    """A byte now and then does not hold a place."""
    rig = Rig()
    wire = rig.connect()
    asked = read(1, 1, 0xFD00, 1)
    rig.clock.moment += 50
    wire.connection.data_received(asked[:-1])
    rig.clock.moment += 11
    assert wire.connection.overdue(rig.clock.moment, IDLE) == "no request for 60 s"
    wire.connection.data_received(asked[-1:])
    assert wire.connection.overdue(rig.clock.moment, IDLE) is None


@pytest.mark.hazard("H25")
def test_the_client_beyond_the_limit_is_closed_at_once() -> None:
    """It is counted, and the others keep their places; the next one comes in when one has left."""
    rig = Rig(limit=2)
    first, second, third = rig.connect(), rig.connect(), rig.connect()
    assert (first.is_closed, second.is_closed, third.is_cut) == (False, False, True)
    assert (rig.stats.tcp.connections, rig.stats.tcp.accepted, rig.stats.tcp.turned_away) == (2, 2, 1)
    first.connection.connection_lost(None)
    assert not rig.connect().is_closed
    assert (rig.stats.tcp.connections, rig.stats.tcp.accepted) == (2, 3)


def test_the_warning_that_places_are_taken_is_given_once(caplog: pytest.LogCaptureFixture) -> None:
    """A client that tries again every second does not fill the log."""
    rig = Rig(limit=1)
    rig.connect()
    for _ in range(5):
        rig.connect()
    assert [record.levelname for record in caplog.records] == ["WARNING"]


async def test_a_client_that_ends_its_stream_still_gets_what_waits() -> None:
    """The connection closes behind the last answer."""
    wire = Rig().connect()
    wire.connection.data_received(b"".join(read(i, 1, 0xFD00, 4) for i in range(20)))
    assert wire.connection.eof_received() is True
    await asyncio.sleep(0)
    assert len(answers(wire.sent)) == 20
    assert wire.is_closed


def test_a_client_that_ends_its_stream_is_closed_where_nothing_waits() -> None:
    """The transport does it."""
    wire: Wire = Rig().connect()
    assert wire.connection.eof_received() is False


async def test_a_turn_that_comes_after_the_end_does_nothing() -> None:
    """The connection was lost between two turns."""
    rig = Rig()
    wire = rig.connect()
    wire.connection.data_received(b"".join(read(i, 1, 0xFD00, 4) for i in range(20)))
    wire.abort()
    await asyncio.sleep(0)
    assert len(answers(wire.sent)) == 16
    assert not rig.places.taken
