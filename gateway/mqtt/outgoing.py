"""What goes to the broker by one connection: written here and nowhere else, and followed until it is there.

At QoS 0 a message is there when the socket has taken it, else when the broker has acknowledged it. Messages of QoS 0
and 1 are written past paho while it has nothing to write itself, and behind that where it has; QoS 2 is all paho's.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import Any

from gateway.metrics import MqttStats
from gateway.mqtt import packets
from gateway.mqtt.in_flight import IN_FLIGHT, InFlight
from gateway.mqtt.made import Made, Terms
from gateway.mqtt.outlet import FOR_EVER
from gateway.mqtt.packets import Batch

NO_PROPERTIES = b"\x00"  # MQTT 5
LARGEST_OVERHEAD = 32  # bytes of a PUBLISH beside topic and payload
PACKET_IDS = 60_000  # messages of QoS 2 that can be told apart, with a margin
IsThere = Callable[[], bool]  # says of a message whether it is there
RESERVE = 256  # messages beyond the queue that may tell what became of commands: values must not keep that back


class Outgoing:
    """The messages of one connection on their way to the broker; `flush_soon` has them written without waiting."""

    def __init__(self, made: Made, section: Terms, stats: MqttStats, flush_soon: Callable[[], None]) -> None:
        self.capacity = min(section.queue, PACKET_IDS) if section.qos == 2 else section.queue
        self.largest: int | None = None  # bytes of a packet that the broker takes
        self.unwritten = 0  # messages since the last flush
        self.is_closed = False
        self.handed = 0  # messages on this connection
        self.there = 0  # of which the broker has so many for certain, the first ones: see `Receipts` for QoS 0
        self.needs_ping = not section.qos
        self.is_pahos = section.qos == 2  # all of it
        self._client = made.client
        self._make_expiry = made.expiry
        self._correlate = made.correlation
        self._stats = stats
        self._log = logging.getLogger(section.channel)
        self._qos = section.qos
        self._surest = max(1, section.qos)  # QoS of what is told once only, where the broker takes that
        self._flush_soon = flush_soon
        self._expiries: dict[int, Any] = {FOR_EVER: None}
        self._has_properties = made.is_5
        self._topics: dict[str, bytes] = {}
        self._batch: Batch | None = None  # what is written next
        self._batches: deque[Batch] = deque()  # what the socket has not taken, with that one
        self._in_batches = 0  # messages in them
        self._in_flight = InFlight()
        self._of_paho: deque[IsThere] = deque()  # messages of QoS 2
        self._told: deque[IsThere] = deque()  # messages that tell what became of commands
        self._events: deque[IsThere] = deque()  # those that the broker has to acknowledge, whatever `qos` is
        self._posted: deque[IsThere] = deque()  # of what the broker has missed

    @property
    def room(self) -> int:
        """Return how many more messages may be on their way."""
        return self.capacity - self.waiting

    @property
    def waiting(self) -> int:
        """Return how many messages are on their way."""
        if self._qos == 1:
            return self._in_flight.open
        if self.is_pahos:
            return len(self._of_paho)
        return self._in_batches + self._in_flight.queued

    @property
    def is_empty(self) -> bool:
        """Say whether all is there, also events beside values at QoS 0."""
        return not self.waiting and not self._in_flight.open

    def limit(self, receive_maximum: int, highest_qos: int) -> None:
        """Take how many messages of QoS 1 and 2 the broker takes at a time, and whether it takes such at all."""
        self._surest = min(max(1, self._qos), highest_qos)
        self._in_flight.limit(receive_maximum)
        self._client.limit_in_flight(min(IN_FLIGHT, receive_maximum))

    # ---- what the publishers send

    def send(self, topic: str, text: str, *, retain: bool, expiry: int) -> None:
        """Take a message; a flush writes it."""
        if self._is_too_large(topic, text):
            self._stats.dropped += 1
        else:
            self._publish(topic, text, retain, self._expiry(expiry))

    def carry(self, topic: str, payload: bytes) -> bool:
        """Take bytes, not to be retained; a flush writes them. False where they are too large."""
        if self._is_too_large(topic, payload):
            return False
        self._publish(topic, payload, retain=False, properties=None)
        return True

    def _is_too_large(self, topic: str, text: str | bytes, more: int = 0) -> bool:
        """Say whether the broker does not take it; `more`: bytes of properties whose size others have in hand."""
        if self.largest is None:
            return False
        size = len(text if isinstance(text, bytes) else text.encode())
        if len(topic.encode()) + size + more + LARGEST_OVERHEAD <= self.largest:
            return False
        self._log.warning("%s: larger than the %d bytes that the broker takes", topic, self.largest)
        return True

    def _publish(self, topic: str, text: str | bytes, retain: bool, properties: Any) -> None:
        """Send one of the many messages, whose topics come again and again."""
        if self.is_pahos:
            self._publish_by_paho(topic, text, retain, properties)
            return
        known = self._topics.get(topic)
        if known is None:
            known = self._topics[topic] = packets.topic_bytes(topic)
        self._add(known, text, retain, properties, self._qos)

    def _publish_once(self, topic: str, text: str, properties: Any, qos: int) -> IsThere:
        """Send a message that is none of the many; return what says that it is there."""
        if self.is_pahos:
            return self._publish_by_paho(topic, text, False, properties)
        self._add(packets.topic_bytes(topic), text, False, properties, qos)
        return self._in_flight.receipt() if qos else self._next_batch().is_written

    def _publish_by_paho(self, topic: str, text: str | bytes, retain: bool, properties: Any) -> IsThere:
        self.push()
        sent = self._client.publish(topic, text, 2, retain, properties)
        self._of_paho.append(_never if sent.rc else sent.is_published)  # where paho has no socket any more, it raises
        self._count()
        return self._of_paho[-1]

    def _add(self, topic: bytes, text: str | bytes, retain: bool, properties: Any, qos: int) -> None:
        """Put a message to those that are written next, or behind those of which some must be there first."""
        packed = b""
        if self._has_properties:
            packed = NO_PROPERTIES if properties is None else properties.pack()
        content = text if isinstance(text, bytes) else text.encode()
        self._count()
        if qos:
            self._in_flight.add(*packets.publish_at_1(topic, content, packed, retain=retain))
            self._release()
        else:
            self._next_batch().add(packets.publish(topic, content, packed, retain=retain))
            self._in_batches += 1

    def _release(self) -> None:
        """Put to what is written next what need not wait for acknowledgements any longer."""
        pieces = self._in_flight.release()
        if pieces:
            self._in_batches += self._next_batch().add_pieces(pieces)

    def _next_batch(self) -> Batch:
        if self._batch is None:
            self._batch = Batch()
            self._batches.append(self._batch)
        return self._batch

    def _count(self) -> None:
        self.unwritten += 1
        self.handed += 1
        self._stats.published += 1

    def push(self) -> None:
        """Write what was not written yet; what the socket does not take goes ahead of whatever comes next."""
        self._release()
        batch, self._batch = self._batch, None
        if batch is None:
            return
        content = b"".join(batch.parts)
        batch.parts.clear()
        taken = self._client.write(content)
        if taken == len(content):
            batch.note_written()
        else:
            self._client._packet_queue(packets.PUBLISH, content[taken:], 0, 0, batch)

    def _expiry(self, seconds: int) -> Any:
        if seconds not in self._expiries:
            self._expiries[seconds] = self._make_expiry(seconds)
        return self._expiries[seconds]

    # ---- what the listener says

    def say(
        self, topic: str, text: str, *, expiry: int, is_event: bool = False, is_remembered: bool = False
    ) -> bool:
        """Send what happened, and have it written soon; False where too much is on its way.

        `is_remembered`: whoever says it tells it again where it does not get there.
        """
        if not is_event:
            return self._tell(topic, text, self._expiry(expiry), self._qos) is not None
        if len(self._events) >= RESERVE:
            return False
        is_there = self._tell(topic, text, self._expiry(expiry), self._surest)
        if is_there is None:
            return False
        self._events.append(self._sure(is_there) if is_remembered else is_there)
        if is_remembered:
            self._told.pop()
        return True

    def reply(self, topic: str, text: str, correlation: bytes) -> bool:
        """Send an answer, and have it written soon; False where too much is on its way."""
        if self._is_too_large(topic, text, len(correlation)):
            return False
        return self._tell(topic, text, self._correlate(correlation), self._qos) is not None

    def _tell(self, topic: str, text: str, properties: Any, qos: int) -> IsThere | None:
        if self.room <= -RESERVE or self.is_closed or self._is_too_large(topic, text):
            return None
        is_there = self._publish_once(topic, text, properties, qos)
        self._told.append(is_there)
        self._flush_soon()
        return is_there

    # ---- what the broker has missed

    def post(self, topic: str, text: str) -> IsThere | None:
        """Send a message, at QoS 1 at the least if the broker takes that; return what says that it is there.

        None where it is too large.
        """
        if self._is_too_large(topic, text):
            return None
        self._posted.append(self._sure(self._publish_once(topic, text, None, self._surest)))
        return self._posted[-1]

    def _sure(self, is_there: IsThere) -> IsThere:
        """Return what says of the last message that the broker has it for certain, at QoS 0 too: see `Receipts`."""
        mark = self.handed
        return is_there if self._surest else lambda: self.there >= mark

    @property
    def last_event(self) -> IsThere:
        """Return what says of the event that was said last whether the broker has it."""
        return self._events[-1]

    # ---- what became of it

    def acknowledge(self, packet_id: int) -> bool:
        """Take that the broker has a message of QoS 1; False where none of those written here has that identifier."""
        return self._in_flight.acknowledge(packet_id)

    def count(self, *, is_all_written: bool) -> bool:
        """Let go of what is there; `is_all_written`: the socket has taken everything. Say whether a post is there."""
        posted = len(self._posted)
        if is_all_written and not self._qos and self._told:  # behind an event that waits may stand what is there
            self._told = deque(is_there for is_there in self._told if not is_there())
        while self._batches and (is_all_written or self._batches[0].is_written()):
            self._in_batches -= self._batches.popleft().count
        while self._of_paho and self._of_paho[0]():
            self._of_paho.popleft()
            self.there += 1
        if self._qos == 1:
            self.there = self._in_flight.there
        for sent in (self._told, self._events, self._posted):
            while sent and sent[0]():
                sent.popleft()
        self._stats.waiting = self.waiting
        return len(self._posted) < posted

    def abandon(self) -> None:
        """Count what was told and will never be known to be there."""
        self.is_closed = True
        self._stats.untold += len(self._told)


def _never() -> bool:
    """Say of a message that it is not there: nobody will send it."""
    return False
