"""Finds what is wrong in fact in the MQTT sections: names that nothing has, and what Home Assistant cannot do."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from pydantic import ValidationError

from gateway.config import DriveSection, FilterSection, HomeAssistantSection
from gateway.config.broker_tables import brokers
from gateway.drives.model import Model

FASTEST_BEAT = 1.0  # seconds: an automation of Home Assistant is started by the clock once a second at the most
LEAST_LEASE = 2 * FASTEST_BEAT + 0.5  # one beat may be lost, or late

Used = Sequence[tuple[str, DriveSection, Model]]  # key, drive and model of each drive that is right in itself


def contradictions(table: Mapping[str, Any], used: Used) -> Iterator[str]:
    """Yield what is wrong with the tables `mqtt` and `sparkplug` of a configuration, a line each."""
    if not used:
        return
    edge = table.get("sparkplug")
    if isinstance(edge, dict):
        yield from _unknown_deadbands("sparkplug", edge, used)
    for key, section in brokers(table):
        yield from _unknown_deadbands(key, section, used)
        yield from _idle_filters(key, section, used)
        yield from _wrong_home_assistant(key, section, used)


def _names(model: Model) -> list[str]:
    return [*model.registers, *(derived.name for derived in model.derived)]


def _unknown_deadbands(key: str, section: Mapping[str, Any], used: Used) -> Iterator[str]:
    """Find names under mqtt.deadband and sparkplug.deadband that no configured drive has."""
    bands = section.get("deadband")
    names = {name for _, _, model in used for name in _names(model)}
    for name in bands if isinstance(bands, dict) else ():
        if name not in names:
            near = difflib.get_close_matches(name, names, 1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            yield f"{key}.deadband: no configured drive has a value {name!r}{hint}"


def _idle_filters(key: str, section: Mapping[str, Any], used: Used) -> Iterator[str]:
    """Find patterns of filters that speak of no drive, or of no value of those drives."""
    filters = section.get("filter")
    for i, table in enumerate(filters if isinstance(filters, list) else []):
        try:
            found = FilterSection.model_validate(table)
        except ValidationError:
            continue  # its own problems are listed already
        spoken_of: list[str] = []
        for pattern in found.drives:
            models = [model for _, drive, model in used if fnmatchcase(drive.name, pattern)]
            spoken_of += [name for model in models for name in _names(model)]
            if not models:
                yield f"{key}.filter[{i}].drives: no configured drive is called {pattern!r}"
        for pattern in found.values if spoken_of else ():
            if not any(fnmatchcase(name, pattern) for name in spoken_of):
                near = difflib.get_close_matches(pattern, spoken_of, 1)
                hint = f"; did you mean {near[0]!r}?" if near else ""
                yield f"{key}.filter[{i}].values: no such drive has a value {pattern!r}{hint}"


def _wrong_home_assistant(broker: str, section: Mapping[str, Any], used: Used) -> Iterator[str]:
    """Find drives that Home Assistant could not tell apart, and leases that it cannot keep."""
    try:
        found = HomeAssistantSection.model_validate(section.get("home_assistant", {}))
    except ValidationError:
        return  # its own problems are listed already
    if not found.enabled:
        return
    taken: dict[str, str] = {}
    for key, drive, _ in used:
        name = drive.name.replace(".", "_")
        if taken.setdefault(name, drive.name) != drive.name:
            yield f"{key}.name: {drive.name!r} and {taken[name]!r} are one to Home Assistant, which knows no dots"
        is_beaten = found.heartbeat and drive.control == "leased" and "mqtt" in drive.sources
        if is_beaten and drive.lease < LEAST_LEASE:
            beat = f"{broker}.home_assistant.heartbeat: an automation beats every {FASTEST_BEAT:g} s"
            yield f"{key}.lease: {drive.lease:g} s is too short for it: {LEAST_LEASE:g} s at the least ({beat})"
