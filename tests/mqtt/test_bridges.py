"""Two brokers of one gateway, both Mosquitto: what one suffers, the other does not notice."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

import pytest

from gateway.control.command import Channel, Source
from gateway.image import Image
from gateway.metrics import MqttStats
from gateway.mqtt.bridge import Bridge
from tests.mosquitto import LIMIT, Mosquitto, Subscriber
from tests.mqtt import drives
from tests.mqtt.doors import LEASED, KeptDoor
from tests.mqtt.rig import GATEWAY, Log, SkippingClock, running, section
from tests.mqtt.test_bridge_commands import publish

pytestmark = pytest.mark.e2e
CLOUD = f"acme/{GATEWAY}"
PLANT = f"tosvert/{GATEWAY}"
MARKED = "output_frequency"


@dataclass
class Pair:
    """Two bridges of one gateway at work."""

    image: Image
    clock: SkippingClock
    door: KeptDoor
    stats: dict[str, MqttStats]

    def read(self, word: int) -> None:
        """Read a value of the first drive now."""
        drives.read(self.image.drives[0], self.clock.now(), output_frequency=word, status=word & 1)


@contextlib.asynccontextmanager
async def paired(plant: Mosquitto, cloud: Mosquitto, **of_both: object) -> AsyncIterator[Pair]:
    """Run a gateway for two brokers; nobody can command it by the second."""
    clock = SkippingClock()
    image = drives.image(drives.drive(max_age=drives.LONG))
    made = Pair(image, clock, KeptDoor.small(clock), {"plant": MqttStats(), "cloud": MqttStats()})
    sections = (
        section(name="plant", url=f"mqtt://127.0.0.1:{plant.port}", **of_both),
        section(name="cloud", url=f"mqtt://127.0.0.1:{cloud.port}", base="acme", commands=False, **of_both),
    )
    bridges = [Bridge(each, GATEWAY, made.image, made.stats[each.origin], clock, door=made.door) for each in sections]
    tasks = [asyncio.create_task(bridge.run()) for bridge in bridges]
    try:
        yield made
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    assert all(task.cancelled() for task in tasks)


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("version", ["5", "3.1.1"])
async def test_a_broker_that_stands_still_or_dies_holds_back_no_other(version: str) -> None:
    """Each has its own queue, its own words for it, and comes back on its own."""
    with Mosquitto() as plant, Mosquitto() as cloud, Log() as log:
        async with Subscriber(cloud.port) as heard, paired(plant, cloud, queue=200, version=version) as made:
            await heard.until_payload(f"{CLOUD}/status", "online")
            await log.until(lambda lines: sum(line.startswith("connected to") for line in lines) == 2)
            plant.freeze()
            word = 0
            async with asyncio.timeout(LIMIT):
                while made.stats["plant"].dropped < 100:
                    word = word % 0x7000 + 1
                    made.read(word)
                    await asyncio.sleep(0)
            await heard.until_payload(f"{CLOUD}/{LEASED}/{MARKED}", f"{word / 100:.2f}")
            assert made.stats["plant"].waiting <= 200
            plant.kill()
            await log.until_said(f"plant (mqtt://127.0.0.1:{plant.port}): connection lost")
            made.read(word + 1)
            await heard.until_payload(f"{CLOUD}/{LEASED}/{MARKED}", f"{(word + 1) / 100:.2f}")
            plant.start()
            async with Subscriber(plant.port) as again:
                await again.until_payload(f"{PLANT}/status", "online")
                await again.until_payload(f"{PLANT}/{LEASED}/{MARKED}", f"{(word + 1) / 100:.2f}")
            assert made.stats["cloud"].connects == 1
            assert heard.on(f"{CLOUD}/status") == ["online"]
            assert not any(topic.startswith("tosvert") for topic in heard.newest())
        lost = [record for record in log.records if "connection lost" in record.getMessage()]
        assert {record.name for record in lost} == {"gateway.mqtt.plant"}


async def test_commands_come_from_where_they_are_taken_with_the_broker_in_their_source() -> None:
    """What is published to the other is not even delivered; both are told what became of it."""
    with Mosquitto() as plant, Mosquitto() as cloud:
        async with Subscriber(cloud.port) as there, Subscriber(plant.port) as here, paired(plant, cloud) as made:
            made.door.is_prompt = True
            await there.until_payload(f"{CLOUD}/status", "online")
            await here.until_payload(f"{PLANT}/status", "online")
            await publish(cloud.port, f"{CLOUD}/{LEASED}/command", "run", "-q", "1")
            while not made.door.submitted:
                take = {"command": "take", "source": "hmi"}
                await publish(plant.port, f"{PLANT}/{LEASED}/command", take, "-q", "1")
            for side, root in ((here, PLANT), (there, CLOUD)):
                await side.until(lambda: bool(side.on(f"{root}/{LEASED}/result")))  # noqa: B023
            assert {command.source for command in made.door.submitted} == {Source(Channel.MQTT, "hmi", "plant")}
            assert made.stats["cloud"].heard == 0


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("version", ["5", "3.1.1"])
async def test_a_partition_is_noticed_by_the_keep_alive_and_healed(version: str) -> None:
    """The broker is stopped: no word of it for the keep-alive. When it goes on, it says offline, then is told all."""
    with Mosquitto() as broker, Log() as log:
        async with Subscriber(broker.port) as heard, running(broker.port, version=version, keep_alive="1s") as made:
            await heard.until_payload(f"{PLANT}/status", "online")
            broker.freeze()
            await log.until_said("has not answered within the keep-alive")
            assert not made.stats.is_connected
            made.read(output_frequency=4321)
            broker.thaw()
            await heard.until_payload(f"{PLANT}/pump-1/output_frequency", "43.21")
            await heard.until(lambda: heard.on(f"{PLANT}/status")[-2:] == ["offline", "online"])
