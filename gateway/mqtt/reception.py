"""What the broker sends: noted while paho calls back, and handed on when it has ended."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from gateway.metrics import MqttStats
from gateway.mqtt import reasons
from gateway.mqtt.made import Terms
from gateway.mqtt.message import Message


@dataclass(frozen=True, slots=True)
class Ears:
    """Who hears what the broker sends: `hear` each message, `pause` when those of one stretch are read."""

    hear: Callable[[Message], None]
    pause: Callable[[], None]


class Reception:
    """The messages of one connection, from paho's callbacks to whoever hears them."""

    def __init__(self, client: Any, stats: MqttStats, section: Terms) -> None:
        self._client = client
        self._stats = stats
        self._table = section.table
        self._log = logging.getLogger(section.channel)
        self._noted: list[Message] = []
        self._ears: Ears | None = None
        self._asked: dict[int, list[str]] = {}
        self._is_subscribed = False
        client.on_message = self._on_message
        client.on_subscribe = self._on_subscribe

    def listen(self, subscriptions: Sequence[tuple[str, Any]], ears: Ears) -> None:
        """Subscribe, and hand every message that comes to `ears`."""
        self._ears = ears
        _, mid = self._client.subscribe(list(subscriptions))
        self._asked[mid] = [topic for topic, _ in subscriptions]

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        """Take note of a message; one whose topic is no text is none of ours."""
        try:
            topic = message.topic
        except UnicodeDecodeError:
            self._stats.ignored += 1
            return
        known = getattr(message, "properties", None)
        self._noted.append(
            Message(
                topic=topic,
                payload=bytes(message.payload),
                is_retained=bool(message.retain),
                is_repeated=bool(message.dup),
                is_early=not self._is_subscribed,
                expiry=getattr(known, "MessageExpiryInterval", None),
                response_topic=getattr(known, "ResponseTopic", ""),
                correlation=getattr(known, "CorrelationData", b""),
            )
        )

    def _on_subscribe(self, _client: Any, _data: Any, mid: int, codes: Sequence[Any], _properties: Any) -> None:
        self._is_subscribed = True
        for topic, code in zip(self._asked.pop(mid, ()), codes, strict=False):
            if code.is_failure:
                why = reasons.of_subscription(code.value, code.getName(), self._table)
                self._log.warning("nothing is heard by %s: %s", topic, why)

    def hand_over(self) -> None:
        """Hand on what was noted, outside of paho's lock."""
        noted, self._noted = self._noted, []
        if self._ears is None or not noted:
            return
        for message in noted:
            self._ears.hear(message)
        self._ears.pause()
