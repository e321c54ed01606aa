"""Discovery, descriptions and events against a real Mosquitto."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from gateway.image import Image, LinkState
from gateway.mqtt.discovery import BIRTH_PAUSE
from tests.mosquitto import Mosquitto, Subscriber
from tests.mqtt.rig import ROOT, STATUS, running
from tests.mqtt.test_discovery import CONFIG, NODE, image

pytestmark = pytest.mark.e2e
both_versions = pytest.mark.parametrize("version", ["5", "3.1.1"])
DISCOVERED: dict[str, Any] = {"home_assistant": {"enabled": True}}
POLL = {"values": ["status", "output_frequency"], "every": "1s"}


@pytest.fixture
def broker() -> Iterator[Mosquitto]:
    """Run a broker that takes everybody."""
    with Mosquitto() as made:
        yield made


def publish(broker: Mosquitto, topic: str, text: str, *options: str) -> None:
    """Publish by mosquitto_pub."""
    arguments = ["-h", "127.0.0.1", "-p", str(broker.port), "-t", topic, "-m", text, "-q", "1", *options]
    subprocess.run(["mosquitto_pub", *arguments], check=True)


def online(*made: dict[str, Any]) -> Image:
    """Return an image of drives that answer."""
    found = image(*made)
    for each in found.drives:
        each.set_link(LinkState.ONLINE)
    return found


@both_versions
async def test_a_newcomer_finds_description_and_discovery(broker: Mosquitto, version: str) -> None:
    """Both are retained; there is no discovery unless it is wanted."""
    async with Subscriber(broker.port) as first, running(broker.port, version=version, **DISCOVERED):
        await first.until(lambda: CONFIG in first.newest())
        async with Subscriber(broker.port) as second:
            await second.until(lambda: {CONFIG, f"{ROOT}/description", STATUS} <= second.newest().keys())
            assert all(message.is_retained for message in second.messages)
            assert json.loads(second.newest()[f"{ROOT}/description"])["values"]["torque"]["unit"] == "%"
    with Mosquitto() as other:
        async with Subscriber(other.port) as heard, running(other.port, version=version):
            await heard.until_payload(STATUS, "online")
            assert not [topic for topic in heard.newest() if topic.startswith("homeassistant/")]


@both_versions
async def test_what_an_earlier_run_told_is_taken_back(broker: Mosquitto, version: str) -> None:
    """A value that is polled no more, and a drive that is no more; the others stay as they are."""
    two = online({}, {"poll": [POLL]})
    async with Subscriber(broker.port) as heard:
        async with running(broker.port, two, version=version, **DISCOVERED):
            await heard.until(lambda: {CONFIG, f"{NODE}/pump-2/config"} <= heard.newest().keys())
        publish(broker, f"{NODE}-other/pump-9/config", "{}", "-r")
        before = len(heard.messages)
        async with running(broker.port, online({"poll": [POLL]}), version=version, **DISCOVERED):
            await heard.until(lambda: heard.newest()[f"{NODE}/pump-2/config"] == "")
            await heard.until(lambda: "alarm" not in json.loads(heard.newest()[CONFIG])["components"])
    told = [json.loads(each.payload) for each in heard.messages[before:] if each.topic == CONFIG]
    assert any(each["components"].get("alarm") == {"platform": "binary_sensor"} for each in told)
    assert "output_frequency" in told[-1]["components"]
    assert heard.newest()[f"{NODE}-other/pump-9/config"] == "{}"


@both_versions
async def test_a_birth_of_home_assistant_is_answered(broker: Mosquitto, version: str) -> None:
    """With the discovery, and, where the broker keeps no values, with those as well."""
    settings: dict[str, Any] = {"version": version, "retain": False, **DISCOVERED}
    async with Subscriber(broker.port) as heard, running(broker.port, **settings) as made:
        made.read(output_frequency=6000)
        await heard.until(lambda: CONFIG in heard.newest())
        await heard.until_payload(f"{ROOT}/output_frequency", "60.00")
        publish(broker, "homeassistant/status", "online")
        await heard.until(lambda: len(heard.on(CONFIG)) == 2)
        await heard.until(lambda: heard.on(f"{ROOT}/output_frequency").count("60.00") == 2)
        publish(broker, "homeassistant/status", "online")
        made.clock.skip(BIRTH_PAUSE)
        await heard.until(lambda: len(heard.on(CONFIG)) == 3)


@both_versions
async def test_events_arrive_surely_and_are_not_kept(broker: Mosquitto, version: str) -> None:
    """QoS 1 while values go with QoS 0; a trip with its code and text."""
    async with Subscriber(broker.port) as heard, running(broker.port, version=version) as made:
        await heard.until_payload(STATUS, "online")
        made.pump.set_tripped(False)
        made.read(trip_code=0)
        made.read(trip_code=1)
        made.pump.set_tripped(True)
        made.pump.set_link(LinkState.OFFLINE, "silent")
        await heard.until(lambda: len(heard.on(f"{ROOT}/event")) == 2)
        events = [message for message in heard.messages if message.topic == f"{ROOT}/event"]
        assert [(each.qos, each.is_retained) for each in events] == [(1, False)] * 2
        trip, lost = (json.loads(each.payload) for each in events)
        assert list(trip) == ["event", "reason", "code", "time"]
        assert (trip["event"], trip["code"], trip["reason"]) == ("trip", 1, "OC1: overcurrent during acceleration")
        assert (lost["event"], lost["reason"]) == ("link_lost", "silent")
    assert made.stats.untold == 0


async def test_an_event_that_nobody_can_be_told_is_counted() -> None:
    """It is not kept: it would be old when it came."""
    async with running(1) as made:
        made.pump.set_tripped(False)
        made.pump.set_link(LinkState.OFFLINE, "silent")
        assert made.stats.untold == 1
