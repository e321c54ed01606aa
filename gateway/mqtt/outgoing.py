"""What goes to the broker by one connection: handed to paho here and nowhere else, and followed until it is there.

At QoS 0 a message is there when the socket has taken it, else when the broker has acknowledged it.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from gateway.metrics import MqttStats
from gateway.mqtt import packets
from gateway.mqtt.made import Made, Terms
from gateway.mqtt.packets import Batch
from gateway.mqtt.publisher import FOR_EVER

NO_PROPERTIES = b"\x00"  # MQTT 5
LARGEST_OVERHEAD = 32  # bytes of a PUBLISH beside topic and payload
PACKET_IDS = 60_000  # messages of QoS 1 and 2 that can be told apart, with a margin
RESERVE = 256  # messages beyond the queue that may tell what became of commands: values must not keep that back


class Outgoing:
    """The messages of one connection on their way to the broker; `flush_soon` has them written without waiting."""

    def __init__(self, made: Made, section: Terms, stats: MqttStats, flush_soon: Callable[[], None]) -> None:
        self.capacity = min(section.queue, PACKET_IDS) if section.qos else section.queue
        self.largest: int | None = None  # bytes of a packet that the broker takes
        self.unwritten = 0  # messages since the last flush
        self.is_closed = False
        self.handed = 0  # messages on this connection
        self.there = 0  # of which the broker has so many for certain, the first ones: see `Receipts` for QoS 0
        self.needs_ping = not section.qos
        self._client = made.client
        self._make_expiry = made.expiry
        self._correlate = made.correlation
        self._stats = stats
        self._log = logging.getLogger(section.channel)
        self._qos = section.qos
        self._flush_soon = flush_soon
        self._expiries: dict[int, Any] = {FOR_EVER: None}
        self._has_properties = made.has_properties
        self._topics: dict[str, bytes] = {}
        self._batch: Batch | None = None  # what paho was not handed yet, of QoS 0
        self._on_their_way: deque[Any] = deque()  # paho's messages, and batches
        self._waiting = 0  # messages in all of them
        self._told: deque[Any] = deque()  # those of them that tell what became of commands
        self._events: deque[Any] = deque()  # those that the broker has to acknowledge, whatever `qos` is
        self._posted: deque[Any] = deque()  # of what the broker has missed

    @property
    def room(self) -> int:
        """Return how many more messages may be on their way."""
        return self.capacity - self._waiting

    @property
    def waiting(self) -> int:
        """Return how many messages are on their way."""
        return self._waiting

    @property
    def is_empty(self) -> bool:
        """Say whether all is there."""
        return not self._on_their_way

    # ---- what the publishers send

    def send(self, topic: str, text: str, *, retain: bool, expiry: int) -> None:
        """Hand a message to paho; a flush writes it."""
        if self._is_too_large(topic, text):
            self._stats.dropped += 1
        else:
            self._publish(topic, text, retain, self._expiry(expiry))

    def carry(self, topic: str, payload: bytes) -> bool:
        """Hand bytes to paho, not to be retained; a flush writes them. False where they are too large."""
        if self._is_too_large(topic, payload):
            return False
        self._publish(topic, payload, retain=False, properties=None)
        return True

    def _is_too_large(self, topic: str, text: str | bytes) -> bool:
        if self.largest is None:
            return False
        size = len(text if isinstance(text, bytes) else text.encode())
        if len(topic) + size + LARGEST_OVERHEAD <= self.largest:
            return False
        self._log.warning("%s: larger than the %d bytes that the broker takes", topic, self.largest)
        return True

    def _publish(self, topic: str, text: str | bytes, retain: bool, properties: Any, qos: int | None = None) -> None:
        quality = self._qos if qos is None else qos
        if quality:
            self.push()
            self._on_their_way.append(self._client.publish(topic, text, quality, retain, properties))
        else:
            self._add(topic, text, retain, properties)
        self._waiting += 1
        self.unwritten += 1
        self.handed += 1
        self._stats.published += 1

    def _add(self, topic: str, text: str | bytes, retain: bool, properties: Any) -> None:
        """Put a message of QoS 0 to the others that are written with the next flush."""
        if self._batch is None:
            self._batch = Batch()
            self._on_their_way.append(self._batch)
        known = self._topics.get(topic)
        if known is None:
            known = self._topics[topic] = packets.topic_bytes(topic)
        packed = b""
        if self._has_properties:
            packed = NO_PROPERTIES if properties is None else properties.pack()
        content = text if isinstance(text, bytes) else text.encode()
        self._batch.add(packets.publish(known, content, packed, retain=retain))

    def push(self) -> None:
        """Hand paho what it was not handed yet, ahead of whatever comes next."""
        batch, self._batch = self._batch, None
        if batch is not None:
            self._client._packet_queue(packets.PUBLISH, b"".join(batch.parts), 0, 0, batch)
            batch.parts.clear()

    def _expiry(self, seconds: int) -> Any:
        if seconds not in self._expiries:
            self._expiries[seconds] = self._make_expiry(seconds)
        return self._expiries[seconds]

    # ---- what the listener says

    def say(
        self, topic: str, text: str, *, expiry: int, is_event: bool = False, is_remembered: bool = False
    ) -> bool:
        """Hand what happened to paho, and write it soon; False where too much is on its way.

        `is_remembered`: whoever says it tells it again where it does not get there.
        """
        if not is_event:
            return self._tell(topic, text, self._expiry(expiry))
        if len(self._events) >= RESERVE or not self._tell(topic, text, self._expiry(expiry), max(1, self._qos)):
            return False
        self._events.append(self._on_their_way[-1])
        if is_remembered:
            self._told.pop()
        return True

    def reply(self, topic: str, text: str, correlation: bytes) -> bool:
        """Hand an answer to paho, and write it soon; False where too much is on its way."""
        return self._tell(topic, text, self._correlate(correlation))

    def _tell(self, topic: str, text: str, properties: Any, qos: int | None = None) -> bool:
        if self.room <= -RESERVE or self.is_closed or self._is_too_large(topic, text):
            return False
        self._publish(topic, text, retain=False, properties=properties, qos=qos)
        self._told.append(self._on_their_way[-1])
        self._flush_soon()
        return True

    # ---- what the broker has missed

    def post(self, topic: str, text: str) -> Callable[[], bool] | None:
        """Hand a message to paho at QoS 1; return what says that the broker has it, None where it is too large."""
        if self._is_too_large(topic, text):
            return None
        self._publish(topic, text, retain=False, properties=None, qos=max(1, self._qos))
        self._posted.append(self._on_their_way[-1])
        return cast("Callable[[], bool]", self._posted[-1].is_published)

    @property
    def last_event(self) -> Callable[[], bool]:
        """Return what says of the event that was said last whether the broker has it."""
        return cast("Callable[[], bool]", self._events[-1].is_published)

    # ---- what became of it

    def count(self, *, is_all_written: bool) -> bool:
        """Let go of what is there; `is_all_written`: the socket has taken everything. Say whether a post is there."""
        waiting, posted, before = self._on_their_way, len(self._posted), self._waiting
        if is_all_written and not self._qos:
            waiting.clear()
            self._told.clear()
            self._waiting = 0
        while waiting and waiting[0].is_published():
            first = waiting.popleft()
            self._waiting -= first.count if isinstance(first, Batch) else 1
        for sent in (self._told, self._events, self._posted):
            while sent and sent[0].is_published():
                sent.popleft()
        if self._qos:
            self.there += before - self._waiting
        self._stats.waiting = self._waiting
        return len(self._posted) < posted

    def abandon(self) -> None:
        """Count what was told and will never be known to be there."""
        self.is_closed = True
        self._stats.untold += len(self._told)
