"""Writes of one client: their order, their ids, how many may be under way, and what is left of them when it goes."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Coroutine

import pytest

from gateway.control.command import Channel, Source
from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.connection import DRAIN_WITHIN, IN_FLIGHT, source_of
from gateway.modbus_tcp.gateway_unit import UNIT
from gateway.modbus_tcp.session import Reply
from tests import virtual
from tests.modbus_tcp.rig import REFUSED_AT_ONCE, Desk, Rig, Wire, answer, answers, read, request, write

FREQUENCY = 0xFA01
ECHO = struct.pack(">BHH", 6, FREQUENCY, 3000)


def desk_rig() -> tuple[Rig, Desk]:
    """Return a rig whose unit 1 takes writes."""
    desk = Desk()
    return Rig(writers={1: desk, UNIT: desk}), desk


def ids(wire: Wire) -> list[int]:
    """Return the transaction ids answered so far, in their order."""
    return [transaction for transaction, _, _ in answers(wire.sent)]


async def finish(desk: Desk, place: int = 0, code: ExceptionCode | None = None) -> None:
    """Let a write end, and its answer be sent."""
    desk.finish(place, code)
    await asyncio.sleep(0)


def run(script: Coroutine[None, None, None]) -> None:
    """Run a script in virtual time."""
    virtual.run(script)


def test_a_write_is_answered_when_the_drive_has_answered() -> None:
    """Nothing before; its own id, unit and echo then."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(write(0x1234, 1, FREQUENCY, 3000))
        assert desk.begun == [ECHO]
        assert wire.sent == b""
        await finish(desk)
        assert answers(wire.sent) == [(0x1234, 1, ECHO)]
        assert rig.stats.tcp.requests == {6: 1}

    run(script())


def test_a_refusal_is_answered_with_its_code_and_counted() -> None:
    """86H and the exception."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(write(1, 1, FREQUENCY, 3000))
        await finish(desk, code=ExceptionCode.SERVER_DEVICE_BUSY)
        assert answers(wire.sent) == [(1, 1, b"\x86\x06")]
        assert rig.stats.tcp.exceptions == {6: 1}

    run(script())


@pytest.mark.hazard("H26")
def test_answers_keep_the_order_of_the_requests_whatever_ends_first() -> None:
    """The second write is done first, a third is refused at once, reads stand between: 1 to 5 it is."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(
            write(1, 1, FREQUENCY, 1)
            + read(2, 1, 0xFD00, 1)
            + write(3, 1, FREQUENCY, 2)
            + write(4, 1, REFUSED_AT_ONCE, 0)
            + read(5, 2, 0xFD00, 1)
        )
        assert len(desk.begun) == 3
        await finish(desk, 1)
        assert ids(wire) == []
        await finish(desk, 0)
        assert ids(wire) == [1, 2, 3, 4, 5]
        assert [pdu[0] for _, _, pdu in answers(wire.sent)] == [6, 3, 6, 0x86, 0x83]

    run(script())


def test_a_read_behind_a_write_sees_what_the_write_did() -> None:
    """It is made when the write has been answered, not when it came."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(read(9, 1, 0xFD00, 1))  # known from now on: the short way must not overtake
        wire.writes.clear()
        wire.connection.data_received(write(1, 1, FREQUENCY, 3000))
        wire.connection.data_received(read(2, 1, 0xFD00, 1))
        assert wire.sent == b""
        answer(rig.image.by_unit[1], output_frequency=1234)
        await finish(desk)
        assert answers(wire.sent)[1] == (2, 1, b"\x03\x02" + struct.pack(">H", 1234))

    run(script())


@pytest.mark.hazard("H29")
def test_a_stop_begins_though_the_command_in_front_of_it_is_not_answered() -> None:
    """Only its answer waits; where it ends the other command, both are answered in order."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(read(1, 1, 0xFD00, 1) + write(2, 1, FREQUENCY, 1) + write(3, 1, 0xFA00, 0x8000))
        assert ids(wire) == [1]
        assert [pdu[1:3] for pdu in desk.begun] == [b"\xfa\x01", b"\xfa\x00"]
        await finish(desk, code=ExceptionCode.SERVER_DEVICE_BUSY)
        await finish(desk)
        assert ids(wire) == [1, 2, 3]

    run(script())


def test_a_command_that_ends_another_while_it_begins_keeps_the_order() -> None:
    """The answers of both leave behind what stands in front of them in the same segment."""

    class Stopping(Desk):
        def write(self, pdu: bytes, source: Source, reply: Reply) -> float:
            for _, waiting in self.pending:
                waiting(ExceptionCode.SERVER_DEVICE_BUSY)
            self.pending.clear()
            return super().write(pdu, source, reply)

    async def script() -> None:
        desk = Stopping()
        rig = Rig(writers={1: desk})
        wire = rig.connect()
        wire.connection.data_received(read(1, 1, 0xFD00, 1) + write(2, 1, FREQUENCY, 1) + write(3, 1, 0xFA00, 0x8000))
        assert ids(wire) == [1, 2]
        await finish(desk)
        assert ids(wire) == [1, 2, 3]

    run(script())


