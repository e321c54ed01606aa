"""Several brokers at one door: who commands by one is nobody at another, and neither keeps the other's lease."""

from __future__ import annotations

import json
from typing import Any

import pytest

from gateway.config import DriveSection
from gateway.control.command import Channel, Command, Source, Verb
from gateway.control.door import Door
from gateway.control.settings import settings_of
from gateway.metrics import MqttStats
from gateway.mqtt.description import Description
from gateway.mqtt.discovery import Device
from gateway.mqtt.listener import Listener
from gateway.mqtt.message import Message
from tests.mqtt.doors import DIRECT, LEASED, StandingClock, small_site
from tests.mqtt.rig import section
from tests.mqtt.test_discovery import image
from tests.mqtt.test_listener import Back

LEASE = 2.0  # seconds, as by default


class Place:
    """One broker of a gateway, and the controllers that are there."""

    def __init__(self, name: str, door: Door, clock: StandingClock, **settings: object) -> None:
        self.stats = MqttStats()
        self.back = Back()
        self.listener = Listener(section(name=name, **settings), "hall-3", door, self.stats, clock)
        self.listener.begin(self.back)

    def send(self, topic: str, payload: object) -> None:
        """Let a message come, and be handed on."""
        self.listener.hear(Message(f"tosvert/hall-3/{topic}", json.dumps(payload).encode()))
        while self.listener.hand_over(1):
            pass

    def ask(self, verb: str, number: str, drive: str = LEASED) -> dict[str, Any]:
        """Send a command, and return what became of it."""
        self.send(f"{drive}/command", {"command": verb, "id": number, "source": "hmi"})
        return [said for said in self.back.on(f"tosvert/hall-3/{drive}/result") if said["id"] == number][-1]


class Plant:
    """A door, and two brokers at it."""

    def __init__(self, **cloud: object) -> None:
        self.clock = StandingClock()
        self.door = Door.of(small_site(), self.clock)
        self.plant = Place("plant", self.door, self.clock)
        self.cloud = Place("cloud", self.door, self.clock, **cloud)
        self.door.pulse()

    @property
    def owner(self) -> Source | None:
        """Return who holds the lease now."""
        lease = self.door.controls[LEASED].lease
        return lease.owner if lease.is_held(self.clock.now()) else None

    def wait(self, seconds: float) -> None:
        """Let time pass, in steps that are no standstill."""
        for _ in range(round(seconds * 10)):
            self.clock.seconds += 0.1
            self.door.pulse()


@pytest.mark.hazard("H04")
@pytest.mark.hazard("H37")
def test_one_name_at_two_brokers_is_two_controllers() -> None:
    """The lease is that of the one who took it; the other is told whose it is, and cannot give it back."""
    made = Plant()
    assert made.plant.ask("take", "1")["status"] == "done"
    assert made.owner == Source(Channel.MQTT, "hmi", "plant")
    refused = made.cloud.ask("take", "2")
    assert (refused["status"], refused["reason"], refused["source"]) == ("refused", "not_owner", "mqtt/cloud hmi")
    assert "mqtt/plant hmi" in refused["text"]
    assert made.cloud.ask("release", "3")["status"] == "refused"
    assert made.owner == Source(Channel.MQTT, "hmi", "plant")
    assert made.plant.ask("release", "4")["status"] == "done"
    assert made.cloud.ask("take", "5")["status"] == "done"


@pytest.mark.hazard("H05")
def test_heartbeats_at_another_broker_keep_no_lease() -> None:
    """A mirror of the plant's topics cannot pass for the controller; its own heartbeats do keep it."""
    made = Plant()
    made.plant.ask("take", "1")
    for number in range(30):
        made.wait(0.5)
        made.plant.send(f"{LEASED}/heartbeat", {"source": "hmi", "n": number})
    assert made.owner is not None
    for number in range(10):
        made.wait(0.5)
        made.cloud.send(f"{LEASED}/heartbeat", {"source": "hmi", "n": number})
    assert made.owner is None


