"""The small parts of a drive's control: the lease, what is known by id, and whether a motor is seen to stop."""

from __future__ import annotations

import pytest

from gateway.control.command import Channel, Command, Result, Source, Status, Verb
from gateway.control.following import EVERY, WITHIN, Following
from gateway.control.lease import Lease
from gateway.control.results import REMEMBERED, REMEMBERED_FOR, Results
from gateway.drives.catalogue import load

NC3 = load()["vf-nc3"]
ONE, TWO = Source(Channel.MQTT, "one"), Source(Channel.MODBUS_TCP, "two")


def command(
    number: str = "", source: Source = ONE, verb: Verb = Verb.RUN, received: float = 0.0
) -> Command:
    """Return a command with an id."""
    return Command("d1", verb, source, received, received + 1.0, id=number)


@pytest.mark.hazard("H04")
def test_a_lease_has_one_owner_until_it_is_given_back_or_dealt_with() -> None:
    """A lapsed one is not there for the taking before its loss is dealt with."""
    lease = Lease(2.0)
    assert lease.take(ONE, 10.0)
    assert not lease.take(TWO, 11.0)
    assert lease.take(ONE, 11.0)
    assert lease.until == 13.0
    assert lease.is_over(13.0)
    assert not lease.take(TWO, 13.0)
    lease.end()
    assert lease.take(TWO, 13.0)


@pytest.mark.hazard("H05")
def test_only_a_changed_heartbeat_of_the_owner_is_a_sign_of_life() -> None:
    """Not the first one, not a repeated one, not another's, not a late one."""
    lease = Lease(2.0)
    lease.take(ONE, 10.0)
    assert not lease.beat(ONE, b"1", 11.0)
    assert not lease.beat(ONE, b"1", 11.5)
    assert not lease.beat(TWO, b"2", 11.5)
    assert lease.beat(ONE, b"2", 11.5)
    assert lease.until == 13.5
    assert not lease.beat(ONE, b"3", 13.5)


@pytest.mark.hazard("H03")
def test_a_known_id_gets_the_first_result_even_while_it_is_awaited() -> None:
    """Each source has ids of its own; a command without one is never a repetition."""
    results = Results()
    told: list[Result] = []
    answer = results.remembering(command("7"), told.append)
    assert results.is_known(command("7"), told.append)
    assert not results.is_known(command("7", TWO), told.append)
    assert not results.is_known(command(), told.append)
    result = Result(command("7"), Status.DONE)
    answer(result)
    assert told == [result, result]
    assert results.is_known(command("7"), told.append)
    assert told == [result] * 3
    assert results.is_known(command("7", received=REMEMBERED_FOR), told.append)
    assert not results.is_known(command("7", received=REMEMBERED_FOR + 0.1), told.append)


@pytest.mark.hazard("H03", "H29")
def test_a_stop_is_answered_from_memory_only_while_it_is_under_way() -> None:
    """Somebody may have run the motor since: a button that always sends the same id stops it again."""
    results = Results()
    told: list[Result] = []
    answer = results.remembering(command("7", verb=Verb.STOP), told.append)
    assert results.is_known(command("7", verb=Verb.STOP), told.append)
    answer(Result(command("7", verb=Verb.STOP), Status.DONE))
    assert not results.is_known(command("7", verb=Verb.STOP), told.append)
    results.remembering(command("7", verb=Verb.STOP), told.append)
    assert results.is_known(command("7", verb=Verb.STOP), told.append)


def test_ids_are_forgotten_oldest_first_but_never_while_under_way() -> None:
    """Bounded, whatever a controller sends."""
    results = Results()
    told: list[Result] = []
    results.remembering(command("waits"), told.append)
    for number in range(REMEMBERED + 10):
        done = command(str(number))
        results.remembering(done, told.append)(Result(done, Status.DONE))
    assert results.is_known(command("waits"), told.append)
    assert not results.is_known(command("0"), told.append)
    assert results.is_known(command(str(REMEMBERED + 9)), told.append)


def looks(following: Following, words: dict[str, list[int]], seconds: float) -> None:
    """Look at a motor for a while."""
    now = following.since
    while now < following.since + seconds:
        register = following.next(now)
        if register is not None:
            found = words[register.name]
            following.take(register, found.pop(0) if len(found) > 1 else found[0])
        now += EVERY


@pytest.mark.parametrize(
    ("status", "output", "is_seen"),
    [
        ([0x4000], [3000], True),  # stands
        ([0x0402], [3000], True),  # tripped
        ([0x0400], [3000, 2990], True),  # slows down
        ([0x0400], [3000], False),  # runs on
        ([0x0400], [3000, 3010], False),
    ],
)
@pytest.mark.hazard("H05")
def test_a_motor_is_seen_to_stop_by_its_status_or_its_falling_frequency(
    status: list[int], output: list[int], *, is_seen: bool
) -> None:
    """FD01 and FD00; FA00 that reads back says only that the drive has got the command."""
    following = Following(NC3, 100.0)
    looks(following, {"status": status, "output_frequency": output}, 2.0)
    assert following.is_seen is is_seen
    assert following.is_late(100.0 + WITHIN + 0.1) is not is_seen
