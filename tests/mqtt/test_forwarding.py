"""What of a backlog is sent next: in order, paced, and nothing let go before it is known to be there."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from gateway.backlog import HistoricalReading, Kept, Kind
from gateway.mqtt.forwarding import ASK_AGAIN, BURST, FETCHED, WHILE_FULL, WINDOW, Forwarder, Parcel
from tests.soak import FACTOR

RATE = 100.0  # values a second
DRIVES = ("pump", "fan")
EVERY = frozenset[str]()


def kept(number: int, drive: str = "pump", parts: int = 1) -> Kept:
    """Return a reading of so many messages, none of which is one that cannot be understood."""
    return Kept(number, HistoricalReading(drive, Kind.VALUES, number, str(parts)))


def unpack(each: Kept) -> list[Parcel[tuple[int, int]]]:
    """Return the messages of a reading, by its number and theirs."""
    parts = int(each.reading.body)
    return [Parcel((each.number, part), 1, each.number if part == parts - 1 else 0) for part in range(parts)]


class Machine(RuleBasedStateMachine):
    """A backlog, a broker and what is between them; the connection, or the whole process, may be lost at any step."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.forwarder = Forwarder(RATE, unpack)
        self.store: dict[int, Kept] = {}
        self.last = 0
        self.without: frozenset[str] = EVERY
        self.asked: tuple[int, int, frozenset[str], int] | None = None
        self.read: list[tuple[int, int]] = []  # by the broker, on all connections
        self.of_this: list[tuple[int, int]] = []  # on this connection, read or not
        self.acknowledged = 0  # of those
        self.let_go: set[int] = set()
        self.begun_at = 0.0
        self.has_passed_over = False
        self.drives: dict[int, str] = {}  # of each reading there ever was
        self.forwarder.begin()

    @rule(count=st.integers(1, 2 * FETCHED), drive=st.sampled_from(DRIVES), parts=st.sampled_from([0, 1, 1, 1, 3]))
    def store_more(self, count: int, drive: str, parts: int) -> None:
        """Keep readings, also while there is a connection: what it swallowed."""
        for _ in range(count):
            self.last += 1
            self.store[self.last] = kept(self.last, drive, parts)
            self.drives[self.last] = drive

    @rule(seconds=st.sampled_from([0.001, 0.01, 0.1, 1.0, 10.0]))
    def wait(self, seconds: float) -> None:
        """Time passes."""
        self.now += seconds

    @rule()
    def ask(self) -> None:
        """Ask the backlog, where it is to be asked."""
        self.asked = self.forwarder.question(self.now) or self.asked

    @rule()
    @precondition(lambda self: self.asked is not None)
    def answer(self) -> None:
        """Answer as the backlog does, with what it holds then."""
        assert self.asked is not None
        after, count, without, turn = self.asked
        self.asked = None
        found = [each for n, each in self.store.items() if n > after and each.reading.drive not in without][:count]
        for number in self.forwarder.take(found, turn, self.now):
            assert self.store.pop(number).reading.body == "0", "only what nothing can be done with"

    @rule(most=st.integers(1, 30))
    def send(self, most: int) -> None:
        """Send what is due."""
        for _ in range(most):
            if not self.forwarder.is_due(self.now):
                return
            parcel = self.forwarder.next(self.now)
            self.of_this.append(parcel.what)
            self.forwarder.sent(parcel, self._is_there(len(self.of_this)))

    def _is_there(self, place: int) -> Callable[[], bool]:
        of_this = self.of_this
        return lambda: self.of_this is of_this and self.acknowledged >= place

    @rule(count=st.integers(1, 20))
    def acknowledge(self, count: int) -> None:
        """Read some as the broker does, and say so."""
        before = self.acknowledged
        self.acknowledged = min(len(self.of_this), before + count)
        self.read += self.of_this[before : self.acknowledged]

    @rule()
    def settle(self) -> None:
        """Let go what is there."""
        for number in self.forwarder.settle():
            parts = int(self.store.pop(number).reading.body)
            assert {(number, part) for part in range(parts)} <= set(self.read), "not before the broker has all of it"

    @rule(drives=st.frozensets(st.sampled_from(DRIVES)))
    def pass_over(self, drives: frozenset[str]) -> None:
        """Have some drives wait, or wait no longer."""
        self.has_passed_over |= drives != self.without
        self.without = drives
        self.forwarder.pass_over(drives)

    @rule(read=st.integers(0, 20), is_end=st.booleans())
    def lose(self, read: int, is_end: bool) -> None:
        """Break the connection, or kill the process; some of what was under way was read all the same."""
        self.read += self.of_this[self.acknowledged : self.acknowledged + read]
        if is_end:
            self.forwarder = Forwarder(RATE, unpack)
            self.asked = None
        self.forwarder.begin()
        self.forwarder.pass_over(self.without)
        self.of_this, self.acknowledged, self.begun_at = [], 0, self.now
        self.has_passed_over = False

    @rule()
    def come_to_rest(self) -> None:
        """With time, an answering backlog and a reading broker all of it arrives."""
        for _ in range(10 * len(self.store) + 10):
            self.now += ASK_AGAIN
            self.ask()
            if self.asked is not None:
                self.answer()
            self.send(WINDOW)
            self.acknowledge(WINDOW)
            self.settle()
        left = [each for each in self.store.values() if each.reading.drive not in self.without]
        assert not left

    @invariant()
    def it_is_in_order_on_each_connection(self) -> None:
        """By number, for each drive, and nothing twice on one connection, but for a reading that was broken off."""
        for drive in DRIVES:
            mine = [what for what in self.of_this if self.drives[what[0]] == drive]
            assert list(dict.fromkeys(mine)) == sorted(set(mine))
            twice = [what for what in set(mine) if mine.count(what) > 1]
            assert not twice or (self.has_passed_over and not any((number, 2) in twice for number, _ in twice))

    @invariant()
    def it_is_bounded_and_paced(self) -> None:
        """So many under way, so many a second."""
        assert len(self.of_this) - self.acknowledged <= WINDOW or self.forwarder.is_full
        assert len(self.of_this) <= RATE * (self.now - self.begun_at + BURST) + 2 + RATE * BURST


