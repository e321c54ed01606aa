from __future__ import annotations

import asyncio
from collections.abc import Sequence
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.protocol.timing import LineTiming
from gateway.sim.faults import Kind
from gateway.sim.installation import Installation
from gateway.sim.journal import Entry, Way
from gateway.sim.settings import SimulatedLineConfig, build, install
from gateway.sim.state import state
from gateway.sim.twin import TwinLine
from gateway.sim.wire import Wire
from tests.sim.rig import framed
from tests.sim.test_wire import ANSWER, EXCHANGE, READ, heard
from tests.soak import FACTOR
from tests.virtual import VirtualClock, run

SETTLING = 0.002  # seconds behind an exchange
EVERYTHING = 10_000  # entries


def config(*events: dict[str, Any], **settings_: Any) -> SimulatedLineConfig:
    """Describe a line of a pump, number 1, and a fan, number 2, on which these events happen."""
    drives = [
        {"number": 1, "name": "pump", "model": "vf-nc3", "stable_bits": True},
        {"number": 2, "name": "fan", "model": "vf-mb1"},
    ]
    return SimulatedLineConfig.model_validate({"drive": drives, "event": list(events), **settings_})


def line(*events: dict[str, Any], **settings_: Any) -> Installation:
    """Open that line at time 0."""
    return install(config(*events, **settings_), 0.0)


def let_pass(wire: Wire, until: float) -> list[bytes]:
    """Let time pass; return what the master hears."""
    return [data for _, data in heard(wire, until)]


def happened(wire: Wire) -> list[tuple[float, str]]:
    """Return the events so far, and when they were, to a microsecond."""
    return [(round(entry.begin, 6), entry.note) for entry in wire.journal.last(EVERYTHING) if entry.way is Way.EVENT]


def ask(wire: Wire, begin: float, frame: bytes = READ) -> list[bytes]:
    """Send a request, and return what is heard within 100 ms."""
    wire.feed(frame, begin)
    return let_pass(wire, begin + 0.1)


class TestByTheClock:
    def test_an_event_comes_once_in_its_time(self) -> None:
        """Not a microsecond before five seconds, and not again."""
        station = line({"at": "5s", "do": "trip", "drive": "pump", "code": 13})
        let_pass(station.wire, 4.999999)
        assert happened(station.wire) == []
        let_pass(station.wire, 100.0)
        assert happened(station.wire) == [(5.0, "trip drive=pump code=13")]
        assert station.wire.next_event() is None
        assert station.drive("pump", 100.0).inverter.condition.trip_code == 13

    def test_times_count_from_when_the_line_was_opened(self) -> None:
        """Whatever its clock says."""
        wire = build(config({"at": "5s", "do": "babble"}), now=1000.0)
        assert wire.next_event() == 1005.0

    def test_an_event_comes_every_so_often(self) -> None:
        """First at its time, then as often as it was told."""
        wire = line({"at": "1s", "every": "500ms", "times": 3, "do": "power_cycle"}).wire
        let_pass(wire, 10.0)
        assert [when for when, _ in happened(wire)] == [1.0, 1.5, 2.0]

    def test_without_a_first_time_it_comes_after_one_interval(self) -> None:
        """And without a number of times it never ends."""
        wire = line({"every": "2s", "do": "babble", "bytes": 1}).wire
        let_pass(wire, 7.0)
        assert [when for when, _ in happened(wire)] == [2.0, 4.0, 6.0]
        assert wire.next_event() == 8.0

    def test_two_durations_stand_for_one_between_them(self) -> None:
        """Each time another one, by the seed."""

        def times(seed: int) -> list[float]:
            wire = line({"at": ["1s", "2s"], "every": ["100ms", "300ms"], "do": "babble"}, seed=seed).wire
            let_pass(wire, 20.0)
            return [when for when, _ in happened(wire)]

        first, *others = times(1)
        assert 1.0 <= first <= 2.0
        steps = [after - before for before, after in zip([first, *others], others, strict=False)]
        assert all(0.0999 <= step <= 0.3001 for step in steps)
        assert len({round(step, 3) for step in steps}) > 10
        assert times(1) == [first, *others] != times(2)

    def test_events_of_one_moment_come_in_the_order_of_the_file(self) -> None:
        """Renumbered twice, it has the last number."""
        events = [{"at": "1s", "do": "renumber", "drive": "pump", "number": number} for number in (5, 9)]
        station = line(*events)
        let_pass(station.wire, 1.0)
        assert station.drive("pump", 1.0).number == 9

    def test_an_event_during_a_request_acts_before_its_answer(self) -> None:
        """A drive that trips while it is asked says so."""
        wire = line({"at": "1s", "do": "trip", "drive": 1, "code": 13}).wire
        before, after = (ask(wire, begin, framed("03 FC90 0001")) for begin in (0.5, 0.999))
        assert (before, after) == ([framed("03 02 0000")], [framed("03 02 000D")])

    def test_an_event_that_was_not_fetched_in_time_came_in_its_time(self) -> None:
        """A loop that is late changes nothing."""
        wire = line({"at": "1s", "do": "trip", "drive": 1, "code": 13}).wire
        wire.feed(framed("03 FC90 0001"), 2.0)
        assert let_pass(wire, 3.0) == [framed("03 02 000D")]
        assert happened(wire) == [(1.0, "trip drive=1 code=13")]


