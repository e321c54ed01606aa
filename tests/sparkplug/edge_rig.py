"""An edge node at work on a real broker, and a host that watches it and writes to it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import AsyncIterator, Callable
from typing import Any

from gateway.backlog import Backlog
from gateway.clock import Clock
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.sparkplug.edge import EdgeNode
from gateway.sparkplug.memory import Keeper
from gateway.sparkplug.payload import DataType, Metric, Payload, Value, decode, encode
from tests.mosquitto import LIMIT, Message, Subscriber, program
from tests.mqtt import drives
from tests.mqtt.doors import KeptDoor
from tests.mqtt.rig import SkippingClock
from tests.sparkplug.rig import Sent, parted, section

GROUP = "plant-1"
NCMD, DCMD = f"spBv1.0/{GROUP}/NCMD/hall-3", f"spBv1.0/{GROUP}/DCMD/hall-3/"


class Host(Subscriber):
    """A subscriber to all of Sparkplug that reads payloads."""

    SHOWN = "%x"

    def __init__(self, port: int) -> None:
        super().__init__(port, "spBv1.0/#")
        self.port = port

    @property
    def sent(self) -> list[Sent]:
        """Return what edge nodes sent."""
        kinds = [m for m in self.messages if m.topic.split("/")[2] in EDGE_KINDS]
        return [_sent(message) for message in kinds]

    @property
    def kinds(self) -> list[str]:
        """Return what edge nodes sent, by kind and drive."""
        return [f"{sent.kind} {sent.device}".strip() for sent in self.sent]

    async def until_kinds(self, *wanted: str) -> list[Sent]:
        """Wait until these were sent, in this order, whatever was sent in between; return them."""
        await self.until(lambda: _in_turn(self.sent, wanted) is not None)
        return _in_turn(self.sent, wanted) or []

    async def publish(self, topic: str, payload: bytes, *options: str) -> None:
        """Publish bytes."""
        process = await asyncio.create_subprocess_exec(
            program("mosquitto_pub"), "-h", "127.0.0.1", "-p", str(self.port), "-t", topic, *options,
            "-s" if payload else "-n",
            stdin=asyncio.subprocess.PIPE,
        )  # fmt: skip
        await process.communicate(payload)
        assert process.returncode == 0

    async def state(self, is_online: bool, timestamp: int, host: str = "scada") -> None:
        """Say as a host whether it is online: QoS 1, retained."""
        text = json.dumps({"online": is_online, "timestamp": timestamp})
        await self.publish(f"spBv1.0/STATE/{host}", text.encode(), "-q", "1", "-r")

    async def write(self, topic: str, name: str, value: Value, datatype: DataType, *options: str) -> None:
        """Write a metric by NCMD or DCMD."""
        await self.publish(topic, encode(Payload(None, (Metric(name, None, None, datatype, value),))), *options)


EDGE_KINDS = ("NBIRTH", "NDATA", "NDEATH", "DBIRTH", "DDATA", "DDEATH")


def _sent(message: Message) -> Sent:
    raw = bytes.fromhex(message.payload)
    return Sent(*parted(message.topic), decode(raw), raw)


def _in_turn(sent: list[Sent], wanted: tuple[str, ...]) -> list[Sent] | None:
    """Return the messages that were wanted, each behind the one before; None where one is missing."""
    found = []
    left = iter(sent)
    for kind in wanted:
        each = next((s for s in left if f"{s.kind} {s.device}".strip() == kind), None)
        if each is None:
            return None
        found.append(each)
    return found


def values(sent: Sent) -> dict[str, Value]:
    """Return the values of a birth by name."""
    return {metric.name: metric.value for metric in sent.payload.metrics}


class Running:
    """An edge node at work, and the drives that it tells of."""

    def __init__(
        self,
        port: int,
        image: Image | None = None,
        door: Callable[[Clock], KeptDoor] | None = None,
        keeper: Keeper | None = None,
        **settings: Any,
    ) -> None:
        self.image = image or drives.image(drives.drive(max_age=drives.LONG))
        self.stats = MqttStats()
        self.clock = SkippingClock()
        made = section(**{"url": f"mqtt://127.0.0.1:{port}", "group_id": GROUP, **settings})
        self._door = None if door is None else door(self.clock)
        backlog = self.made_backlog()
        self.edge = EdgeNode(
            made, "hall-3", self.image, self.stats, self.clock, door=self._door, keeper=keeper, backlog=backlog
        )
        self.task = asyncio.create_task(self.edge.run())

    def made_backlog(self) -> Backlog | None:
        """Return what keeps what hosts miss; nothing does here."""
        return None

    @property
    def door(self) -> KeptDoor:
        """Return the door behind it."""
        assert self._door is not None
        return self._door

    @property
    def pump(self) -> DriveImage:
        """Return the first drive."""
        return self.image.drives[0]

    def read(self, **words: int) -> None:
        """Read values now."""
        drives.read(self.pump, self.clock.now(), **words)

    async def stop(self) -> None:
        """Cancel the edge node and wait for its end; an error of its own is raised."""
        self.task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self.task

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait until a condition holds."""
        async with asyncio.timeout(LIMIT):
            while not condition():
                await asyncio.sleep(0.01)


@contextlib.asynccontextmanager
async def running(port: int, *arguments: Any, **settings: Any) -> AsyncIterator[Running]:
    """Run an edge node to the broker on a port."""
    made = Running(port, *arguments, **settings)
    try:
        yield made
    finally:
        if not made.task.done():
            await made.stop()
        for thread in threading.enumerate():
            if thread.name == "mqtt-connect":  # one that was still connecting
                await asyncio.to_thread(thread.join)
