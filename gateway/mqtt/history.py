"""Says under which topics and how it is told what the broker has missed: never as if it were live. Pure.

A topic of its own below the drive, not retained, and in the JSON `historical`: no dashboard takes it for the present.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from gateway.backlog import Kept, Kind
from gateway.config import MqttSection
from gateway.image import Quality
from gateway.mqtt import payload, topics
from gateway.mqtt.forwarding import Parcel
from gateway.mqtt.topics import EVENT, HISTORY, STATE

Message = tuple[str, str]  # topic and text


class Origin(Protocol):
    """Where numbers come from."""

    @property
    def origin(self) -> str:
        """Return what tells them from those of other stores."""
        ...


class Historian:
    """Writes the messages of what was kept for one broker."""

    def __init__(self, section: MqttSection, gateway: str, backlog: Origin) -> None:
        self._root = f"{section.base}/{gateway}"
        self._has_values = "values" in section.publish
        self._has_state = "state" in section.publish
        self._backlog = backlog

    def unpack(self, kept: Kept) -> list[Parcel[Message]]:
        """Return the messages of a reading, the last of which finishes it; none where it cannot be understood."""
        try:
            found = list(self._messages(kept))
        except (ValueError, TypeError, AttributeError, KeyError):
            return []
        last = len(found) - 1
        return [Parcel(each, 1, kept.number if place == last else 0) for place, each in enumerate(found)]

    def _messages(self, kept: Kept) -> Iterator[Message]:
        reading = kept.reading
        root = f"{self._root}/{reading.drive}/{HISTORY}"
        body = json.loads(reading.body)
        mark = {
            "time": _text(payload.timestamp(reading.ms / 1000)),
            "historical": "true",
            "id": _text(f"{self._backlog.origin}-{kept.number}"),
        }
        if reading.kind is Kind.EVENT:
            yield f"{root}/{EVENT}", _object({key: _text(value) for key, value in body.items()} | mark)
            return
        if self._has_values:
            for name in body["v"]:
                yield f"{root}/{topics.level(name)}", _object(_of_value(body, name) | mark)
        if self._has_state:
            yield f"{root}/{STATE}", _object(mark | _of_state(body))


def _of_value(body: Mapping[str, Any], name: str) -> dict[str, str]:
    """Return the members of a value's JSON, as JSON."""
    made = {"value": _number(body["v"][name])}
    text = body.get("t", {}).get(name)
    if text is not None:
        made["text"] = _text(text)
    return {**made, "quality": _text(body.get("q", {}).get(name, Quality.GOOD.word))}


def _of_state(body: Mapping[str, Any]) -> dict[str, str]:
    """Return the members of a state's JSON, as JSON: only what one answer brought."""
    texts = body.get("t", {})
    found: dict[str, str] = {}
    for name, value in body["v"].items():
        found[payload.key(name)] = _number(value)
        if name in texts:
            found[f"{payload.key(name)}_text"] = _text(texts[name])
    return found


def _number(value: str | None) -> str:
    """Return a number as it was read, "50.00", with the decimals that it has; ValueError where it is none."""
    if value is None:
        return "null"
    if not math.isfinite(float(value)):
        raise ValueError(value)
    return value


def _text(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _object(members: Mapping[str, str]) -> str:
    return "{" + ",".join(f"{_text(key)}:{value}" for key, value in members.items()) + "}"
