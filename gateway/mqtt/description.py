"""Says what a drive and its values are: units, decimals, texts, how often they are read; and what may be asked."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from gateway.config import FallbackSection, MqttSection
from gateway.drives.register import Derived, Register
from gateway.image import DriveImage
from gateway.mqtt import payload, topics
from gateway.mqtt.filters import Policy, policies
from gateway.mqtt.operating import operation_of

FORM = 1  # of the description; a higher one may mean something else by a key


class Description:
    """The description of one drive: all of it is known from the start, but for who the drive says it is."""

    def __init__(self, image: DriveImage, section: MqttSection, gateway: str) -> None:
        self._image = image
        named = topics.of_drive(section.base, gateway, image)
        drive = image.drive
        self._head = {
            "form": FORM,
            "gateway": gateway,
            "drive": drive.name,
            "line": drive.line,
            "number": drive.number,
            "protocol": drive.protocol,
            "model": drive.model.name,
            "title": drive.model.title,
        }
        policy = policies(section, image)
        values = {name: _value(image, name, named, section, policy[name]) for name in image.names}
        self._tail = {"control": _control(image, section), "values": values}
        self._identity: Mapping[str, str] | None = None
        self._text = ""

    def write(self) -> str:
        """Return it as JSON, as it is now."""
        identity = self._image.identity
        if identity != self._identity:
            self._identity = dict(identity)
            document = {**self._head, "identity": self._identity, **self._tail}
            self._text = json.dumps(document, ensure_ascii=False, separators=(",", ":"))
        return self._text


def _value(
    image: DriveImage, name: str, named: topics.DriveTopics, section: MqttSection, policy: Policy
) -> dict[str, Any]:
    """Describe one value; what it has not got is left out."""
    derived = image.derived.get(name)
    point = image.points[derived.of if derived else name]
    found = _of_derived(derived) if derived else _of_register(point.register)
    periods = [group.period for group in image.drive.groups if point.register in group.registers]
    found |= {"poll": min(periods, default=0.0), "max_age": round(point.max_age, 3)}
    found |= {"deadband": float(policy.band), "deadband_percent": float(policy.share * 100)}
    found |= {"min_interval": policy.min_interval, "max_interval": policy.max_interval}
    if "values" in section.publish:
        each = named.values[name]
        found |= {"topic": each.value, "text_topic": each.text, "quality_topic": each.quality}
    if "state" in section.publish:
        found["state_key"] = payload.key(name)
    return {key: value for key, value in found.items() if value not in (None, "", {})}


def _of_register(register: Register) -> dict[str, Any]:
    return {
        "title": register.title,
        "kind": register.kind.value,
        "unit": register.unit,
        "decimals": register.scaling.digits,
        "scale": float(register.scaling.scale),
        "signed": register.scaling.signed,
        "address": f"{register.address:04X}",
        "storage": register.storage.value if register.is_writable else "read_only",
        "texts": {} if register.enumeration is None else _texts(register),
        "bits": {str(bit): name for bit, name in register.bits.items()},
    }


def _texts(register: Register) -> dict[str, str]:
    known = register.enumeration.texts if register.enumeration is not None else {}
    return {str(code): register.text(code) or "" for code in known}


def _of_derived(derived: Derived) -> dict[str, Any]:
    return {
        "title": derived.name.replace("_", " ").capitalize(),
        "kind": "derived",
        "unit": derived.unit,
        "decimals": derived.digits,
        "of": derived.of,
        "base": derived.base,
    }


def _control(image: DriveImage, broker: MqttSection) -> dict[str, Any]:
    """Say what controllers may do by this broker, as configured; rights may let one of them do less."""
    section, operation = image.drive.section, operation_of(image.drive, broker)
    if section is None or section.control == "off":
        return {"mode": "off"}
    loss = section.on_loss
    found: dict[str, Any] = {
        "mode": section.control,
        "sources": list(section.sources),
        "on_loss": {"frequency": loss.frequency} if isinstance(loss, FallbackSection) else loss,
        "on_exit": section.on_exit,
        "command_timeout": section.command_timeout,
    }
    if section.control == "leased":
        found["lease"] = section.lease
    if operation is not None:
        bounds = {"min": float(operation.least), "max": float(operation.greatest), "step": float(operation.step)}
        found |= {"commands": sorted(operation.verbs), "frequency": {**bounds, "unit": "Hz"}}
    return found