@pytest.mark.hazard("H05")
def test_a_lost_broker_ends_no_lease_that_is_held_by_another() -> None:
    """And its own only by the heartbeats that stay away with it."""
    made = Plant()
    made.plant.ask("take", "1")
    made.cloud.ask("take", "2", DIRECT)
    made.cloud.listener.end()
    for number in range(10):
        made.wait(0.5)
        made.plant.send(f"{LEASED}/heartbeat", {"source": "hmi", "n": number})
    assert made.owner == Source(Channel.MQTT, "hmi", "plant")
    made.plant.listener.end()
    made.wait(LEASE - 0.2)
    assert made.owner is not None
    made.wait(0.3)
    assert made.owner is None


@pytest.mark.hazard("H04")
def test_a_stop_is_taken_from_any_broker_that_takes_commands() -> None:
    """Whoever holds the lease: here it comes as far as the owner's own, and no further, since the drive is away."""
    made = Plant()
    made.plant.ask("take", "1")
    assert made.cloud.ask("run", "2")["reason"] == "not_owner"
    assert made.cloud.ask("stop", "3")["reason"] == made.plant.ask("stop", "4")["reason"] == "offline"


@pytest.mark.hazard("H03")
def test_an_id_is_known_where_it_came_from() -> None:
    """The same id at another broker is another controller's command."""
    made = Plant()
    assert made.plant.ask("take", "7")["status"] == "done"
    assert made.plant.ask("take", "7")["status"] == "done"
    assert made.cloud.ask("take", "7")["status"] == "refused"


@pytest.mark.hazard("H28")
@pytest.mark.hazard("H37")
def test_a_broker_without_commands_is_not_listened_to() -> None:
    """Nothing is subscribed; what comes all the same is ignored, and results of others are told there."""
    made = Plant(commands=False)
    assert made.cloud.listener.filters == []
    assert len(made.plant.listener.filters) == 4
    made.cloud.send(f"{LEASED}/command", {"command": "take", "id": "1"})
    made.cloud.send("line/a/command", "stop")
    assert (made.cloud.stats.heard, made.cloud.stats.ignored, made.owner) == (2, 2, None)
    made.plant.ask("take", "2")
    assert [said["id"] for said in made.cloud.back.on(f"tosvert/hall-3/{LEASED}/result")] == ["2"]


@pytest.mark.hazard("H37")
def test_a_right_can_be_that_of_one_broker() -> None:
    """By a pattern; by default of all of them."""
    right = {"source": "mqtt", "broker": "pl*", "name": "hmi"}
    shared = {"name": "p", "number": 1, "model": "vf-nc3", "control": "leased", "unwatched": True}
    drive = DriveSection.model_validate({**shared, "right": [right]})
    settings = settings_of(drive)
    assert settings is not None
    for broker, is_permitted in (("plant", True), ("cloud", False), ("", False)):
        command = Command("p", Verb.RUN, Source(Channel.MQTT, "hmi", broker), 0.0, 1.0)
        assert settings.permits_verb(command) is is_permitted


def test_what_is_told_of_control_is_what_holds_at_that_broker() -> None:
    """No commands in the description, no controls for Home Assistant where nobody is listened to."""
    (drive,) = image({"control": "leased", "unwatched": True}).drives
    for commands, broker in ((True, "plant"), (False, "cloud")):
        settings = section(name=broker, commands=commands, home_assistant={"enabled": True, "heartbeat": True})
        described = json.loads(Description(drive, settings, "hall-3").write())["control"]
        assert bool(described.get("commands")) is commands
        told = json.loads(Device(drive, settings, "hall-3").message())["components"]
        assert any("command_topic" in component for component in told.values()) is commands
        assert ("mqtt/plant home-assistant" in json.dumps(told)) is commands