class TestByExchanges:
    def test_an_event_waits_for_exchanges(self) -> None:
        """After the third, whose answer is out; the fourth finds another number."""
        wire = line({"after_exchanges": 3, "do": "renumber", "drive": 1, "number": 7}).wire
        assert [ask(wire, float(begin)) for begin in range(4)] == [[ANSWER]] * 3 + [[]]
        ((when, _),) = happened(wire)
        assert when == pytest.approx(2.0 + EXCHANGE + SETTLING)

    def test_an_event_may_wait_for_time_behind_the_exchange(self) -> None:
        """Half a second later, once; from then on by the count alone."""
        wire = line({"after_exchanges": 2, "at": "500ms", "every_exchanges": 2, "times": 2, "do": "babble"}).wire
        for begin in range(6):
            ask(wire, float(begin))
        first, second = (when for when, _ in happened(wire))
        assert first == pytest.approx(1.0 + EXCHANGE + SETTLING + 0.5)
        assert second == pytest.approx(3.0 + EXCHANGE + SETTLING)

    def test_an_exchange_without_an_answer_counts(self) -> None:
        """Over is it when the silence behind the request is."""
        wire = line({"after_exchanges": 2, "do": "trip", "drive": 1, "code": 13}).wire
        ask(wire, 0.0, framed("03 FD00 0001", 9))
        ask(wire, 1.0, framed("03 FD00 0001", 9))
        assert [round(when) for when, _ in happened(wire)] == [1]

    def test_a_late_answer_does_not_hold_it_up(self) -> None:
        """Where the master goes on before it, the exchange is over."""
        late = {"kind": "late", "value": 5.0, "count": 1}
        wire = line({"after_exchanges": 1, "do": "renumber", "drive": 1, "number": 7}, fault=[late]).wire
        assert ask(wire, 0.0) == []
        assert happened(wire) == []
        assert ask(wire, 1.0) == []
        assert happened(wire) == [(1.0 + SETTLING, "renumber drive=1 number=7")]

    def test_it_comes_again_after_so_many_more(self) -> None:
        """After the second, the fifth and the eighth."""
        again = {"every_exchanges": 3, "times": 3}
        wire = line({"after_exchanges": 2, **again, "do": "alarm", "drive": 2, "value": 1}).wire
        for begin in range(20):
            ask(wire, float(begin))
        assert [int(when) for when, _ in happened(wire)] == [1, 4, 7]

    def test_time_and_exchanges_can_be_put_together(self) -> None:
        """From the second exchange on every ten seconds; from five seconds on every second exchange."""
        wire = line(
            {"after_exchanges": 2, "every": "10s", "times": 3, "do": "alarm", "drive": 1, "value": 1},
            {"at": "5s", "every_exchanges": 2, "times": 3, "do": "alarm", "drive": 2, "value": 2},
        ).wire
        for begin in range(12):
            ask(wire, float(begin))
        let_pass(wire, 60.0)
        times = {note: [int(when) for when, told in happened(wire) if told == note] for _, note in happened(wire)}
        assert times == {"alarm drive=1 value=1": [1, 11, 21], "alarm drive=2 value=2": [5, 6, 8]}


class TestWhatCannotBe:
    def test_it_is_noted_and_counted_and_the_rest_goes_on(self) -> None:
        """A drive that has another number by then."""
        station = line(
            {"at": "1s", "do": "renumber", "drive": 1, "number": 7},
            {"at": "2s", "do": "trip", "drive": 1, "code": 13},
            {"at": "3s", "do": "trip", "drive": 7, "code": 13},
        )
        let_pass(station.wire, 10.0)
        assert happened(station.wire) == [
            (1.0, "renumber drive=1 number=7"),
            (2.0, "trip drive=1 code=13: no drive 1; on the line: 7, 2, pump, fan"),
            (3.0, "trip drive=7 code=13"),
        ]
        assert (station.counts()["done"], station.counts()["failed"]) == (2, 1)

    def test_a_line_in_memory_cannot_be_unplugged(self) -> None:
        """It says so."""
        wire = line({"at": "1s", "do": "unplug"}).wire
        let_pass(wire, 2.0)
        assert happened(wire) == [(1.0, "unplug: this line is in memory: it has no port")]


# -- again and again the same -------------------------------------------------------------------------------------

