"""The keepalive: a deadline that every good exchange pushes on, and what goes before it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.keepalive import BROADCASTS_AHEAD, PER_TIMEOUT, STOPS_AHEAD, TRIES, Keepalive
from gateway.bus.link import SILENCES_TO_OFFLINE
from gateway.bus.refresh import Longest, WorstCase

LEAD = 0.2  # seconds
NOBODY = "nobody"  # a drive that is polled, or probed in vain, and has no F803
BROADCAST = "broadcast"
JUST = 1e-9  # seconds
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
    """One frame of each drive within a lead while another is due; then that one, then stops again."""
    keepalive = watching(pump=1.5)
    sent = []
    for now in (0.31, 0.35, 0.39):
        sent.append(keepalive.goes_ahead("fan", now))
        if sent[-1]:
            keepalive.went_ahead("fan", now)
    assert sent == [True, False, False]
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


@pytest.mark.hazard("H30")
def test_while_a_drive_is_due_one_other_exchange_is_let_through_in_a_lead() -> None:
    """It may have begun before that drive fell due: then it is the one under way. Where nothing is due, all go."""
    keepalive = watching(pump=1.5)
    for now in (0.1, 0.15, 0.2, 0.25):
        assert keepalive.lets_through(now)
        keepalive.let_through(now)
    assert not keepalive.lets_through(0.31)
    assert not keepalive.lets_through(0.44)
    assert keepalive.lets_through(0.46)
    keepalive.let_through(0.46)
    assert not keepalive.lets_through(0.6)
    keepalive.heard("pump", 0.61)
    assert keepalive.lets_through(0.62)


# ---- a line in numbers: whatever happens on it at once


@dataclass
class Neighbourhood:
    """A line as the reckoning sees it: how long the exchanges of its drives take, and what is done without end.

    A lost exchange takes `late` longer than its turn; the identification behind it, `again` longer. `losses` is the
    share of exchanges that noise spoils, as far as the premise allows. `silent` drives stop answering at an exchange
    between two times. `flooded` ones are stopped again and again, all by broadcasts if `is_announced`. `is_worst`:
    every exchange takes the longest time that it can. `is_lurking`: all are polled in no time while nothing is due,
    then the longest exchange begins just before that ends, and a stop comes when its drive has just been heard.
    `lead` is that of `worst`, or too short a one.
    """

    worst: WorstCase
    lead: float
    late: float
    again: float
    timeouts: dict[str, float]
    losses: float
    silent: dict[str, tuple[float, float]]
    flooded: list[str]
    is_announced: bool
    is_worst: bool
    is_lurking: bool
    chance: Random


@dataclass
class Play:
    """Carries it out as the worker does: stops, what is due, then anything else, without a pause."""

    line: Neighbourhood
    now: float = 0.0
    heard: dict[str, float] = field(default_factory=dict)
    gaps: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    lost: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    dead: set[str] = field(default_factory=set)
    spoilt: float = float("-inf")
    victim: str = NOBODY
    last: str = NOBODY
    turn: int = 0

    def __post_init__(self) -> None:
        self.keepalive = Keepalive(self.line.lead)
        for drive in self.line.timeouts:
            self._good(drive)

    def run(self, until: float) -> None:
        """Play until then."""
        while self.now < until:
            self._step()

    def _step(self) -> None:
        keepalive = self.keepalive
        for name, at_most in self._stops():
            if keepalive.goes_ahead(name, self.now, at_most):
                keepalive.went_ahead(name, self.now)
                if name == BROADCAST:
                    self._take(self.line.worst.broadcasts)
                else:
                    self._go_ahead(name)
                return
        if not keepalive.lets_through(self.now) and (drive := keepalive.due(self.now)) is not None:
            self._go_ahead(drive)
        else:
            keepalive.let_through(self.now)
            self._anything()

    def _stops(self) -> Iterator[tuple[str, int]]:
        """Yield the drives that are being stopped, another one first each time, and the broadcast."""
        self.turn += 1
        flooded = self.line.flooded
        for place in range(len(flooded)):
            drive = flooded[(self.turn + place) % len(flooded)]
            if drive == self.last or not self.line.is_lurking:
                yield drive, STOPS_AHEAD
        if self.line.is_announced:
            yield BROADCAST, BROADCASTS_AHEAD

    def _go_ahead(self, drive: str) -> None:
        """Stop a drive, or keep it; ask it who it is if its last exchange was lost."""
        line, is_lost = self.line, self._is_lost(drive, is_ahead=True)
        is_again = self.lost[drive] and (is_lost or drive == self.victim)
        if is_lost:
            self.spoilt, self.victim = self.now, drive
        longer = (line.late if is_lost else 0.0) + (line.again if is_again else 0.0)
        self._take(line.worst.turns[drive] + longer)
        self._end(drive, is_lost=is_lost)

    def _anything(self) -> None:
        """Ask a suspect drive again, else poll, command or probe: with the longest exchange that there is."""
        longest = self.line.worst.blocking.seconds
        if self.line.is_lurking and self.keepalive.due(self.now) is None:
            self._lurk()
        suspects = [drive for drive in self.line.timeouts if 0 < self.lost[drive] < SILENCES_TO_OFFLINE]
        drive = suspects[0] if suspects else self.line.chance.choice([*self.line.timeouts, *[NOBODY] * 5])
        if drive == NOBODY:
            self._take(longest)
            return
        is_lost = self._is_lost(drive, is_ahead=False)
        self._take(longest)
        self._end(drive, is_lost=is_lost)

    def _lurk(self) -> None:
        """Let everything go well until just before a drive falls due."""
        for drive in self.line.timeouts:
            if drive not in self.dead and not self.lost[drive]:
                self._good(drive)
        self.now = max(self.now, self.keepalive.next_time() - JUST)
        self.keepalive.let_through(self.now)

    def _take(self, longest: float) -> None:
        self.now += longest if self.line.is_worst else longest * self.line.chance.uniform(0.1, 1)

    def _end(self, drive: str, *, is_lost: bool) -> None:
        self.last = NOBODY if is_lost else drive
        if not is_lost:
            self.victim = NOBODY if drive == self.victim else self.victim
            self._good(drive)
            return
        self.lost[drive] += 1
        self.keepalive.missed(drive)
        if self.lost[drive] == SILENCES_TO_OFFLINE:
            self.keepalive.disarm(drive)

    def _is_lost(self, drive: str, *, is_ahead: bool) -> bool:
        """Say whether an exchange that begins is lost: beside those let through, one within a lead.

        A drive dies at an exchange that is let through: one that goes ahead is then the second, and the last.
        """
        begin, end = self.line.silent.get(drive, NEVER)
        if drive in self.dead and self.now < end:
            return True
        self.dead.discard(drive)
        is_dying = any(self.lost[drive] < TRIES for drive in self.dead)
        is_calm = self.spoilt + self.line.lead <= self.now and not is_dying
        if not is_ahead and is_calm and begin <= self.now < end:
            self.dead.add(drive)
            return True
        return not self.lost[drive] and (is_calm or not is_ahead) and self.line.chance.random() < self.line.losses

    def _good(self, drive: str) -> None:
        self.gaps[drive] = max(self.gaps[drive], self.now - self.heard.get(drive, self.now))
        self.heard[drive], self.lost[drive] = self.now, 0
        self.keepalive.arm(drive, self.line.timeouts[drive])
        self.keepalive.heard(drive, self.now)


@st.composite
def neighbourhoods(draw: st.DrawFn) -> Neighbourhood:
    """Make up a line of one to eight armed drives, each with an F803 that is just, easily, or never kept on it."""
    names = [f"d{place}" for place in range(draw(st.integers(1, 8)))]
    is_alike = draw(st.booleans())
    turn, spare = st.floats(0.02, 0.1), st.one_of(st.just(1.0), st.floats(1.0, 4.0), st.floats(0.3, 0.9))
    turns = dict.fromkeys(names, draw(turn)) if is_alike else {name: draw(turn) for name in names}
    spares = dict.fromkeys(names, draw(spare)) if is_alike else {name: draw(spare) for name in names}
    late, again = draw(st.floats(0.01, 0.1)), draw(st.sampled_from([0.0, 0.03]))
    lost = max(turns.values()) + late + again
    blocking = max(lost, draw(st.floats(0.02, 0.5)))
    worst = WorstCase(Longest(blocking, ""), Longest(lost, ""), turns, draw(st.floats(0.02, 0.1)))
    falls, lasts = st.floats(0, 20), st.floats(0, 10)
    silent = draw(st.dictionaries(st.sampled_from(names), st.tuples(falls, lasts), max_size=len(names) - 1))
    answering = [name for name in names if name not in silent]
    return Neighbourhood(
        worst=worst,
        lead=worst.lead,
        late=late,
        again=again,
        timeouts={name: PER_TIMEOUT * worst.lead * spares[name] * (1 + 1e-9) for name in names},
        losses=draw(st.sampled_from([0.0, 0.1, 0.5, 1.0])),
        silent={name: (begin, begin + length) for name, (begin, length) in silent.items()},
        flooded=draw(st.lists(st.sampled_from(answering), max_size=1)),
        is_announced=draw(st.booleans()),
        is_worst=draw(st.booleans()),
        is_lurking=draw(st.booleans()),
        chance=Random(draw(st.integers(0, 2**32))),
    )


def longest_gaps(line: Neighbourhood, seconds: float) -> dict[str, float]:
    """Return the longest time between two good exchanges of each drive that lives, in shares of its interval.

    A drive whose F803 cannot be kept is left out: there is no promise for it.
    """
    play = Play(line)
    play.run(seconds)
    for drive, heard in play.heard.items():
        play.gaps[drive] = max(play.gaps[drive], play.now - heard - line.worst.blocking.seconds)
    living = [drive for drive in line.timeouts if drive not in line.silent and play.keepalive.is_kept(drive)]
    return {drive: play.gaps[drive] * PER_TIMEOUT / line.timeouts[drive] for drive in living}


@pytest.mark.unmeasured
@pytest.mark.hazard("H06")
@pytest.mark.hazard("H30")
@given(neighbourhoods())
def test_no_living_drive_waits_longer_than_a_third_of_its_time_out(line: Neighbourhood) -> None:
    """Whatever is lost, falls silent and comes back, is stopped without end, or takes as long as it can."""
    assert max(longest_gaps(line, 40.0).values(), default=0.0) <= 1 + 1e-6


def stormy(seed: int, drives: int = 4, flooded: Sequence[str] = ("d1",)) -> Neighbourhood:
    """Return a line of like drives with the shortest F803 that is kept, on which everything comes when it hurts."""
    names = [f"d{place}" for place in range(drives)]
    worst = WorstCase(Longest(0.12, ""), Longest(0.12, ""), dict.fromkeys(names, 0.036), 0.027)
    return Neighbourhood(
        worst=worst,
        lead=worst.lead,
        late=0.054,
        again=0.03,
        timeouts=dict.fromkeys(names, PER_TIMEOUT * worst.lead * (1 + 1e-9)),
        losses=1.0,
        silent={},
        flooded=list(flooded),
        is_announced=True,
        is_worst=True,
        is_lurking=True,
        chance=Random(seed),
    )


@pytest.mark.hazard("H30")
@pytest.mark.parametrize("left_out", ["nothing", "blocking", "lost", "a turn", "the stop", "broadcasts"])
def test_a_lead_without_one_of_its_terms_is_too_short(left_out: str) -> None:
    """And with all of them, the same storm delays a drive to the last moment, and no further."""
    line = stormy(0)
    worst, turn = line.worst, line.worst.turns["d0"]
    terms = {
        "nothing": 0.0,
        "blocking": worst.blocking.seconds,
        "lost": worst.lost.seconds,
        "a turn": turn,
        "the stop": worst.stopping,
        "broadcasts": worst.broadcasts,
    }
    line.lead -= terms[left_out]
    line.timeouts = dict.fromkeys(line.timeouts, PER_TIMEOUT * line.lead * (1 + 1e-9))
    longest = max(longest_gaps(line, 40.0).values())
    if left_out == "nothing":
        assert longest == pytest.approx(1, abs=1e-3)
    else:
        assert longest > 1.01


@pytest.mark.hazard("H29")
@pytest.mark.parametrize("drives", [3, 5, 8])
def test_drives_that_are_all_stopped_singly_and_without_end_keep_a_third_of_their_time_out(drives: int) -> None:
    """More than the premise has: a third of F803 is missed, and two thirds are not."""
    everyone = [f"d{place}" for place in range(drives)]
    for seed in range(3):
        assert 1 <= max(longest_gaps(stormy(seed, drives, everyone), 40.0).values()) < 2


@pytest.mark.hazard("H30")
def test_the_worst_case_is_reached_and_no_more_is_reckoned_than_that() -> None:
    """All fall due at once, just behind the beginning of the longest exchange; the last is heard on the last moment.

    The first loses its exchange, is asked again, and is stopped thereafter: a stop before would refresh it.
    """
    names = [f"d{place}" for place in range(8)]
    worst = WorstCase(Longest(0.12, ""), Longest(0.09, ""), dict.fromkeys(names, 0.036), 0.03)
    keepalive, now = Keepalive(worst.lead), worst.lead - 1e-6
    for name in names:
        keepalive.arm(name, PER_TIMEOUT * 2 * worst.lead)
        keepalive.heard(name, 0.0)
    assert keepalive.lets_through(now)
    keepalive.let_through(now)
    now += worst.blocking.seconds
    assert keepalive.goes_ahead(BROADCAST, now, BROADCASTS_AHEAD)
    now += worst.broadcasts
    now += worst.lost.seconds
    keepalive.missed(names[0])
    for name in names:
        assert not keepalive.lets_through(now)
        assert keepalive.due(now) == name
        now += worst.turns[name]
        keepalive.heard(name, now)
        if name == names[0]:
            assert keepalive.goes_ahead(name, now)
            keepalive.went_ahead(name, now)
            now += worst.stopping
            assert not keepalive.goes_ahead(name, now)
    assert now == pytest.approx(2 * worst.lead, abs=1e-5)


@pytest.mark.hazard("H30")
def test_drives_that_are_due_without_end_leave_the_others_an_exchange_in_each_lead() -> None:
    """Nothing but the keepalive talks to them, and each has the shortest F803 that can be kept."""
    names = [f"d{place}" for place in range(8)]
    worst = WorstCase(Longest(0.12, ""), Longest(0.09, ""), dict.fromkeys(names, 0.036), 0.03)
    keepalive, now, polls = Keepalive(worst.lead), 0.0, 0
    for name in names:
        keepalive.arm(name, PER_TIMEOUT * worst.lead * (1 + 1e-9))
        keepalive.heard(name, 0.0)
    while now < 100.0:
        if keepalive.lets_through(now):
            keepalive.let_through(now)
            now += worst.blocking.seconds
            polls += 1
        elif (drive := keepalive.due(now)) is not None:
            now += worst.turns[drive]
            keepalive.heard(drive, now)
    assert polls == pytest.approx(now / worst.lead, rel=0.1)
