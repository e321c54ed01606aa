"""What the tests of Sparkplug share: a node without a broker, and what it sends."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from gateway.config import SparkplugSection
from gateway.control.door import Door
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.sparkplug.device import Moment
from gateway.sparkplug.node import Node
from gateway.sparkplug.payload import Metric, Payload, decode
from gateway.sparkplug.session import Happening
from tests.mqtt import drives

WALL_MS = round(drives.WALL * 1000)
ROOM = 1_000_000


def section(**settings: Any) -> SparkplugSection:
    """Return the settings of an edge node; to a broker that is not asked for, unless they name one."""
    table = {"url": "mqtt://127.0.0.1", "group_id": "Plant 1", "reconnect_after": "20ms", "reconnect_at_most": "50ms"}
    return SparkplugSection.model_validate({**table, **settings})


@dataclass(frozen=True, slots=True)
class Sent:
    """A message on its way: NBIRTH and so on, the drive, and what is in it."""

    kind: str
    device: str
    payload: Payload
    raw: bytes

    @property
    def names(self) -> list[str]:
        """Return the names of its metrics."""
        return [metric.name for metric in self.payload.metrics]


def parted(topic: str) -> tuple[str, str]:
    """Return the kind of a message, and the drive, by its topic."""
    _, _, kind, _, *device = topic.split("/")
    return kind, device[0] if device else ""


@dataclass
class Back:
    """A way to the broker that keeps what goes along it, as long as there is room."""

    room: int = ROOM
    largest: int = ROOM
    sent: list[Sent] = field(default_factory=list)
    topics: list[str] = field(default_factory=list)

    def carry(self, topic: str, payload: bytes) -> bool:
        """Keep a message."""
        assert self.room > 0
        if len(payload) > self.largest:
            return False
        self.room -= 1
        self.topics.append(topic)
        self.sent.append(Sent(*parted(topic), decode(payload), payload))
        return True

    @property
    def kinds(self) -> list[str]:
        """Return what was sent: NBIRTH, then DBIRTH pump-1, and so on."""
        return [f"{sent.kind} {sent.device}".strip() for sent in self.sent]


class Plant:
    """A node, its drives, and time that stands until it is put forward."""

    def __init__(self, image: Image | None = None, door: Door | None = None, **settings: Any) -> None:
        self.now = 100.0
        self.image = image or drives.image()
        self.stats = MqttStats()
        self.section = section(**settings)
        controls, lines = (door.controls, door.lines) if door is not None else ({}, {})
        self.node = Node(self.section, "hall-3", self.image, self.stats, controls, lines)
        self.back = Back()
        self.image.subscribe(self._on_change)

    @property
    def pump(self) -> DriveImage:
        """Return the first drive."""
        return self.image.drives[0]

    @property
    def moment(self) -> Moment:
        """Return now."""
        return Moment(self.now, WALL_MS + round(self.now * 1000))

    def _on_change(self, image: DriveImage, names: Any) -> None:
        self.node.note_change(image, names, self.now)
        self.node.settle_drive(self.back, image.drive.name, self.moment)

    def connect(self, *, host: bool = True) -> None:
        """Connect, and hear of the primary host."""
        self.node.session.connecting()
        self.node.take(Happening.CONNECTED)
        if host:
            self.node.take(Happening.HOST_ONLINE)

    def settle(self) -> list[Sent]:
        """Send all that is owed now, and return it."""
        before = len(self.back.sent)
        for _ in range(1000):
            if not self.node.is_owing(self.now) or not self.back.room:
                break
            self.node.settle(self.back, self.moment, 1)
        return self.back.sent[before:]

    def read(self, **words: int) -> None:
        """Read values of the first drive now."""
        drives.read(self.pump, self.now, **words)

    def live(self) -> list[Sent]:
        """Connect and send all births."""
        self.connect()
        return self.settle()


def named(sent: Sent, metrics: Any) -> dict[str, Metric]:
    """Return the metrics of data by the names that the births gave to their aliases."""
    names = {d.alias: d.name for kind in (metrics.values, metrics.texts, metrics.standing, metrics.told)
             for d in kind.values()}  # fmt: skip
    return {metric.name or names[metric.alias or 0]: metric for metric in sent.payload.metrics}