Machine.TestCase.settings = settings(max_examples=25 * FACTOR, stateful_step_count=40, deadline=None)
TestForwarder = Machine.TestCase


def test_it_says_when_it_is_to_be_looked_at_again() -> None:
    """At its pace; after a while where the backlog was empty; with a full window when the broker can be asked."""
    forwarder = Forwarder(10.0, unpack, window=2)
    forwarder.begin()
    assert forwarder.patience(0.0, 5.0) == 0.0
    question = forwarder.question(0.0)
    assert question is not None
    assert forwarder.question(0.0) is None
    assert forwarder.patience(0.0, 5.0) == 5.0
    forwarder.take([kept(1), kept(2), kept(3)], question[-1], 0.0)
    forwarder.sent(forwarder.next(0.0), lambda: False)
    assert not forwarder.is_due(0.0)
    assert round(forwarder.patience(0.0, 5.0), 6) == round(0.1 - BURST, 6)
    forwarder.sent(forwarder.next(0.1), lambda: True)
    assert forwarder.is_full
    assert forwarder.patience(1.0, 5.0) == WHILE_FULL
    assert forwarder.settle() == [], "the first is not there yet"


def test_a_reading_that_was_broken_off_is_sent_again_as_a_whole() -> None:
    """Where other drives are to be passed over meanwhile; what is under way is not, and is let go once."""
    forwarder = Forwarder(1000.0, unpack)
    forwarder.begin()
    question = forwarder.question(0.0)
    assert question is not None
    forwarder.take([kept(1), kept(2, parts=2), kept(3)], question[-1], 0.0)
    for _ in range(2):
        forwarder.sent(forwarder.next(0.0), lambda: True)
    forwarder.pass_over(frozenset({"fan"}))
    question = forwarder.question(0.0)
    assert question is not None
    assert question[0] == 0
    forwarder.take([kept(1), kept(2, parts=2), kept(3)], question[-1], 0.0)
    sent = [forwarder.next(0.0) for _ in range(3)]
    assert [parcel.what for parcel in sent] == [(2, 0), (2, 1), (3, 0)]
    assert forwarder.settle() == [1]


def test_an_answer_to_an_old_question_counts_for_nothing() -> None:
    """The connection was lost, or other drives are asked for."""
    forwarder = Forwarder(10.0, unpack)
    forwarder.begin()
    question = forwarder.question(0.0)
    assert question is not None
    forwarder.begin()
    assert forwarder.take([kept(1)], question[-1], 0.0) == []
    assert not forwarder.is_due(0.0)
    again = forwarder.question(0.0)
    assert again is not None
    assert again[0] == 0