@pytest.mark.hazard("H25")
def test_at_most_sixteen_requests_are_in_flight() -> None:
    """The seventeenth is not even begun, and nothing is read; each answer makes room for one."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(b"".join(write(i, 1, FREQUENCY, i) for i in range(40)))
        for done in range(24):
            assert len(desk.begun) == IN_FLIGHT + done
            assert len(desk.pending) == IN_FLIGHT
            assert wire.is_reading_paused
            await finish(desk)
            await asyncio.sleep(0)
        assert not wire.is_reading_paused
        while desk.pending:
            await finish(desk)
        assert ids(wire) == list(range(40))

    run(script())


@pytest.mark.hazard("H25")
def test_reads_behind_a_write_count_as_in_flight() -> None:
    """They wait in memory too."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(
            write(0, 1, FREQUENCY, 1) + b"".join(read(i, 1, 0xFD00, 1) for i in range(1, 100))
        )
        assert len(wire.connection._owed) == IN_FLIGHT
        assert wire.is_reading_paused
        await finish(desk)
        for _ in range(10):
            await asyncio.sleep(0)
        assert ids(wire) == list(range(100))
        assert not wire.is_reading_paused

    run(script())


@pytest.mark.hazard("H26")
def test_every_split_of_a_stream_with_writes() -> None:
    """Wherever it is cut: the same writes, in the same order, and the same answers."""
    stream = (
        write(1, 1, FREQUENCY, 1)
        + read(2, 1, 0xFD00, 4)
        + request(3, 1, bytes.fromhex("10FA00000204C4000BB8"))
        + request(4, UNIT, bytes.fromhex("17F00000028000000102 0001"))
        + request(5, 1, bytes([0x2B, 0x0E, 1, 0]))
        + write(6, 2, FREQUENCY, 1)
    )

    async def fed(*pieces: bytes) -> tuple[list[bytes], bytes]:
        rig, desk = desk_rig()
        wire = rig.connect()
        for piece in pieces:
            wire.connection.data_received(piece)
        while desk.pending:
            await finish(desk)
        return desk.begun, wire.sent

    async def script() -> None:
        whole = await fed(stream)
        assert [transaction for transaction, _, _ in answers(whole[1])] == [1, 2, 3, 4, 5, 6]
        assert len(whole[0]) == 3
        for at in range(1, len(stream)):
            assert await fed(stream[:at], stream[at:]) == whole
        assert await fed(*(bytes([byte]) for byte in stream)) == whole

    run(script())


def test_what_takes_long_is_acknowledged_and_its_result_goes_nowhere() -> None:
    """05 when the client's time is up; the late result is not sent on top of it."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(write(1, 1, FREQUENCY, 1) + read(2, 1, 0xFD00, 1))
        await asyncio.sleep(desk.patience - 0.01)
        assert wire.sent == b""
        await asyncio.sleep(0.02)
        assert [(i, pdu[:2]) for i, _, pdu in answers(wire.sent)] == [(1, b"\x86\x05"), (2, b"\x03\x02")]
        await finish(desk)
        assert ids(wire) == [1, 2]

    run(script())


def test_no_timer_is_left_by_what_was_answered_in_time() -> None:
    """Neither by a client that has gone."""

    async def script() -> None:
        rig, desk = desk_rig()
        first, second = rig.connect(), rig.connect()
        loop = asyncio.get_running_loop()
        before = len([handle for handle in loop._scheduled if not handle.cancelled()])  # type: ignore[attr-defined]
        first.connection.data_received(write(1, 1, FREQUENCY, 1))
        second.connection.data_received(write(1, 1, FREQUENCY, 1))
        await finish(desk)
        second.abort()
        after = [handle for handle in loop._scheduled if not handle.cancelled()]  # type: ignore[attr-defined]
        assert len(after) == before

    run(script())


@pytest.mark.parametrize("end", ["abort", "wrong header"])
def test_the_result_of_a_client_that_has_gone_goes_nowhere(end: str) -> None:
    """No error, no write to a closed socket; nothing is undone, and its place is free."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(write(1, 1, FREQUENCY, 1) + read(2, 1, 0xFD00, 1))
        if end == "abort":
            wire.abort()
        else:
            wire.connection.data_received(b"GET / HTTP/1.1\r\n")
            assert wire.is_closed
            wire.connection.connection_lost(None)
        await finish(desk)
        await asyncio.sleep(5.0)
        assert wire.sent == b""
        assert not rig.places.taken
        assert rig.stats.tcp.requests == {}

    run(script())


