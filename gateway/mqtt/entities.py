"""Says what of a drive's values and state Home Assistant is to show: sensors, binary sensors, events.

Keys and templates are those of its MQTT integration. A number that is not good is unavailable there, as it is here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from gateway.config import MqttSection
from gateway.drives.register import Kind, Register
from gateway.image import DriveImage
from gateway.mqtt import events, payload, topics
from gateway.mqtt.operating import bits_of

Component = dict[str, Any]

UNITS = {"min-1": "rpm"}  # where Home Assistant has another word
DEVICE_CLASSES = {
    "Hz": "frequency",
    "A": "current",
    "V": "voltage",
    "W": "power",
    "kW": "power",
    "Wh": "energy",
    "kWh": "energy",
    "h": "duration",
    "min": "duration",
    "s": "duration",
    "°C": "temperature",
}
COUNTED = ("cumulative_",)  # how names of values begin that only grow
LONGEST_STATE = 255  # characters (homeassistant.const.MAX_LENGTH_STATE_STATE)
DIAGNOSTIC = "diagnostic"
TELLING_BITS = {"running": "running", "alarm": "problem"}  # of the status: what is a binary sensor of its own


@dataclass(frozen=True, slots=True)
class Place:
    """Where a drive's values stand on the broker, and how its entities are called."""

    image: DriveImage
    named: topics.DriveTopics
    gateway_status: str
    has_values: bool

    @classmethod
    def of(cls, section: MqttSection, gateway: str, image: DriveImage) -> Place:
        """Return the place of a drive."""
        named = topics.of_drive(section.base, gateway, image)
        return cls(image, named, topics.status(section.base, gateway), "values" in section.publish)

    @property
    def root(self) -> str:
        """Return the topic of the drive itself: gateway and drive, by which it is known everywhere."""
        return self.named.availability.removesuffix(f"/{topics.AVAILABILITY}")

    def entity(self, platform: str, key: str, name: str, **options: Any) -> Component:
        """Return a component with its identity; `key` says what of the drive it is, for ever. None is left out."""
        made = {
            "platform": platform,
            "unique_id": f"{self.root}/{key}",
            "default_entity_id": f"{platform}.{slug(f'{self.image.drive.name} {name}')}",
            "name": name,
            **options,
        }
        return {option: value for option, value in made.items() if value is not None}

    # ---- when something can be seen

    @property
    def of_gateway(self) -> list[Component]:
        """Return when the gateway is there."""
        return [{"topic": self.gateway_status}]

    @property
    def of_drive(self) -> list[Component]:
        """Return when the gateway is there, and the drive answers."""
        return [*self.of_gateway, {"topic": self.named.availability}]

    def of_value(self, name: str) -> list[Component]:
        """Return when a value is good."""
        if self.has_values:
            is_good, topic = "value == 'good'", self.named.values[name].quality
        else:
            is_good, topic = f"value_json['{payload.key(name)}'] is not none", self.named.state
        return [*self.of_gateway, {"topic": topic, "value_template": _when(is_good)}]

    # ---- where it stands

    def number(self, name: str) -> tuple[str, str]:
        """Return the topic of a value, and the expression that is its number."""
        if self.has_values:
            return self.named.values[name].value, "value"
        return self.named.state, f"value_json['{payload.key(name)}']"

    def words(self, name: str) -> tuple[str, str]:
        """Return the topic of a value's words, and the expression that is them."""
        if self.has_values:
            return self.named.values[name].text or "", "value"
        return self.named.state, f"value_json['{payload.key(name)}_text']"


def slug(text: str) -> str:
    """Return a text as an entity id spells it."""
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")


def _when(expression: str) -> str:
    return f"{{{{ 'online' if {expression} else 'offline' }}}}"


def when(expression: str) -> str:
    """Return the template of an availability whose message is JSON, or nothing."""
    return _when(f"value_json is defined and {expression}")


def titled(name: str) -> str:
    """Return a value's name as people write it: "Output frequency"."""
    return name.replace("_", " ").capitalize()


def is_set(expression: str, mask: int) -> str:
    """Return the expression that says whether one of some bits is set."""
    return f"{expression} | int(0) | bitwise_and({mask})"


def on_off(expression: str) -> str:
    """Return the template of a binary state."""
    return f"{{{{ 'ON' if {expression} else 'OFF' }}}}"


