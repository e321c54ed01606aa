"""Places: who is served when many want to be, whose place is kept, and who may not come at all."""

from __future__ import annotations

import logging
import random

import pytest

from gateway.config import ModbusTcpSection
from gateway.metrics import TcpStats
from gateway.modbus_tcp.hosts import host_of, peer_name
from gateway.modbus_tcp.places import Places, limits_of
from tests.modbus_tcp.rig import Rig
from tests.soak import FACTOR


class Guest:
    """One who takes a place."""

    def overdue(self, now: float, idle_timeout: float) -> str | None:
        """Never be overdue."""
        return None

    def cut(self, reason: str) -> None:
        """Do nothing."""


class Hall:
    """Places by a configuration."""

    def __init__(self, **section: object) -> None:
        self.stats = TcpStats()
        self.places = Places(limits_of(ModbusTcpSection.model_validate(section)), self.stats)
        self.guests: list[Guest] = []

    def come(self, host: str) -> bool:
        """Let one come; say whether it is served."""
        guest = Guest()
        is_served = self.places.take(guest, host)
        if is_served:
            self.guests.append(guest)
        return is_served

    def leave(self, place: int = 0) -> None:
        """Let one leave."""
        self.places.give_back(self.guests.pop(place))


PLC = {"addresses": ["10.0.0.7", "10.0.1.0/30"], "places": 2}


@pytest.mark.hazard("H25")
def test_the_thirty_third_is_turned_away_and_nobody_is_put_out_for_it() -> None:
    """As shipped: 32 places, first come, first served, all of one address if it likes."""
    hall = Hall()
    assert [hall.come("10.0.0.1") for _ in range(33)] == [True] * 32 + [False]
    assert (hall.stats.connections, hall.stats.accepted, hall.stats.turned_away) == (32, 32, 1)
    hall.leave()
    assert hall.come("10.0.0.2")


@pytest.mark.hazard("H25")
def test_one_address_takes_no_more_than_its_share() -> None:
    """The others still find places; IPv4 clients of an IPv6 socket are the same clients."""
    hall = Hall(connections=4, per_address=2)
    mapped = host_of(("::ffff:10.0.0.1", 1, 0, 0))
    assert [hall.come(host) for host in ("10.0.0.1", mapped, mapped, "10.0.0.2")] == [True, True, False, True]
    hall.leave()
    assert hall.come("10.0.0.1")
    assert hall.stats.turned_away == 1


@pytest.mark.hazard("H25")
def test_places_are_kept_for_those_who_are_named() -> None:
    """They come in when all others are turned away, and beyond what is kept they are like all others."""
    hall = Hall(connections=5, per_address=3, reserved=[PLC])
    assert [hall.come(f"10.9.0.{i}") for i in range(4)] == [True, True, True, False]
    assert [hall.come(host) for host in ("10.0.0.7", "10.0.1.2", "10.0.0.7")] == [True, True, False]
    hall.leave(0)
    assert hall.come("10.0.0.7")
    assert hall.stats.connections == 5


@pytest.mark.hazard("H25")
def test_a_kept_place_is_beyond_the_share_of_an_address() -> None:
    """What was promised is there."""
    hall = Hall(connections=9, per_address=1, reserved=[PLC])
    assert [hall.come("10.0.0.7") for _ in range(3)] == [True, True, False]


@pytest.mark.hazard("H25")
def test_kept_places_are_kept_whoever_comes_and_goes() -> None:
    """By seed: who is named always finds a place while it has fewer than are kept, and there are never too many."""
    chance = random.Random(25)
    groups = [{"addresses": ["10.0.0.1", "10.0.0.2"], "places": 2}, {"addresses": ["10.0.0.3"], "places": 1}]
    for _ in range(40 * FACTOR):
        hall = Hall(connections=6, reserved=groups)
        served: list[str] = []
        for _ in range(60):
            if served and chance.random() < 0.45:
                place = chance.randrange(len(served))
                hall.leave(place)
                del served[place]
                continue
            host = f"10.0.0.{chance.randint(1, 5)}"
            ours = sum(one in ("10.0.0.1", "10.0.0.2") for one in served)
            is_promised = (host[-1] in "12" and ours < 2) or (host[-1] == "3" and "10.0.0.3" not in served)
            is_served = hall.come(host)
            assert is_served or not is_promised
            served += [host] * is_served
            assert len(served) == hall.stats.connections <= 6
            assert list(hall.places.taken.values()) == served or sorted(hall.places.taken.values()) == sorted(served)


@pytest.mark.hazard("H28")
@pytest.mark.parametrize(
    ("peer", "is_served"),
    [
        ("10.1.2.3", True),
        ("::ffff:10.1.2.3", True),
        ("11.0.0.1", False),
        ("::ffff:11.0.0.1", False),
        ("fd00::7", True),
        ("fd01::7", False),
        ("fe80::1%eth0", True),
        ("::1", False),
        ("", False),
    ],
)
def test_only_who_is_allowed_is_let_in(peer: str, is_served: bool) -> None:
    """By IPv4, by IPv6, by IPv4 over an IPv6 socket, with a zone."""
    hall = Hall(allow=["10.0.0.0/8", "fd00::/16", "fe80::/10"])
    assert hall.come(host_of((peer, 1))) is is_served
    assert hall.stats.not_allowed == (not is_served)
    assert hall.stats.turned_away == 0


def test_who_is_turned_away_again_and_again_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    """Once an address, and no more than some hundred of them."""
    hall = Hall(allow=["10.0.0.0/8"], per_address=1)
    hall.come("10.0.0.1")
    for _ in range(3):
        hall.come("10.0.0.1")
        hall.come("11.0.0.1")
    assert [record.levelno for record in caplog.records] == [logging.WARNING] * 2
    for i in range(600):
        hall.come(f"11.0.{i // 256}.{i % 256}")
    assert len(caplog.records) <= 256
    assert hall.stats.not_allowed == 603


@pytest.mark.hazard("H25")
def test_a_connection_that_finds_no_place_is_cut_and_its_address_is_what_counts() -> None:
    """The connection tells its address to the places."""
    rig = Rig(limit=2)
    assert not rig.connect("::ffff:10.0.0.1").is_closed
    assert list(rig.places.taken.values()) == ["10.0.0.1"]
    wire = rig.connect("10.0.0.2")
    wire.abort()
    assert list(rig.places.taken.values()) == ["10.0.0.1"]


@pytest.mark.parametrize(
    ("peer", "name"),
    [
        (("10.0.0.1", 50123), "10.0.0.1:50123"),
        (("::ffff:10.0.0.1", 50123, 0, 0), "10.0.0.1:50123"),
        (("2001:db8::7", 50123, 0, 0), "[2001:db8::7]:50123"),
        (None, "a client that is gone"),
    ],
)
def test_a_client_is_called_by_address_and_port(peer: tuple[object, ...] | None, name: str) -> None:
    """In the log, as people write it."""
    assert peer_name(peer) == name
