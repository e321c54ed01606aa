"""Decides what Home Assistant is told of the drives, so that it finds them by itself: one retained message a drive.

What an earlier run of this gateway has told is still on the broker, and is read from there: entities that are no more
are taken back by name, as Home Assistant wants it, and drives that are no more by an empty message. Where Home
Assistant says that it has started, everything is told again.
"""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Mapping
from typing import Any

from gateway import __version__
from gateway.config import MqttSection
from gateway.image import DriveImage, Image
from gateway.mqtt import controls, entities
from gateway.mqtt.entities import Component, Place
from gateway.mqtt.message import Message
from gateway.mqtt.payload import NOTHING, ONLINE

log = logging.getLogger("gateway.mqtt")

ORIGIN = {"name": "tosvert-gateway", "sw_version": __version__}
MAKER = "Toshiba"
BIRTH_PAUSE = 5.0  # seconds between two times that everything is told again, however often that is asked for
LARGEST = 60_000  # bytes of a message: the gateway reads its own back, and takes none above 64 KiB


def ident(name: str) -> str:
    """Return a name as a topic of Home Assistant spells it: letters, digits, _ and -."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)


class Device:
    """One drive as Home Assistant is to know it."""

    def __init__(self, image: DriveImage, section: MqttSection, gateway: str) -> None:
        self.image = image
        self._place = Place.of(section, gateway, image)
        found = entities.of_state(self._place)
        found |= controls.of_control(self._place, section)
        self.components = _bounded(found, entities.of_values(self._place), image.drive.name)
        self._told_identity: Mapping[str, str] | None = None

    @property
    def is_news(self) -> bool:
        """Say whether who the drive is has become known, or another, since it was told."""
        return self._told_identity is not None and self._told_identity != self.image.identity

    def message(self) -> str:
        """Return all of it, as it is now."""
        self._told_identity = dict(self.image.identity)
        return self._message(self.components)

    def removal(self, known: Mapping[str, str]) -> str | None:
        """Return what takes entities back, of which the broker knows id and platform; None where none is too many."""
        ours = {key: component["platform"] for key, component in self.components.items()}
        gone = {key: platform for key, platform in known.items() if ours.get(key) != platform}
        if not gone:
            return None
        kept = {key: component for key, component in self.components.items() if key not in gone}
        return self._message({**kept, **{key: {"platform": platform} for key, platform in gone.items()}})

    def _message(self, components: Mapping[str, Component]) -> str:
        document = {
            "device": self._device(),
            "origin": ORIGIN,
            "availability": self._place.of_drive,
            "availability_mode": "all",
            "components": components,
        }
        return _text(document)

    def _device(self) -> dict[str, Any]:
        drive, who = self.image.drive, self.image.identity
        made = {
            "identifiers": [self._place.root],
            "name": drive.name,
            "manufacturer": who.get("vendor") or MAKER,
            "model": drive.model.title or drive.model.name,
            "model_id": who.get("type_form") or who.get("device"),
            "sw_version": who.get("version") or who.get("cpu_version"),
        }
        return {key: value for key, value in made.items() if value}


def _text(document: Mapping[str, Any]) -> str:
    return json.dumps(document, ensure_ascii=False, separators=(",", ":"))


def _bounded(first: Mapping[str, Component], values: Mapping[str, Component], drive: str) -> dict[str, Component]:
    """Return all components, but no more of the values than one message holds."""
    found, size = dict(first), len(_text(first).encode())
    for key, component in values.items():
        size += len(_text({key: component}).encode())
        if size > LARGEST:
            log.warning("%s: Home Assistant is told of %d entities only: too many values", drive, len(found))
            break
        found[key] = component
    return found


def known_components(text: bytes) -> dict[str, str]:
    """Return the ids and platforms of an earlier message; none of one that cannot be read."""
    try:
        components = json.loads(text)["components"]
        return {str(key): str(component["platform"]) for key, component in components.items()}
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return {}


class Discovery:
    """All drives of a gateway on their way to Home Assistant."""

    def __init__(self, section: MqttSection, gateway: str, image: Image) -> None:
        settings = section.home_assistant
        self._birth = settings.birth
        self._root = f"{settings.prefix}/device/{ident(f'{section.base}-{gateway}')}/"
        self._devices = {ident(each.drive.name): Device(each, section, gateway) for each in image.drives}
        self._owed: dict[str, list[str | None]] = {}  # by id the messages to be sent; None stands for what is so then
        self._is_asked = False
        self._not_before = float("-inf")

    @property
    def filters(self) -> list[str]:
        """Return the topic filters to subscribe to: what was told before, and the birth of Home Assistant."""
        return [f"{self._root}+/config", self._birth]

    @property
    def is_owing(self) -> bool:
        """Say whether Home Assistant is to be told something."""
        return bool(self._owed)

    def owe_everything(self) -> None:
        """Tell everything anew."""
        for key in self._devices:
            self._owed.setdefault(key, [None])

    def takes(self, topic: str) -> bool:
        """Say whether a message is for this."""
        return topic == self._birth or topic.startswith(self._root)

    def hear(self, message: Message, now: float) -> bool:
        """Take what an earlier run has told, or that Home Assistant has started; say whether all is owed to it."""
        if message.topic != self._birth:
            if message.is_retained and message.payload:
                self._found(message.topic.removeprefix(self._root).removesuffix("/config"), message.payload)
            return False
        if not message.is_retained and message.payload.strip() == ONLINE.encode():
            self._is_asked = True
        return self.look(now)

    def _found(self, key: str, text: bytes) -> None:
        """Take back what is no more: a whole drive by nothing, entities by their names, after which all is told."""
        device = self._devices.get(key)
        if device is None:
            self._owed[key] = [NOTHING]
            return
        removal = device.removal(known_components(text))
        if removal is not None:
            self._owed[key] = [removal, None]

    def look(self, now: float) -> bool:
        """Say whether Home Assistant has asked for everything, and owe it; but not too often."""
        if not self._is_asked or now < self._not_before:
            return False
        self._is_asked, self._not_before = False, now + BIRTH_PAUSE
        self.owe_everything()
        return True

    def notice(self, image: DriveImage) -> None:
        """Take that who a drive is may have become known."""
        key = ident(image.drive.name)
        if self._devices[key].is_news:
            self._owed.setdefault(key, [None])

    def next(self) -> tuple[str, str]:
        """Return topic and text of the next message; both are for ever."""
        key, texts = next(iter(self._owed.items()))
        text = texts.pop(0)
        if not texts:
            del self._owed[key]
        return f"{self._root}{key}/config", self._devices[key].message() if text is None else text

    def topics(self) -> list[str]:
        """Return the topics that are published under."""
        return [f"{self._root}{key}/config" for key in self._devices]
