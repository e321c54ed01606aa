"""A gateway that stood still: what lay in its sockets meanwhile is as old as that (SAFETY.md H23)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.door import STALLED, Door

LEASE = 2.0  # seconds
DASHBOARD = Source(Channel.MQTT, "dashboard")
DRIVE: dict[str, Any] = {
    "name": "d1",
    "number": 1,
    "model": "vf-nc3",
    "control": "leased",
    "lease": f"{LEASE}s",
    "communication_timeout": "10s",
    "timeout_action": "stop",
}


@dataclass
class HandClock:
    """A clock that is moved by hand."""

    time: float = 1000.0

    def now(self) -> float:
        """Return monotonic seconds."""
        return self.time

    def wall(self) -> float:
        """Return UTC seconds."""
        return self.time

    def alarm(self) -> Any:
        """Make no timer: nobody waits here."""
        raise NotImplementedError


@pytest.fixture
def door() -> Door:
    """Return the door of a drive that is online and owned, its owner heard a moment ago."""
    line = {"name": "a", "port": "/dev/null", "drive": [DRIVE]}
    door = Door.of(site.build({"gateway": {"name": "t"}, "line": [line]}, "test", Path()), HandClock())
    door.controls["d1"].presence.on_online({"communication_timeout": 100, "timeout_action": 2}, {}, door.clock.now())
    door.pulse()
    assert ask(door, Verb.TAKE).status is Status.DONE
    door.beat("d1", DASHBOARD, 1)
    door.beat("d1", DASHBOARD, 2)
    return door


def ask(door: Door, verb: Verb) -> Result:
    """Submit a command of the owner; return its result, which comes at once."""
    now, results = door.clock.now(), list[Result]()
    door.submit(Command("d1", verb, DASHBOARD, now, now + 1.0), results.append)
    return results[0]


def stand_still(door: Door, seconds: float) -> None:
    """Let time pass without a sign of life of the event loop."""
    assert isinstance(door.clock, HandClock)
    door.clock.time += seconds


@pytest.mark.hazard("H23")
@pytest.mark.parametrize("seconds", [STALLED + 0.01, LEASE / 2, LEASE - 0.01])
def test_a_heartbeat_read_after_a_standstill_counts_from_before_it(door: Door, seconds: float) -> None:
    """Nobody knows when it was sent: the lease is no longer than if it had come before."""
    lease = door.controls["d1"].lease
    stood = door.clock.now()
    stand_still(door, seconds)
    door.beat("d1", DASHBOARD, 3)
    assert lease.until == stood + LEASE


@pytest.mark.hazard("H23")
@pytest.mark.parametrize("verb", [Verb.TAKE, Verb.ARM])
@pytest.mark.parametrize("seconds", [STALLED + 0.01, 0.99])
def test_a_command_read_after_a_standstill_counts_from_before_it(door: Door, verb: Verb, seconds: float) -> None:
    """Its controller may be dead by now: the lease is no longer than if it had come before."""
    lease = door.controls["d1"].lease
    stood = door.clock.now()
    stand_still(door, seconds)
    now = door.clock.now()
    door.submit(Command("d1", verb, DASHBOARD, now, now + 1.0), lambda _: None)
    assert lease.until == pytest.approx(stood + LEASE)


@pytest.mark.hazard("H11", "H23")
def test_a_command_read_after_a_standstill_has_so_much_less_time_left() -> None:
    """But a stop, which never is too late."""
    command = Command("d1", Verb.RUN, DASHBOARD, 1000.0, 1001.0)
    assert command.older_by(0.0) is command
    old = command.older_by(0.4)
    assert (old.received, old.deadline) == (999.6, 1000.6)
    stop = Command("d1", Verb.STOP, DASHBOARD, 1000.0, 1001.0).older_by(0.4)
    assert (stop.received, stop.deadline) == (999.6, 1001.0)


@pytest.mark.hazard("H11", "H23")
@pytest.mark.parametrize(("word", "is_taken"), [(0x8000, True), (0x0000, True), (0xC400, False)])
def test_a_raw_stop_read_after_a_standstill_is_not_too_late(door: Door, word: int, *, is_taken: bool) -> None:
    """As a typed one is not: it goes to the line, and what starts a motor does not."""
    stand_still(door, LEASE / 2 + 0.1)
    now, results = door.clock.now(), list[Result]()
    command = Command("d1", Verb.WORDS, DASHBOARD, now, now + 1.0, address=0xFA00, words=(word,))
    door.submit(command, results.append)
    assert door.controls["d1"].has_stop is is_taken
    assert [result.reason for result in results] == ([] if is_taken else [Reason.EXPIRED])


@pytest.mark.hazard("H23")
@pytest.mark.parametrize("seconds", [LEASE, 60.0])
def test_after_a_standstill_longer_than_the_lease_nothing_brings_it_back(door: Door, seconds: float) -> None:
    """Neither a heartbeat nor a command of the owner; the loss is dealt with before either is looked at."""
    told: list[str] = []
    door.on_event(lambda _drive, event, _reason: told.append(event))
    stand_still(door, seconds)
    door.beat("d1", DASHBOARD, 3)
    assert door.controls["d1"].lease.owner is None
    assert told[0] == "lease_lost"
    for reason in (Reason.EXPIRED, Reason.NOT_OWNER):  # it may have lain there; a fresh one finds no lease
        result = ask(door, Verb.ARM)
        assert (result.status, result.reason) == (Status.REFUSED, reason)
        for _ in range(3):  # a while after the standstill was noticed
            door.pulse()
            stand_still(door, STALLED / 2)


def test_a_living_event_loop_counts_heartbeats_as_they_come(door: Door) -> None:
    """The pulse comes ten times a second; what is a little late is no standstill."""
    lease = door.controls["d1"].lease
    for beat in range(3, 100):
        stand_still(door, STALLED - 0.01)
        door.beat("d1", DASHBOARD, beat)
        assert lease.until == door.clock.now() + LEASE
        door.pulse()