def test_nothing_is_written_to_a_transport_that_is_closing() -> None:
    """It has failed, and the loop has not said so yet."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(write(1, 1, FREQUENCY, 1))
        wire.is_closed = True
        await finish(desk)
        assert wire.sent == b""

    run(script())


def test_a_client_that_ends_its_stream_is_still_answered() -> None:
    """As with printf | nc: the connection closes behind the last answer."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(write(1, 1, FREQUENCY, 1) + write(2, 1, FREQUENCY, 2))
        assert wire.connection.eof_received() is True
        await finish(desk)
        assert not wire.is_closed
        await finish(desk)
        assert ids(wire) == [1, 2]
        assert wire.is_closed

    run(script())


def test_a_client_that_ends_its_stream_with_much_in_flight_gets_all_of_it() -> None:
    """Forty writes, half a request behind them, and the end."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(b"".join(write(i, 1, FREQUENCY, i) for i in range(40)) + b"\0\0\0")
        assert wire.connection.eof_received() is True
        while desk.pending:
            await finish(desk)
            await asyncio.sleep(0)
        assert ids(wire) == list(range(40))
        assert wire.is_closed

    run(script())


@pytest.mark.hazard("H25")
def test_a_client_that_writes_and_never_reads_is_cut() -> None:
    """What is under way ends in its buffer; nothing more is begun for it, and its time is over after 4 s."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.is_read = False
        burst = b"".join(read(i, UNIT, 0, 64) for i in range(600))
        wire.connection.data_received(burst + b"".join(write(i, 1, FREQUENCY, i) for i in range(40)))
        for _ in range(100):
            await asyncio.sleep(0)
        assert wire.is_reading_paused
        assert desk.begun == []
        rig.clock.moment += DRAIN_WITHIN + 0.1
        assert wire.connection.overdue(rig.clock.moment, 60.0) is not None
        wire.connection.cut("test")
        assert not rig.places.taken

    run(script())


@pytest.mark.hazard("H25")
def test_answers_of_writes_wait_for_a_client_that_reads_late() -> None:
    """Its buffer was full when they came; they are sent all the same, and it goes on afterwards."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(b"".join(write(i, 1, FREQUENCY, i) for i in range(20)))
        wire.connection.pause_writing()
        while desk.pending:
            await finish(desk)
        await asyncio.sleep(0)
        assert len(desk.begun) == IN_FLIGHT
        wire.connection.resume_writing()
        assert len(desk.begun) == 20
        while desk.pending:
            await finish(desk)
        await asyncio.sleep(0)
        assert ids(wire) == list(range(20))
        assert not wire.is_reading_paused

    run(script())


def test_waiting_for_a_drive_is_not_idling() -> None:
    """The answer counts as a sign of life of the connection."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(write(1, 1, FREQUENCY, 1))
        rig.clock.moment += 50.0
        await finish(desk)
        rig.clock.moment += 50.0
        assert wire.connection.overdue(rig.clock.moment, 60.0) is None

    run(script())


@pytest.mark.hazard("H27")
@pytest.mark.parametrize(("unit", "code"), [(0, 0x0A), (2, 0x01), (99, 0x0A)])
def test_a_write_to_who_is_not_there_or_takes_none(unit: int, code: int) -> None:
    """Nobody is asked; 0 is no broadcast."""

    async def script() -> None:
        rig, desk = desk_rig()
        wire = rig.connect()
        wire.connection.data_received(write(1, unit, FREQUENCY, 1))
        assert answers(wire.sent) == [(1, unit, bytes([0x86, code]))]
        assert desk.begun == []

    run(script())


def test_two_connections_of_one_host_are_one_source() -> None:
    """By address, without the port; other hosts are others."""

    async def script() -> None:
        rig, desk = desk_rig()
        for peer in ("10.0.0.7", "10.0.0.7", "10.0.0.8"):
            rig.connect(peer).connection.data_received(write(1, 1, FREQUENCY, 1))
        assert desk.sources[0] == desk.sources[1] == Source(Channel.MODBUS_TCP, "10.0.0.7")
        assert desk.sources[2] != desk.sources[0]

    run(script())


@pytest.mark.parametrize(
    ("peer", "name"),
    [
        (("10.0.0.7", 5020), "10.0.0.7"),
        (("::ffff:10.0.0.7", 5020, 0, 0), "10.0.0.7"),
        (("fe80::1%eth0", 5020, 0, 2), "fe80::1"),
        (("2001:DB8::0001", 5020, 0, 0), "2001:db8::1"),
        (("", 0), ""),
        (None, ""),
    ],
)
def test_a_source_is_named_by_its_address(peer: tuple[str, ...] | None, name: str) -> None:
    """The same host has one name, whether it came by IPv4 or by an IPv6 socket."""
    assert source_of(peer) == Source(Channel.MODBUS_TCP, name)
