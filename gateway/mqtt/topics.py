"""Says under which topic everything is published."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.config import MqttSection
from gateway.image import DriveImage
from gateway.mqtt.commands import COMMAND, HEARTBEAT, LINE, SET
from gateway.site import Site

AVAILABILITY = "availability"
STATE = "state"
TRIPPED = "tripped"
RESET_NEEDED = "reset_needed"
CONTROL = "control"
DESCRIPTION = "description"
EVENT, RESULT = "event", "result"
HISTORY = "history"  # the level below a drive under which stands what a broker has missed

# Levels below a drive that are no values: what is published besides, and what is taken for control and description.
PUBLISHED = frozenset({AVAILABILITY, STATE, TRIPPED, RESET_NEEDED, CONTROL, DESCRIPTION, EVENT})
RESERVED = PUBLISHED | {SET, COMMAND, HEARTBEAT, RESULT, HISTORY}


@dataclass(frozen=True, slots=True)
class ValueTopics:
    """The topics of one value; `text` is None where a number says all."""

    value: str
    text: str | None
    quality: str


@dataclass(frozen=True, slots=True)
class DriveTopics:
    """The topics of one drive."""

    availability: str
    tripped: str
    reset_needed: str
    control: str
    description: str
    event: str
    state: str
    values: Mapping[str, ValueTopics]


def status(base: str, gateway: str) -> str:
    """Return the topic that says whether the gateway itself is there: birth and will."""
    return f"{base}/{gateway}/status"


def level(name: str) -> str:
    """Return the topic level of a value; a name that is taken for another use gets "_value" behind it."""
    return f"{name}_value" if name in RESERVED else name


def has_text(image: DriveImage, name: str) -> bool:
    """Say whether a value is a bit field or a code, which have words besides the number."""
    return image.text(name, 0) is not None


def of_drive(base: str, gateway: str, image: DriveImage) -> DriveTopics:
    """Make all topics of a drive."""
    root = f"{base}/{gateway}/{image.drive.name}"
    return DriveTopics(
        availability=f"{root}/{AVAILABILITY}",
        tripped=f"{root}/{TRIPPED}",
        reset_needed=f"{root}/{RESET_NEEDED}",
        control=f"{root}/{CONTROL}",
        description=f"{root}/{DESCRIPTION}",
        event=f"{root}/{EVENT}",
        state=f"{root}/{STATE}",
        values={name: _of_value(f"{root}/{level(name)}", has_text(image, name)) for name in image.names},
    )


def _of_value(value: str, has_words: bool) -> ValueTopics:
    return ValueTopics(value, f"{value}_text" if has_words else None, f"{value}/quality")


def overview(section: MqttSection, site: Site) -> list[str]:
    """List every topic that a site publishes under, for the integrator."""
    gateway = site.config.gateway.name
    listed = [status(section.base, gateway)]
    for drive in site.drives:
        topics = of_drive(section.base, gateway, DriveImage(drive))
        listed += [topics.availability, topics.tripped, topics.reset_needed, topics.control]
        listed += [topics.description, topics.event]
        if drive.is_controlled:
            listed.append(f"{topics.event.removesuffix(EVENT)}{RESULT}")
        if "state" in section.publish:
            listed.append(topics.state)
        if "values" in section.publish:
            listed += _of_values(topics)
        if section.store.enabled:
            listed.append(f"{topics.state.removesuffix(STATE)}{HISTORY}/#")
    return listed


def taken(section: MqttSection, site: Site) -> list[str]:
    """List every topic at which drives of a site can be commanded by this broker; `+` stands for a value's name."""
    root = f"{section.base}/{site.config.gateway.name}"
    listed = []
    for line in site.lines if section.commands else ():
        drives = [drive for drive in line.drives if drive.is_commanded_by("mqtt")]
        for drive in drives:
            listed += [f"{root}/{drive.name}/{level}" for level in (COMMAND, f"{SET}/+", HEARTBEAT)]
        listed += [f"{root}/{LINE}/{line.name}/{COMMAND}"] if drives else []
    return listed


def _of_values(topics: DriveTopics) -> list[str]:
    listed = []
    for value in topics.values.values():
        listed += [topic for topic in (value.value, value.text, value.quality) if topic is not None]
    return listed
