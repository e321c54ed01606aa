"""The keepalive: a deadline that every good exchange pushes on, and what goes before it."""

from __future__ import annotations

import pytest

from gateway.bus.keepalive import BROADCASTS_AHEAD, Keepalive

LEAD = 0.2  # seconds


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
