"""Handshakes under way: how many, for how long, and what is said and counted of their ends."""

from __future__ import annotations

import logging
import ssl
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from gateway.metrics import TcpStats
from gateway.modbus_tcp.handshakes import (
    DONE,
    KINDS,
    NO_ROLE,
    OTHER,
    PACE,
    PUSHED_OUT,
    STALLED,
    Handshakes,
    explain,
)


@dataclass(eq=False)
class Hand:
    """A handshake that ends when it is told to."""

    host: str
    hall: Handshakes
    ends: list[tuple[str, str]] = field(default_factory=list)
    went_on: int = 0

    def go_on(self) -> None:
        """Count it."""
        self.went_on += 1

    def give_up(self, kind: str, reason: str) -> None:
        """End, as a client's connection does."""
        self.ends.append((kind, reason))
        self.hall.end(self, kind, reason, 0.0)


@dataclass
class Alarms:
    """Timers that ring when a test says so."""

    set: list[Callable[[], None]] = field(default_factory=list)

    def __call__(self, seconds: float, call: Callable[[], None]) -> Alarms:
        """Put a call off."""
        assert seconds == PACE
        self.set.append(call)
        return self

    def cancel(self) -> None:
        """Let none ring."""
        self.set.clear()

    def ring(self) -> None:
        """Let the one that is set ring."""
        (call,) = self.set
        self.set.clear()
        call()


def handshakes(stats: TcpStats, alarms: Alarms | None = None) -> Handshakes:
    """Return a hall for three at a time, of five seconds each."""
    return Handshakes(3, 5.0, stats, alarms or Alarms())


@pytest.mark.hazard("H25")
def test_a_flood_of_handshakes_is_done_one_by_one() -> None:
    """Three as they come, then one each 50 ms in their order; who has left is passed over."""
    alarms = Alarms()
    hall = handshakes(TcpStats(), alarms)
    hands = [Hand(f"10.0.0.{i}", hall) for i in range(6)]
    for hand in hands[:3]:
        assert hall.may_go_on(hand, 1.0)
    for hand in hands[3:]:
        assert not hall.may_go_on(hand, 1.0)
    hall.end(hands[4], "left", "", 1.0)
    alarms.ring()
    assert [hand.went_on for hand in hands] == [0, 0, 0, 1, 0, 0]
    alarms.ring()
    assert [hand.went_on for hand in hands] == [0, 0, 0, 1, 0, 1]
    alarms.ring()
    assert alarms.set == []
    assert not hall.may_go_on(hands[0], 1.04)
    alarms.ring()
    assert hall.may_go_on(hands[1], 9.0)


@pytest.mark.hazard("H25")
def test_with_too_many_the_oldest_of_the_greediest_host_gives_way() -> None:
    """A host that begins a hundred pushes out its own."""
    stats = TcpStats()
    hall = handshakes(stats)
    quiet = Hand("10.0.0.1", hall)
    greedy = [Hand("10.0.0.2", hall) for _ in range(100)]
    for hand in (quiet, *greedy):
        hall.begin(hand, 0.0)
        assert len(hall) <= 3
    assert quiet.ends == []
    assert [len(hand.ends) for hand in greedy] == [1] * 98 + [0, 0]
    assert stats.handshakes == {PUSHED_OUT: 98}


@pytest.mark.hazard("H25")
def test_a_handshake_that_takes_too_long_is_given_up() -> None:
    """Counted from its beginning; one that is done is not looked at again."""
    stats = TcpStats()
    hall = handshakes(stats)
    first, second, third = (Hand("10.0.0.1", hall) for _ in range(3))
    for hand, now in ((first, 0.0), (second, 0.0), (third, 2.0)):
        hall.begin(hand, now)
    hall.end(second, DONE, "", 1.0)
    hall.sweep(5.0)
    assert first.ends == []
    hall.sweep(5.1)
    assert [kind for kind, _ in first.ends] == [STALLED]
    assert (second.ends, third.ends) == ([], [])
    hall.end(first, DONE, "", 6.0)
    assert stats.handshakes == {DONE: 1, STALLED: 1}
    hall.give_up_all()
    assert (len(hall), stats.handshakes[OTHER]) == (0, 1)


def test_the_same_end_of_the_same_host_is_told_once_a_minute(caplog: pytest.LogCaptureFixture) -> None:
    """A client that tries again every second fills no log; another host, or another reason, is told."""
    caplog.set_level(logging.WARNING)
    stats = TcpStats()
    hall = handshakes(stats)

    def end(host: str, kind: str, now: float) -> None:
        hand = Hand(host, hall)
        hall.begin(hand, now)
        hall.end(hand, kind, f"no TLS: {kind}", now)

    for now in range(60):
        end("10.0.0.1", "expired", float(now))
    end("10.0.0.2", "expired", 59.0)
    end("10.0.0.1", NO_ROLE, 59.0)
    end("10.0.0.1", DONE, 59.0)
    end("10.0.0.1", "expired", 60.0)
    assert caplog.messages == [
        "10.0.0.1: no TLS: expired",
        "10.0.0.2: no TLS: expired",
        "10.0.0.1: no TLS: no_role",
        "10.0.0.1: no TLS: expired",
    ]
    for i in range(1000):
        end(f"10.1.{i // 256}.{i % 256}", "expired", 61.0)
    assert len(hall._told) <= 257


@pytest.mark.parametrize(("text", "kind"), [(part, kind) for part, kind, _ in KINDS])
def test_what_openssl_says_is_put_into_the_operators_words(text: str, kind: str) -> None:
    """Each has a kind, and says what may be done."""
    error = ssl.SSLError(1, f"[SSL: X] handshake: {text} (_ssl.c:1)")
    assert explain(error)[0] == kind


def test_what_is_not_known_is_told_as_it_is() -> None:
    """Nothing is passed over."""
    kind, reason = explain(ssl.SSLError(1, "something new"))
    assert kind == OTHER
    assert "something new" in reason
