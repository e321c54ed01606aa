"""The ring keeps the latest, within its bounds; faults are written seldom, and with what followed them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from gateway.image import LinkState
from gateway.trace.faults import BURST, BURST_WITHIN, FOLLOWING, BadReplies, DriveWatch, Occasions
from gateway.trace.record import Told, Unasked, Verdict, cost
from gateway.trace.ring import Ring
from tests.trace.plays import answered, record

PAUSE = 60.0


@given(st.lists(st.integers(0, 300), max_size=60), st.integers(0, 20), st.integers(0, 2000))
def test_the_ring_keeps_the_latest_within_both_bounds(sizes: list[int], most: int, most_bytes: int) -> None:
    """And no fewer than fit."""
    ring = Ring(most, most_bytes)
    told: list[Told] = [Unasked(0.0, bytes(size)) if size % 2 else answered(float(size)) for size in sizes]
    for one in told:
        ring.add("a", one)
    kept = [one for _, one in ring.all()]
    assert kept == told[len(told) - len(kept) :]
    assert sum(cost(one)[0] for one in kept) <= most
    assert sum(cost(one)[1] for one in kept) <= most_bytes
    if len(kept) < len(told):
        more = told[len(told) - len(kept) - 1 :]
        assert sum(cost(one)[0] for one in more) > most or sum(cost(one)[1] for one in more) > most_bytes


def bad(when: float) -> Told:
    """Return an exchange that brought a bad reply, and was done then."""
    return record(verdict=Verdict.BAD_REPLY, begun=when - 0.02)


def test_bad_replies_are_a_fault_when_they_come_in_a_burst() -> None:
    """Five in ten seconds, and the next burst needs five again; one now and then is noise."""
    watch = BadReplies()
    assert [watch.take(bad(float(second))) for second in range(2 * BURST)] == ([False] * (BURST - 1) + [True]) * 2
    watch = BadReplies()
    assert not any(watch.take(bad(when * (BURST_WITHIN / BURST + 1))) for when in range(50))
    assert not any(watch.take(answered(float(when))) for when in range(50))


def test_a_lost_link_is_a_fault_once() -> None:
    """Not before it was there, and again only after it came back."""
    states = [LinkState.STARTING, LinkState.OFFLINE, LinkState.ONLINE, LinkState.SUSPECT, LinkState.OFFLINE]
    states += [LinkState.OFFLINE, LinkState.ONLINE, LinkState.LINE_DOWN, LinkState.ONLINE, LinkState.STRANGER]
    watch = DriveWatch()
    told = [watch.take(state, None) for state in states]
    assert told == [None, None, None, None, "offline", None, None, "line down", None, "stranger"]


def test_a_trip_is_a_fault_when_it_comes() -> None:
    """Not one that was there before anybody looked."""
    watch = DriveWatch()
    flags = [None, True, None, False, True, True, None, True, False, True]
    told = [watch.take(LinkState.ONLINE, flag) for flag in flags]
    assert told == [None, None, None, None, "tripped", None, None, None, None, "tripped"]


def test_a_file_is_due_some_time_after_the_first_fault_and_names_all() -> None:
    """What followed is in it; the same reason is named once."""
    occasions = Occasions(PAUSE)
    for when, reason in ((10.0, "pump-1: offline"), (10.5, "fan-1: offline"), (11.0, "pump-1: offline")):
        occasions.fault(reason, when)
        assert occasions.take(when) is None
    assert occasions.take(10.0 + FOLLOWING) == "pump-1: offline; fan-1: offline"
    assert occasions.take(1000.0) is None


def test_faults_within_the_pause_are_counted_and_make_no_file() -> None:
    """A flapping drive fills no disk; the next file says how many there were."""
    occasions = Occasions(PAUSE)
    occasions.fault("one", 0.0)
    assert occasions.take(FOLLOWING) == "one"
    for when in range(3, 60):
        occasions.fault("two", float(when))
        assert occasions.take(when + FOLLOWING) is None
    occasions.fault("three", FOLLOWING + PAUSE)
    assert occasions.take(PAUSE + 2 * FOLLOWING) == "three (since the file before: 57 faults without a file)"