FRAMES = [
    READ,
    framed("03 1875 0005"),
    framed("06 FA01 0BB8"),
    framed("06 FA00 C400"),
    framed("03 FE03 0001", 2),
    framed("06 FA01 07D0", 0),
    b"(05RFD01)\r",
    b"(05PFA011770)\r",
    b"(05WFA000000)\r",
]
DOINGS: list[dict[str, Any]] = [
    {"do": "trip", "drive": "pump", "code": 13},
    {"do": "power_cycle", "drive": "pump", "seconds": 0.2},
    {"do": "run", "drive": "fan", "frequency": 25, "reverse": True},
    {"do": "set", "drive": "fan", "register": "free_notes", "value": 7},
    {"do": "force", "drive": "pump", "register": "output_frequency", "value": 1},
    {"do": "alarm", "drive": "mixer", "value": 3},
    {"do": "renumber", "drive": "fan", "number": 1},
    {"do": "renumber", "drive": "fan", "number": 2},
    {"do": "cut", "drive": "mixer"},
    {"do": "cut", "drive": "mixer", "on": False},
    {"do": "silence"},
    {"do": "silence", "on": False},
    {"do": "babble", "bytes": [1, 20]},
    {"do": "fault", "kind": "flip", "value": [1, 9], "probability": 0.5, "count": 3},
    {"do": "clear_faults", "drive": "pump"},
]


def busy_line(seed: int) -> SimulatedLineConfig:
    """Describe a line of both protocols with every kind of fault and of event, in times by chance."""
    drives = [
        {"number": 1, "name": "pump", "model": "vf-nc3", "running_at": 30.0},
        {"number": 2, "name": "fan", "model": "vf-mb1"},
        {"number": 5, "name": "mixer", "model": "vf-nc3", "protocol": "toshiba", "running_at": 20.0},
    ]
    values: dict[Kind, Any] = {Kind.LATE: [0.0, 0.2], Kind.TRUNCATE: [0, 30], Kind.SPLIT: [0.0, 0.05]}
    faults = [
        {"kind": kind.value, "probability": 0.05} | ({"value": values[kind]} if kind in values else {})
        for kind in Kind
    ]
    events = [{"every": ["200ms", "4s"], **doing} for doing in DOINGS]
    counted = [{"every_exchanges": 7, "do": "babble"}, {"after_exchanges": 20, "do": "power_cycle"}]
    table = {"seed": seed, "drive": drives, "fault": faults, "event": [*events, *counted]}
    return SimulatedLineConfig.model_validate(table)


def run_of(seed: int, requests: int = 120) -> tuple[Sequence[Entry], Sequence[bytes], dict[str, Any]]:
    """Let a master ask that line in virtual time; return the journal, what it heard, and the states and counts."""

    async def main() -> tuple[Sequence[Entry], Sequence[bytes], dict[str, Any]]:
        clock, master = VirtualClock(), Random(0)
        station = install(busy_line(seed), clock.now())
        twin = TwinLine(station.wire, LineTiming(19200), clock)
        answers = []
        for _ in range(requests):
            begun = await twin.write(master.choice(FRAMES))
            answers.append(await twin.read(begun + master.uniform(0.02, 0.1)))
            await asyncio.sleep(master.uniform(0.0, 0.1))
            await twin.drain(0.01, 0.5)
        twin.close()
        states = [state(drive, None, station.opened) for drive in station.drives(None, clock.now())]
        return station.wire.journal.last(EVERYTHING), answers, {"states": states, **station.counts()}

    return run(main())


@pytest.mark.parametrize("seed", range(3 * FACTOR))
def test_the_same_seed_and_requests_bring_the_same_to_the_byte(seed: int) -> None:
    """Answers, noise, events and their times; with every kind of fault and of event on a line of both protocols."""
    journal, answers, told = run_of(seed)
    again, answers_again, told_again = run_of(seed)
    assert journal == again
    assert (answers, told) == (answers_again, told_again)


def test_another_seed_brings_something_else() -> None:
    """And all that can happen does: the proof above is not of an idle line."""
    journal, answers, told = run_of(1, requests=600)
    assert answers != run_of(2, requests=600)[1]
    assert set(told["faults"]) == {kind.value for kind in Kind}
    notes = {entry.note.split(" ")[0] for entry in journal if entry.way is Way.EVENT}
    assert notes == {str(doing["do"]) for doing in DOINGS}
    assert told["failed"] == 0
    assert sum(bool(answer) for answer in answers) > 100


@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=30), st.integers(0, 1000))
@settings(max_examples=50 * FACTOR)
def test_events_do_not_depend_on_when_the_line_is_looked_at(looks: list[float], seed: int) -> None:
    """Looked at often or once: the same events, in the same order, at the same times."""
    events: list[dict[str, Any]] = [
        {"every": ["100ms", "700ms"], "do": "babble", "bytes": [1, 5]},
        {"at": ["0s", "2s"], "every": "300ms", "do": "alarm", "drive": 1, "value": 1},
    ]
    once, often = (line(*events, seed=seed).wire for _ in range(2))
    for look in sorted(looks):
        often.due(look)
    often.due(3.0)
    once.due(3.0)
    assert often.journal.last(EVERYTHING) == once.journal.last(EVERYTHING)
