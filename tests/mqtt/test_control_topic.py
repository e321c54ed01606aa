"""Who may command a drive is on the broker, and never an old word of it."""

from __future__ import annotations

import json
from typing import Any

import pytest

from gateway.control.command import Channel, Command, Result, Source, Verb
from gateway.control.door import Door
from gateway.image import Image
from gateway.metrics import MqttStats
from gateway.mqtt.outlet import PER_VALUE
from gateway.mqtt.publisher import Publisher
from tests.mqtt.doors import DIRECT, LEASED, READ_ONLY, StandingClock, small_site
from tests.mqtt.rig import section
from tests.mqtt.test_publisher import Broker

HMI = Source(Channel.MQTT, "hmi")


class Told:
    """A publisher of the small site, and a broker that remembers."""

    def __init__(self) -> None:
        self.clock = StandingClock()
        self.door = Door.of(small_site(), self.clock)
        self.broker = Broker(room=100_000)
        image = Image(small_site().drives)
        self.publisher = Publisher(section(), "hall-3", image, MqttStats(), self.door.controls)
        self.door.on_event(lambda drive, _event, _reason: self.publisher.owe_standing(drive))
        self.publisher.owe_everything()
        self.settle()

    def settle(self) -> None:
        """Send what is owed, as far as there is room."""
        while self.publisher.is_owing and self.broker.room >= PER_VALUE:
            self.publisher.settle(self.broker, self.clock.now(), 4)

    def ask(self, drive: str, verb: Verb) -> Result:
        """Command a drive whose answer comes at once."""
        results: list[Result] = []
        now = self.clock.now()
        self.door.submit(Command(drive, verb, HMI, now, now + 1.0), results.append)
        return results[0]

    def control(self, drive: str) -> dict[str, Any]:
        """Return what the broker keeps of who may command a drive."""
        found: dict[str, Any] = json.loads(self.broker.retained[f"tosvert/hall-3/{drive}/control"])
        return found


def test_a_connect_tells_who_may_command_every_drive() -> None:
    """How it is controlled, how it stands, why, and whose it is."""
    told = Told()
    start = {"standing": "disarmed", "reason": "the gateway has started", "owner": None}
    assert told.control(LEASED) == {"mode": "leased", **start}
    assert told.control(DIRECT) == {"mode": "direct", **start}
    assert told.control(READ_ONLY) == {"mode": "off", "standing": None, "reason": "", "owner": None}


def test_an_owner_is_told_and_so_is_the_end_of_his_lease() -> None:
    """At every event, and once."""
    told = Told()
    told.ask(LEASED, Verb.TAKE)
    told.settle()
    assert told.control(LEASED)["owner"] == "mqtt hmi"
    told.broker.topics()
    told.ask(LEASED, Verb.TAKE)
    told.settle()
    assert not told.broker.topics()
    told.clock.seconds += 60.0
    told.door.controls[LEASED].tick(told.clock.now())
    told.settle()
    assert told.control(LEASED)["owner"] is None
    assert told.control(LEASED)["reason"] == "the lease of mqtt hmi has ended"


def test_a_change_without_a_word_is_found() -> None:
    """By looking from time to time."""
    told = Told()
    told.publisher.look(0.0)
    assert not told.publisher.is_owing
    told.door.controls[LEASED].lease.take(HMI, told.clock.now())
    told.publisher.look(0.0)
    told.settle()
    assert told.control(LEASED)["owner"] == "mqtt hmi"


@pytest.mark.hazard("H24")
def test_a_change_that_finds_no_room_is_told_later_as_it_is_then() -> None:
    """Nothing is dropped for good."""
    told = Told()
    told.broker.room = 0
    told.ask(LEASED, Verb.TAKE)
    told.settle()
    assert told.publisher.is_owing
    assert told.control(LEASED)["owner"] is None
    told.ask(LEASED, Verb.RELEASE)
    told.ask(LEASED, Verb.TAKE)
    told.broker.room = 100
    told.settle()
    assert told.control(LEASED)["owner"] == "mqtt hmi"
    assert not told.publisher.is_owing


def test_the_end_of_the_gateway_takes_the_word_back() -> None:
    """Nobody may command what nobody serves."""
    told = Told()
    told.publisher.leave(told.broker, told.clock.now())
    assert not [topic for topic in told.broker.retained if topic.endswith("/control")]
