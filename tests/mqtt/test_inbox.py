"""Commands that wait: in order, few, in turn, and of setpoints the newest."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest

from gateway.control.command import Channel, Command, Reason, Result, Source, Verb
from gateway.mqtt.inbox import MOST, Allowance, Inbox, Waiting


def nobody(_result: Result) -> None:
    """Tell nobody."""


def asked(verb: Verb, drive: str = "a", value: int | None = None, by: str = "", **more: Any) -> Waiting:
    """Return a command that is to wait."""
    number = None if value is None else Decimal(value)
    return Waiting(Command(drive, verb, Source(Channel.MQTT, by), 0.0, 1.0, value=number, **more), nobody)


def drained(inbox: Inbox) -> list[Waiting]:
    """Take everything out."""
    taken = []
    while (waiting := inbox.take()) is not None:
        taken.append(waiting)
    return taken


def test_commands_keep_their_order() -> None:
    """What runs and what arms do not overtake each other."""
    inbox = Inbox()
    order = [asked(verb) for verb in (Verb.TAKE, Verb.ARM, Verb.RUN, Verb.RUN, Verb.RELEASE)]
    assert [inbox.put(waiting) for waiting in order] == [None] * 5
    assert drained(inbox) == order
    assert len(inbox) == 0


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("verb", [Verb.FREQUENCY, Verb.SPEED, Verb.ANALOG, Verb.TERMINALS])
def test_of_a_setpoint_the_newest_waits_in_the_place_of_the_oldest(verb: Verb) -> None:
    """The others are given back to be refused."""
    inbox = Inbox()
    older, between, newer = asked(verb, value=1), asked(Verb.SET, name="x", value=2), asked(verb, value=3)
    assert inbox.put(older) is None
    assert inbox.put(between) is None
    assert inbox.put(newer) == (older, Reason.SUPERSEDED)
    assert drained(inbox) == [newer, between]


def test_the_command_word_is_no_setpoint() -> None:
    """A raw word that runs, one that stops and a newer one that runs are three commands."""
    inbox = Inbox()
    order = [asked(Verb.SET, name="command", value=word) for word in (0xC400, 0x8000, 0xC400)]
    assert [inbox.put(waiting) for waiting in order] == [None] * 3
    assert drained(inbox) == order


def test_a_setpoint_does_not_reach_over_another_command() -> None:
    """A motor that was to start at 10 Hz does not start at 20 Hz."""
    inbox = Inbox()
    order = [asked(Verb.FREQUENCY, value=10), asked(Verb.RUN), asked(Verb.FREQUENCY, value=20)]
    assert [inbox.put(waiting) for waiting in order] == [None] * 3
    assert drained(inbox) == order


def test_setpoints_of_different_things_and_sources_are_different() -> None:
    """A register, another one, another controller's."""
    inbox = Inbox()
    order = [
        asked(Verb.SET, name="acceleration_time_1", value=1),
        asked(Verb.SET, name="deceleration_time_1", value=1),
        asked(Verb.SET, name="acceleration_time_1", value=1, by="other"),
    ]
    assert [inbox.put(waiting) for waiting in order] == [None] * 3
    assert drained(inbox) == order


@pytest.mark.hazard("H03")
def test_a_repeated_id_is_not_taken_for_a_newer_value() -> None:
    """Both go to the door, which gives the second the result of the first."""
    inbox = Inbox()
    order = [asked(Verb.FREQUENCY, value=10, id="1"), asked(Verb.FREQUENCY, value=10, id="1")]
    assert [inbox.put(waiting) for waiting in order] == [None] * 2
    assert drained(inbox) == order


@pytest.mark.hazard("H24")
def test_a_flood_for_one_drive_fills_its_own_place_only() -> None:
    """The newest is refused; the others have their turn."""
    inbox = Inbox()
    flood = [asked(Verb.RUN, id=str(number)) for number in range(1000)]
    answers = [inbox.put(waiting) for waiting in flood]
    assert answers[:MOST] == [None] * MOST
    assert answers[MOST:] == [(waiting, Reason.BUSY) for waiting in flood[MOST:]]
    other = asked(Verb.RUN, "b")
    assert inbox.put(other) is None
    assert len(inbox) == MOST + 1
    assert drained(inbox) == [flood[0], other, *flood[1:MOST]]


@pytest.mark.hazard("H10")
def test_all_that_waits_for_a_drive_can_be_taken_at_once() -> None:
    """In order, and nothing of another drive."""
    inbox = Inbox()
    mine, other = [asked(Verb.ARM), asked(Verb.RUN)], asked(Verb.RUN, "b")
    for waiting in (mine[0], other, mine[1]):
        inbox.put(waiting)
    assert list(inbox.take_all("a")) == mine
    assert list(inbox.take_all("a")) == []
    assert drained(inbox) == [other]


def test_an_allowance_is_used_up_and_comes_back() -> None:
    """So many at once, then so many a second, never more at once than that."""
    allowance = Allowance(rate=2.0, most=3.0)
    assert [allowance.take(10.0) for _ in range(4)] == [True, True, True, False]
    assert [allowance.take(10.25), allowance.take(10.5), allowance.take(10.5)] == [False, True, False]
    assert [allowance.take(1000.0) for _ in range(4)] == [True, True, True, False]
