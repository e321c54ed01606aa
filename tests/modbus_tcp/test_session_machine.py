"""Any history of one MODBUS-TCP client: each request that is accepted gets one answer, in order, or none is owed."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.connection import IN_FLIGHT, WRITE_BUFFER
from gateway.modbus_tcp.gateway_unit import UNIT
from tests.modbus_tcp.rig import REFUSED_AT_ONCE, Desk, Rig, Wire, answers, read, request, write
from tests.soak import FACTOR
from tests.virtual import VirtualLoop

IDLE = 60.0
SMALL_BUFFER = 2000  # bytes
KINDS = {
    "read": lambda i: read(i, 1, 0xFD00, 4),
    "big read": lambda i: read(i, UNIT, 0, 64),
    "refused read": lambda i: read(i, 2, 0xFD00, 1),
    "identification": lambda i: request(i, 1, bytes([0x2B, 0x0E, 1, 0])),
    "write": lambda i: write(i, 1, 0xFA01, i),
    "write refused at once": lambda i: write(i, 1, REFUSED_AT_ONCE, i),
    "write to nobody": lambda i: write(i, 0, 0xFA00, i),
}


class SmallWire(Wire):
    """A transport whose buffer is full after a few answers."""

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Take another limit."""
        assert high == WRITE_BUFFER
        self._high = SMALL_BUFFER


