"""The door: unknown drives, a gateway that stood still, and one result for everybody who listens."""

from __future__ import annotations

from pathlib import Path

import pytest

from gateway import site
from gateway.clock import Alarm
from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.door import Door
from gateway.control.ledger import MemoryLedger

ONE = Source(Channel.MQTT, "one")


class SetClock:
    """A clock that stands where it is set."""

    def __init__(self) -> None:
        self.at = 100.0

    def now(self) -> float:
        """Return monotonic seconds."""
        return self.at

    def wall(self) -> float:
        """Return UTC seconds."""
        return 1_700_000_000.0 + self.at

    def alarm(self) -> Alarm:
        """Make none."""
        raise NotImplementedError


def made(clock: SetClock) -> Door:
    """Return the door of a site with one leased drive and one that is only read."""
    drives = [
        {"name": "d1", "number": 1, "model": "vf-nc3", "control": "leased", "lease": "2s"},
        {"name": "d2", "number": 2, "model": "vf-nc3"},
    ]
    table = {"gateway": {"name": "t"}, "line": [{"name": "a", "port": "/dev/null", "drive": drives}]}
    return Door.of(site.build(table, "test", Path()), clock)


def ask(door: Door, verb: Verb, drive: str = "d1") -> list[Result]:
    """Submit a command that is good for a second; return what came at once."""
    results: list[Result] = []
    now = door.clock.now()
    door.submit(Command(drive, verb, ONE, now, now + 1.0), results.append)
    return results


def test_a_drive_that_is_unknown_or_read_only_is_refused() -> None:
    """With a reason each; listeners and audit hear of it too."""
    door = made(SetClock())
    heard: list[Result] = []
    door.on_result(heard.append)
    assert [r.reason for r in ask(door, Verb.STOP, "d3")] == [Reason.UNKNOWN_DRIVE]
    assert [r.reason for r in ask(door, Verb.STOP, "d2")] == [Reason.NOT_CONTROLLED]
    assert [r.reason for r in heard] == [Reason.UNKNOWN_DRIVE, Reason.NOT_CONTROLLED]
    assert isinstance(door.ledger, MemoryLedger)
    assert [entry.reason for entry in door.ledger.entries] == ["unknown_drive", "not_controlled"]


@pytest.mark.hazard("H23")
def test_a_heartbeat_that_lay_in_the_socket_while_the_gateway_stood_still_counts_from_before() -> None:
    """Its controller may be dead by now; after a standstill as long as the lease nothing revives it."""
    for standstill, is_renewed in ((0.2, True), (1.5, True), (2.5, False)):
        clock = SetClock()
        door = made(clock)
        door.pulse()
        assert ask(door, Verb.TAKE)[0].status is Status.DONE
        door.beat("d1", ONE, b"1")
        began = clock.at
        clock.at += standstill
        door.beat("d1", ONE, b"2")
        lease = door.controls["d1"].lease
        assert (lease.owner is not None) is is_renewed
        if is_renewed:
            assert lease.until == began + 2.0 + (standstill if standstill < 0.3 else 0.0)


@pytest.mark.hazard("H11", "H23")
def test_a_command_that_lay_there_for_longer_than_it_is_good_for_is_refused() -> None:
    """A stop is not."""
    clock = SetClock()
    door = made(clock)
    door.pulse()
    clock.at += 1.1
    assert [r.reason for r in ask(door, Verb.TAKE)] == [Reason.EXPIRED]
    assert [r.reason for r in ask(door, Verb.STOP)] == [Reason.OFFLINE]
    door.pulse()
    assert [r.reason for r in ask(door, Verb.TAKE)] == [Reason.EXPIRED]  # timers may run before the sockets are read
    clock.at += 0.2
    door.pulse()
    clock.at += 0.2
    door.pulse()
    assert [r.status for r in ask(door, Verb.TAKE)] == [Status.DONE]


def test_leases_end_even_where_no_line_looks_at_them() -> None:
    """A line that is down asks nothing: the pulse of the gateway does."""
    clock = SetClock()
    door = made(clock)
    events: list[tuple[str, str, str]] = []
    door.on_event(lambda *event: events.append(event))
    ask(door, Verb.TAKE)
    clock.at += 2.1
    door.pulse()
    assert ("d1", "lease_lost", "the lease of mqtt one has ended") in events