def of_values(place: Place) -> dict[str, Component]:
    """Return the components of every value that is read."""
    found: dict[str, Component] = {}
    for name in place.image.names:
        register = None if name in place.image.derived else place.image.points[name].register
        if register is not None and register.bits:
            found |= _of_bits(place, name, register)
        elif register is not None and register.enumeration is not None:
            found[name] = _of_words(place, name, None if register.name == events.TRIP_CODE else _category(register))
        else:
            found[name] = _of_number(place, name, register)
    return found


def _category(register: Register) -> str | None:
    return None if register.kind is Kind.MONITOR else DIAGNOSTIC


def _of_number(place: Place, name: str, register: Register | None) -> Component:
    image = place.image
    unit = image.unit(name)
    digits = image.derived[name].digits if register is None else register.scaling.digits
    topic, expression = place.number(name)
    return place.entity(
        "sensor",
        name,
        titled(name),
        state_topic=topic,
        value_template=None if expression == "value" else f"{{{{ {expression} }}}}",
        unit_of_measurement=UNITS.get(unit, unit) or None,
        device_class=DEVICE_CLASSES.get(unit),
        state_class=_state_class(name, unit, register),
        suggested_display_precision=digits,
        entity_category=None if register is None else _category(register),
        availability=place.of_value(name),
        availability_mode="all",
    )


def _state_class(name: str, unit: str, register: Register | None) -> str | None:
    """Say whether it is a quantity or a count; a setting is neither, and has no statistics."""
    if name.startswith(COUNTED) or unit in ("Wh", "kWh"):
        return "total_increasing"
    return "measurement" if register is None or register.kind in (Kind.MONITOR, Kind.TRIP_HELD) else None


def _of_words(place: Place, name: str, category: str | None) -> Component:
    topic, expression = place.words(name)
    return place.entity(
        "sensor",
        name,
        titled(name),
        state_topic=topic,
        value_template=f"{{{{ ({expression} or '')[:{LONGEST_STATE}] }}}}",  # null in the state where it is not good
        entity_category=category,
        availability=place.of_value(name),
        availability_mode="all",
    )


def _of_bits(place: Place, name: str, register: Register) -> dict[str, Component]:
    """Return an alarm bit by bit, the status in words and with what matters most, another register in words."""
    masks = bits_of(register)
    if "alarm" in name:
        found = {name: _bit(place, name, titled(name), register.mask, "problem", None)}
        for bit, mask in masks.items():
            title = f"{titled(name)} {bit.replace('_', ' ')}"
            found[f"{name}/{bit}"] = _bit(place, name, title, mask, "problem", DIAGNOSTIC, f"{name}/{bit}")
        return found
    found = {name: _of_words(place, name, DIAGNOSTIC)}
    for bit, device_class in TELLING_BITS.items() if name == "status" else ():
        if bit in masks and bit not in place.image.points:
            found[f"{name}/{bit}"] = _bit(place, name, titled(bit), masks[bit], device_class, None, f"{name}/{bit}")
    return found


def _bit(
    place: Place, name: str, title: str, mask: int, device_class: str, category: str | None, key: str = ""
) -> Component:
    topic, expression = place.number(name)
    return place.entity(
        "binary_sensor",
        key or name,
        title,
        state_topic=topic,
        value_template=on_off(is_set(expression, mask)),
        device_class=device_class,
        entity_category=category,
        availability=place.of_value(name),
        availability_mode="all",
    )


def of_state(place: Place) -> dict[str, Component]:
    """Return the components of what is known of a drive besides its values."""
    named = place.named
    yes_no = {"payload_on": "true", "payload_off": "false"}
    drive = {"availability": place.of_drive, "availability_mode": "all"}
    gateway = {"availability": place.of_gateway}
    link = {"payload_on": payload.ONLINE, "payload_off": payload.OFFLINE}
    attributes = "{'reason': value_json.reason, 'code': value_json.code | default(none)}"
    event = f"{{{{ dict({attributes}, event_type=value_json.event) | to_json }}}}"
    return {
        "state/tripped": place.entity(
            "binary_sensor", "state/tripped", "Tripped", state_topic=named.tripped, device_class="problem",
            **yes_no, **drive,
        ),
        "state/reset_needed": place.entity(
            "binary_sensor", "state/reset_needed", "Reset needed", state_topic=named.reset_needed,
            device_class="problem", entity_category=DIAGNOSTIC, **yes_no, **drive,
        ),
        "state/link": place.entity(
            "binary_sensor", "state/link", "Link", state_topic=named.availability, device_class="connectivity",
            entity_category=DIAGNOSTIC, **link, **gateway,
        ),
        "state/event": place.entity(
            "event", "state/event", "Event", state_topic=named.event, event_types=list(events.KINDS),
            value_template=event, **gateway,
        ),
    }  # fmt: skip
