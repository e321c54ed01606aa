"""The keepalive: a deadline that every good exchange pushes on, and what goes before it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.keepalive import BROADCASTS_AHEAD, PER_TIMEOUT, STOPS_AHEAD, TRIES, Keepalive
from gateway.bus.link import SILENCES_TO_OFFLINE
from gateway.bus.refresh import KEEPALIVE_SHARE, Longest, WorstCase

LEAD = 0.2  # seconds
NOBODY = "nobody"  # a drive that is polled, or probed in vain, and has no F803
BROADCAST = "broadcast"
NEVER = (float("inf"), float("inf"))


def watching(**timeouts: float) -> Keepalive:
    """Return the keepalive of armed drives that were all heard at 0."""
    keepalive = Keepalive(LEAD)
    for drive, timeout in timeouts.items():
        keepalive.arm(drive, timeout)
        keepalive.heard(drive, 0.0)
    return keepalive


@pytest.mark.hazard("H06")
def test_a_drive_falls_due_a_lead_before_a_third_of_its_time_out() -> None:
    """F803 of 1.5 s: a good exchange every 0.5 s, begun 0.2 s before."""
    keepalive = watching(pump=1.5)
    assert keepalive.next_time() == pytest.approx(0.3)
    assert keepalive.due(0.29) is None
    assert keepalive.due(0.31) == "pump"


def test_every_good_exchange_pushes_the_deadline_on() -> None:
    """Whoever asked for it: where polls keep ahead, nothing is ever due."""
    keepalive = watching(pump=1.5)
    keepalive.heard("pump", 0.25)
    assert keepalive.due(0.5) is None
    assert keepalive.next_time() == pytest.approx(0.55)


@pytest.mark.hazard("H06")
def test_the_earliest_deadline_goes_first() -> None:
    """Not the one that fell due first by its place in the file."""
    keepalive = watching(slow=3.0, fast=1.5)
    assert keepalive.due(0.9) == "fast"
    keepalive.heard("fast", 0.9)
    assert keepalive.due(0.9) == "slow"


def test_a_drive_that_was_never_heard_comes_first() -> None:
    """Nobody knows for how long its timer has been running."""
    keepalive = watching(pump=1.5)
    keepalive.arm("fan", 10.0)
    assert keepalive.due(0.4) == "fan"


def test_a_drive_without_a_time_out_is_never_due() -> None:
    """F803 of 0, offline, or left alone so that it acts."""
    keepalive = watching(pump=1.5, fan=1.5)
    keepalive.arm("pump", 0.0)
    keepalive.disarm("fan")
    assert keepalive.due(100.0) is None
    assert keepalive.next_time() == float("inf")
    assert keepalive.margin("pump", 100.0) == float("inf")


@pytest.mark.hazard("H30")
def test_a_drive_that_falls_silent_does_not_eat_the_line() -> None:
    """It is asked once more at once; after that only as the schedule has it, until it is heard again."""
    keepalive = watching(dying=1.5, pump=1.6)
    keepalive.missed("dying")
    assert keepalive.due(0.4) == "dying"
    keepalive.missed("dying")
    assert keepalive.due(0.4) == "pump"
    keepalive.heard("pump", 0.4)
    assert keepalive.due(0.5) is None
    keepalive.heard("dying", 0.5)
    keepalive.heard("pump", 0.6)
    assert keepalive.due(0.81) == "dying"


@pytest.mark.hazard("H30")
def test_a_time_out_that_cannot_be_kept_gets_half_its_interval_behind_the_others() -> None:
    """F803 of 0.3 s with a lead of 0.2 s: an exchange every 0.05 s, and no more of the line."""
    keepalive = watching(hasty=0.3, pump=1.5)
    assert not keepalive.is_kept("hasty")
    assert keepalive.is_kept("pump")
    assert keepalive.next_time() == pytest.approx(0.05)
    assert keepalive.due(0.04) is None
    assert keepalive.due(0.06) == "hasty"
    assert keepalive.due(0.31) == "pump"


def test_the_margin_is_what_is_left_of_the_time_out() -> None:
    """Of F803 itself, not of its third: the drive trips when it is 0."""
    keepalive = watching(pump=1.5)
    assert keepalive.margin("pump", 0.4) == pytest.approx(1.1)


@pytest.mark.hazard("H29")
def test_a_stop_goes_ahead_and_a_flood_of_stops_does_not() -> None:
    """Two frames of one drive within a lead while another is due; then that one, then stops again."""
    keepalive = watching(pump=1.5)
    sent = []
    for now in (0.31, 0.35, 0.39):
        sent.append(keepalive.goes_ahead("fan", now))
        if sent[-1]:
            keepalive.went_ahead("fan", now)
    assert sent == [True, True, False]
    assert keepalive.goes_ahead("other", 0.4)
    keepalive.heard("pump", 0.43)
    assert keepalive.goes_ahead("fan", 0.44)


def test_the_stop_of_the_drive_that_is_due_is_its_exchange() -> None:
    """It refreshes the same timer, however often it has been sent."""
    keepalive = watching(pump=1.5)
    for now in (0.31, 0.32, 0.33):
        assert keepalive.goes_ahead("pump", now)
        keepalive.went_ahead("pump", now)


def test_one_broadcast_goes_ahead_within_a_lead() -> None:
    """A second one waits for what is due."""
    keepalive = watching(pump=1.5)
    assert keepalive.goes_ahead("modbus-rtu", 0.31, BROADCASTS_AHEAD)
    keepalive.went_ahead("modbus-rtu", 0.31)
    assert not keepalive.goes_ahead("modbus-rtu", 0.35, BROADCASTS_AHEAD)
    assert keepalive.goes_ahead("modbus-rtu", 0.31 + LEAD, BROADCASTS_AHEAD)


# ---- a line in numbers: whatever happens on it at once


@dataclass
class Neighbourhood:
    """A line as the reckoning sees it: the longest exchanges of its drives, and what is done without end.

    `losses` is the share of exchanges that come to nothing, never two in a row of a living drive. `silent` drives do
    not answer between two times. `flooded` ones are stopped again and again. `is_worst`: every exchange takes the
    longest time that it can.
    """

    worst: WorstCase
    timeouts: dict[str, float]
    losses: float
    silent: dict[str, tuple[float, float]]
    flooded: list[str]
    is_worst: bool
    chance: Random


@dataclass
class Play:
    """Carries it out as the worker does: stops, what is due, then anything else, without a pause."""

    line: Neighbourhood
    now: float = 0.0
    heard: dict[str, float] = field(default_factory=dict)
    gaps: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    lost: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    turn: int = 0

    def __post_init__(self) -> None:
        self.keepalive = Keepalive(self.line.worst.lead)
        for drive in self.line.timeouts:
            self._good(drive)

    def run(self, until: float) -> None:
        """Play until then."""
        while self.now < until:
            self._step()

    def _step(self) -> None:
        worst, keepalive = self.line.worst, self.keepalive
        for name, due in self._stops():
            if keepalive.goes_ahead(name, self.now, due):
                keepalive.went_ahead(name, self.now)
                if name == BROADCAST:
                    self._take(worst.broadcasts)
                else:
                    self._exchange(name, worst.stops[name] / STOPS_AHEAD)
                return
        if (drive := keepalive.due(self.now)) is not None:
            self._exchange(drive, worst.turns[drive] / TRIES)
        else:
            self._anything()

    def _stops(self) -> Iterator[tuple[str, int]]:
        """Yield the drives that are being stopped, another one first each time; broadcasts where all are."""
        self.turn += 1
        flooded = self.line.flooded
        for place in range(len(flooded)):
            yield flooded[(self.turn + place) % len(flooded)], STOPS_AHEAD
        if len(flooded) == len(self.line.worst.turns):
            yield BROADCAST, BROADCASTS_AHEAD

    def _anything(self) -> None:
        """Ask a suspect drive again, else poll, command or probe: with the longest exchange that there is."""
        suspects = [drive for drive in self.line.timeouts if 0 < self.lost[drive] < SILENCES_TO_OFFLINE]
        drive = suspects[0] if suspects else self.line.chance.choice([*self.line.timeouts, *[NOBODY] * 5])
        if drive == NOBODY:
            self._take(self.line.worst.blocking.seconds)
        else:
            self._exchange(drive, self.line.worst.blocking.seconds)

    def _take(self, longest: float) -> None:
        self.now += longest if self.line.is_worst else longest * self.line.chance.uniform(0.1, 1)

    def _exchange(self, drive: str, longest: float) -> None:
        self._take(longest)
        begin, end = self.line.silent.get(drive, NEVER)
        if begin <= self.now < end or self._is_lost(drive):
            self.lost[drive] += 1
            self.keepalive.missed(drive)
            if self.lost[drive] == SILENCES_TO_OFFLINE:
                self.keepalive.disarm(drive)
        else:
            self._good(drive)

    def _is_lost(self, drive: str) -> bool:
        return not self.lost[drive] and self.line.chance.random() < self.line.losses

    def _good(self, drive: str) -> None:
        self.gaps[drive] = max(self.gaps[drive], self.now - self.heard.get(drive, self.now))
        self.heard[drive], self.lost[drive] = self.now, 0
        self.keepalive.arm(drive, self.line.timeouts[drive])
        self.keepalive.heard(drive, self.now)


@st.composite
def neighbourhoods(draw: st.DrawFn) -> Neighbourhood:
    """Make up a line of one to eight armed drives, each with an F803 that is just, or easily, kept on it."""
    names = [f"d{place}" for place in range(draw(st.integers(1, 8)))]
    longest = st.floats(0.02, 0.2)
    turns = {name: TRIES * draw(longest) for name in names}
    stops = {name: STOPS_AHEAD * draw(longest) for name in names}
    blocking = max(0.2, draw(st.floats(0.02, 0.5)))
    worst = WorstCase(Longest(blocking, ""), turns, stops, draw(longest))
    spare = st.one_of(st.just(1.0), st.floats(1.0, 4.0))
    falls, lasts = st.floats(0, 20), st.floats(0, 10)
    silent = draw(st.dictionaries(st.sampled_from(names), st.tuples(falls, lasts), max_size=len(names) - 1))
    return Neighbourhood(
        worst=worst,
        timeouts={name: PER_TIMEOUT * worst.lead * draw(spare) * (1 + 1e-9) for name in names},
        losses=draw(st.sampled_from([0.0, 0.1, 0.5, 1.0])),
        silent={name: (begin, begin + length) for name, (begin, length) in silent.items()},
        flooded=draw(st.lists(st.sampled_from(names), unique=True)),
        is_worst=draw(st.booleans()),
        chance=Random(draw(st.integers(0, 2**32))),
    )


def longest_gaps(line: Neighbourhood, seconds: float) -> dict[str, float]:
    """Return the longest time between two good exchanges of each drive that lives, in shares of its interval."""
    play = Play(line)
    play.run(seconds)
    for drive, heard in play.heard.items():
        play.gaps[drive] = max(play.gaps[drive], play.now - heard - line.worst.blocking.seconds)
    living = [drive for drive in line.timeouts if drive not in line.silent]
    return {drive: play.gaps[drive] * PER_TIMEOUT / line.timeouts[drive] for drive in living}


@pytest.mark.hazard("H06")
@pytest.mark.hazard("H30")
@given(neighbourhoods())
def test_no_living_drive_waits_longer_than_a_third_of_its_time_out(line: Neighbourhood) -> None:
    """Whatever is lost, falls silent and comes back, is stopped without end, or takes as long as it can."""
    assert max(longest_gaps(line, 40.0).values()) <= 1 + 1e-6


@pytest.mark.hazard("H30")
def test_the_worst_case_is_reached_and_no_more_is_reckoned_than_that() -> None:
    """All fall due at once, just behind the beginning of the longest exchange; the last is heard on the last moment.

    Each loses its exchange, is asked again, and is stopped thereafter: a stop before would refresh it.
    """
    names = [f"d{place}" for place in range(8)]
    worst = WorstCase(Longest(0.12, ""), dict.fromkeys(names, 0.24), dict.fromkeys(names, 0.17), 0.03)
    keepalive, now = Keepalive(worst.lead), worst.lead
    for name in names:
        keepalive.arm(name, PER_TIMEOUT * 2 * worst.lead)
        keepalive.heard(name, 0.0)
    assert keepalive.due(now - 1e-6) is None
    now += worst.blocking.seconds
    assert keepalive.goes_ahead(BROADCAST, now, BROADCASTS_AHEAD)
    now += worst.broadcasts
    for name in names:
        for is_lost in (True, False):
            assert keepalive.due(now) == name
            now += worst.turns[name] / TRIES
            keepalive.missed(name) if is_lost else keepalive.heard(name, now)
        for _ in range(STOPS_AHEAD if name != names[-1] else 0):
            assert keepalive.goes_ahead(name, now)
            keepalive.went_ahead(name, now)
            now += worst.stops[name] / STOPS_AHEAD
            keepalive.heard(name, now)
    assert now == pytest.approx(2 * worst.lead)


@pytest.mark.hazard("H30")
def test_a_fifth_of_the_line_is_left_to_everything_else() -> None:
    """Drives that nothing but the keepalive talks to, each with the shortest F803 that may be configured."""
    read, poll, names = 0.031, 0.04, [f"d{place}" for place in range(8)]
    worst = WorstCase(Longest(0.12, ""), dict.fromkeys(names, 0.24), {}, 0.0, len(names) * read / KEEPALIVE_SHARE)
    keepalive, now, polled = Keepalive(worst.lead), 0.0, 0.0
    for name in names:
        keepalive.arm(name, PER_TIMEOUT * worst.least_interval)
        keepalive.heard(name, 0.0)
    while now < 100.0:
        if (drive := keepalive.due(now)) is not None:
            now += read
            keepalive.heard(drive, now)
        else:
            now += poll
            polled += poll
    assert 0.2 <= polled / now < 0.4