class Client(RuleBasedStateMachine):
    """One client that sends what it likes in any pieces, a desk that answers when it likes, and time that passes."""

    def __init__(self) -> None:
        super().__init__()
        self.loop = VirtualLoop()
        self.desk = Desk()
        self.rig = Rig(writers={1: self.desk})
        self.answered_before = 0
        self.connect()

    def connect(self) -> None:
        """Begin anew; results of what came before may still be on their way."""
        self.wire = SmallWire()
        self.rig.attach(self.wire)
        self.sent: list[str] = []  # the kinds of the requests handed to the connection
        self.told: dict[int, bytes] = {}  # by transaction: what the desk has answered
        self.has_ended = False

    def teardown(self) -> None:
        """Let everything come to its end: nothing may be owed for ever."""
        if not self.wire.is_closed and not self.wire.is_read:
            self.in_loop(self.wire.fetch)
        while self.desk.pending:
            self.in_loop(lambda: self.finish(0, None))
        self.in_loop(lambda: None, 5.0)
        if not self.wire.is_closed:
            assert [transaction for transaction, _, _ in answers(self.wire.sent)] == list(range(len(self.sent)))
            assert not self.wire.is_reading_paused
        self.loop.close()

    def finish(self, place: int, code: ExceptionCode | None) -> None:
        """Let the desk answer a write; its word is its transaction."""
        pdu, _ = self.desk.pending[place]
        transaction = int.from_bytes(pdu[3:5], "big")
        self.told.setdefault(transaction, pdu[:5] if code is None else bytes([pdu[0] | 0x80, code]))
        self.desk.finish(place, code)

    def in_loop(self, action: Any, seconds: float = 0.0) -> None:
        """Do something in the loop, and let it run: for no time, or for some."""

        async def doing() -> None:
            action()
            for _ in range(3):
                await asyncio.sleep(0)
            if seconds:
                await asyncio.sleep(seconds)

        self.loop.run_until_complete(doing())
        self.rig.clock.moment += seconds

    def is_open(self) -> bool:
        """Say whether the client can still send."""
        return not self.wire.is_closed and not self.has_ended

    @precondition(lambda self: self.wire.is_closed)
    @rule()
    def come_again(self) -> None:
        """Connect anew when what was under way has ended."""
        while self.desk.pending:
            self.in_loop(lambda: self.desk.finish())
        self.wire.connection.connection_lost(None)
        assert not self.rig.places.taken
        self.answered_before = sum(self.rig.stats.tcp.requests.values())
        self.connect()

    @precondition(is_open)
    @rule(kinds=st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=30), cuts=st.lists(st.floats(0, 1)))
    def send(self, kinds: list[str], cuts: list[float]) -> None:
        """Send requests, cut anywhere; the transport delivers nothing while its reading is paused."""
        if self.wire.is_reading_paused:
            return
        stream = b"".join(KINDS[kind](len(self.sent) + i) for i, kind in enumerate(kinds))
        self.sent += kinds
        places = sorted(int(cut * len(stream)) for cut in cuts[:4])
        for start, end in zip([0, *places], [*places, len(stream)], strict=True):
            if start < end:
                self.in_loop(lambda piece=stream[start:end]: self.wire.connection.data_received(piece))

    @precondition(is_open)
    @rule(kind=st.sampled_from(sorted(KINDS)))
    def send_one(self, kind: str) -> None:
        """Send one request, whole."""
        self.send([kind], [])

    @precondition(lambda self: self.desk.pending)
    @rule(data=st.data(), code=st.sampled_from([None, *ExceptionCode]))
    def answer(self, data: st.DataObject, code: ExceptionCode | None) -> None:
        """Let a write end, whichever."""
        place = data.draw(st.integers(0, len(self.desk.pending) - 1))
        self.in_loop(lambda: self.finish(place, code))

    @rule(seconds=st.sampled_from([0.1, 0.5, 1.0, 3.0]))
    def wait(self, seconds: float) -> None:
        """Let time pass: what takes longer than the client's patience is acknowledged."""
        self.in_loop(lambda: None, seconds)

    @precondition(is_open)
    @rule()
    def stop_reading(self) -> None:
        """Take no answers for a while."""
        self.wire.is_read = False

    @precondition(lambda self: not self.wire.is_read and not self.wire.is_closed)
    @rule()
    def read_again(self) -> None:
        """Take what waits."""
        self.in_loop(self.wire.fetch)

    @precondition(is_open)
    @rule(junk=st.sampled_from([b"GET / HTTP/1.1\r\n\r\n", b"\0\1\0\1\0\6\1\3\0\0\0\1", b"\0\1\0\0\0\0\1"]))
    def send_junk(self, junk: bytes) -> None:
        """Send what is no MODBUS-TCP: as soon as it is looked at, the connection closes."""
        if not self.wire.is_reading_paused:
            self.in_loop(lambda: self.wire.connection.data_received(junk))
            self.has_ended = True

    @precondition(is_open)
    @rule()
    def end(self) -> None:
        """Send no more."""
        if self.wire.is_reading_paused:
            return
        self.has_ended = True
        if not self.wire.connection.eof_received():
            self.wire.close()
            self.wire.connection.connection_lost(None)

    @precondition(lambda self: not self.wire.is_closed)
    @rule()
    def vanish(self) -> None:
        """Be gone."""
        self.in_loop(self.wire.abort)

    @precondition(lambda self: not self.wire.is_closed)
    @rule()
    def sweep(self) -> None:
        """Let the server look for those whose time is over."""
        reason = self.wire.connection.overdue(self.rig.clock.moment, IDLE)
        if reason is not None:
            assert "read" in reason
            assert not self.wire.is_read
            self.in_loop(lambda: self.wire.connection.cut(reason))

    @invariant()
    def answers_are_in_order_and_once(self) -> None:
        """Ids from 0 on, without a gap, and none that was not asked."""
        told = [transaction for transaction, _, _ in answers(self.wire.sent)]
        assert told == list(range(len(told)))
        assert len(told) <= len(self.sent)

    @invariant()
    def a_write_is_answered_as_it_ended(self) -> None:
        """Or, where that takes too long, by 05; never before it has ended."""
        for transaction, _, pdu in answers(self.wire.sent):
            if self.sent[transaction] == "write":
                assert pdu in (self.told.get(transaction), b"\x86\x05")

    @invariant()
    def every_answer_is_counted_once(self) -> None:
        """Those that wait for others are counted already."""
        count = sum(self.rig.stats.tcp.requests.values()) - self.answered_before
        ready = sum(owed.answer is not None for owed in self.wire.connection._owed)
        if not self.wire.is_closed:
            assert count == len(answers(self.wire.sent)) + ready

    @invariant()
    def at_most_sixteen_are_in_flight(self) -> None:
        """Also of those whose answers wait for others."""
        assert len(self.wire.connection._owed) <= IN_FLIGHT

    @invariant()
    def what_waits_for_a_client_is_bounded(self) -> None:
        """One turn beyond the buffer, and the answers in flight."""
        assert self.wire.waiting <= SMALL_BUFFER + 2 * IN_FLIGHT * 260

    @invariant()
    def nobody_waits_without_a_reason(self) -> None:
        """Pause reading only while answers are owed, the client does not read, or the next turn is coming."""
        if self.wire.is_reading_paused and not self.wire.is_closed:
            connection = self.wire.connection
            assert connection._owed or connection._blocked_at is not None or connection._is_next

    @invariant()
    def a_closed_connection_is_owed_nothing(self) -> None:
        """Its results go nowhere."""
        if self.wire.is_closed:
            assert not self.wire.connection._owed


TestClient = pytest.mark.hazard("H25")(pytest.mark.hazard("H26")(Client.TestCase))
TestClient.settings = settings(max_examples=60 * FACTOR, stateful_step_count=40, deadline=None)
