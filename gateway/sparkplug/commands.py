"""Reads NCMD and DCMD: what the metrics of a command ask for, spelt as MQTT spells it, and read by its rules. Pure.

Every metric is one command, in the order in which they stand. What is retained, late or not understood is refused.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from gateway.control.command import Command, Reason, Result, Source, Status, Verb
from gateway.drives.model import Model
from gateway.mqtt import commands
from gateway.mqtt.commands import Read
from gateway.mqtt.message import Beat, LineStop, Message, Moment
from gateway.sparkplug import payload
from gateway.sparkplug.drive_metrics import BUTTONS, COMMAND, FREQUENCY, HEARTBEAT
from gateway.sparkplug.payload import Metric, Payload
from gateway.sparkplug.protobuf import BadPayload

RUNS = ("Control/Run", "Control/Run Reverse")  # buttons at which false is a stop; at all others it is nothing
STOP = b"stop"


@dataclass(frozen=True, slots=True)
class Target:
    """A drive that a DCMD is for: what of it can be written, by metric name or alias, and its model."""

    drive: str
    writable: Mapping[str | int, str]
    model: Model


@dataclass(frozen=True, slots=True)
class Asked:
    """Who asks, when it came, and whether the primary host is online, without which only stops are carried out."""

    source: Source
    moment: Moment
    is_host_online: bool


@dataclass(frozen=True, slots=True)
class Rebirth:
    """A request for all births."""


def read_device(message: Message, target: Target, asked: Asked) -> list[Read]:
    """Return what a DCMD asks for, or its refusal, metric by metric."""
    blank = _blank(target.drive, asked)
    try:
        command = payload.decode(message.payload)
    except BadPayload as error:
        return [Result(blank, Status.REFUSED, Reason.MALFORMED, f"no Sparkplug payload: {error}")]
    return [each for metric in command.metrics for each in _of_device(message, metric, command, target, asked)]


def _of_device(message: Message, metric: Metric, command: Payload, target: Target, asked: Asked) -> Iterator[Read]:
    name = _written(metric, target.writable)
    blank = _blank(target.drive, asked)
    if name is None:
        text = f"{_shown(metric)} is no metric of {target.drive} that can be written"
        yield Result(blank, Status.REFUSED, Reason.NOT_IN_MODEL, text)
        return
    if name in BUTTONS and metric.value is False and name not in RUNS:
        return  # a button that is let go
    levels, text_of_it = _spelt(name, metric, target.drive)
    if text_of_it is None:
        text = f"{_shown(metric)}: true, a number or a text is wanted"
        yield Result(blank, Status.REFUSED, Reason.MALFORMED, text)
        return
    letter = replace(message, payload=text_of_it, response_topic="")
    found = commands.read(letter, levels, asked.moment, target.model)
    if found is not None:
        yield from _checked(found, command, asked)


def read_node(message: Message, lines: Mapping[str | int, str], rebirth: str, asked: Asked) -> list[Read | Rebirth]:
    """Return what an NCMD asks for: a rebirth, or stops of a line; BadPayload where it is no payload."""
    found: list[Read | Rebirth] = []
    command = payload.decode(message.payload)
    for metric in command.metrics:
        line = _written(metric, lines)
        if metric.name == rebirth:
            found += [Rebirth()] if metric.value is True and not message.is_retained else []
        elif line is not None and isinstance(metric.value, str):
            letter = replace(message, payload=metric.value.encode(errors="replace"), response_topic="")
            read = commands.read(letter, (commands.LINE, line, commands.COMMAND), asked.moment)
            found += [] if read is None else _checked(read, command, asked)
    return found


def _written(metric: Metric, writable: Mapping[str | int, str]) -> str | None:
    """Return what a metric writes to, by its name, else by its alias."""
    if metric.name:
        return writable.get(metric.name)
    return None if metric.alias is None else writable.get(metric.alias)


def _spelt(name: str, metric: Metric, drive: str) -> tuple[tuple[str, ...], bytes | None]:
    """Return the levels and the payload that MQTT has for this; None for a payload that cannot be."""
    value = metric.value
    if name in BUTTONS:
        pressed = BUTTONS[name] if value is True else STOP
        return (drive, commands.COMMAND), pressed if isinstance(value, bool) else None
    if name == COMMAND:
        return (drive, commands.COMMAND), value.encode(errors="replace") if isinstance(value, str) else None
    if name == HEARTBEAT:
        return (drive, commands.HEARTBEAT), _plain(value)
    return (drive, commands.SET, "frequency" if name == FREQUENCY else name), _plain(value)


def _plain(value: payload.Value) -> bytes | None:
    """Return a number or a text as it is written; None for what is neither, or no number at all."""
    match value:
        case bool() | bytes() | None:
            return None
        case float():
            return repr(value).encode() if math.isfinite(value) else None
        case int():
            return str(value).encode()
    return json.dumps(value).encode()


def _checked(found: Read, command: Payload, asked: Asked) -> Iterator[Read]:
    """Yield what was read as of its source, or why it is not carried out; a late heartbeat is none."""
    match found:
        case Beat():
            if not _is_late(command, asked.moment):
                yield replace(found, source=asked.source)
        case LineStop():
            yield replace(found, command=replace(found.command, source=asked.source))
        case Result():
            yield replace(found, command=replace(found.command, source=asked.source))
        case Command():
            named = replace(found, source=asked.source)
            yield named if named.verb.is_stopping else _permitted(named, command, asked)


def _permitted(named: Command, command: Payload, asked: Asked) -> Read:
    if _is_late(command, asked.moment):
        most = asked.moment.max_age
        text = f"sent {_age(command, asked.moment):.1f} s ago by its time; at most {most:g} s: set the clocks"
        return Result(named, Status.REFUSED, Reason.EXPIRED, text)
    if not asked.is_host_online:
        text = f"the primary host {asked.source.name} is not online"
        return Result(named, Status.REFUSED, Reason.NOT_PERMITTED, text)
    return named


def _is_late(command: Payload, moment: Moment) -> bool:
    """Say whether it was sent too long ago, or in the future, by the time that it must carry (6.4.19)."""
    return abs(_age(command, moment)) > moment.max_age


def _age(command: Payload, moment: Moment) -> float:
    return 0.0 if command.timestamp is None else moment.wall - command.timestamp / 1000


def _blank(drive: str, asked: Asked) -> Command:
    now = asked.moment.now
    return Command(drive, Verb.SET, asked.source, now, now + asked.moment.good_for)


def _shown(metric: Metric) -> str:
    named = json.dumps(metric.name) if metric.name else f"alias {metric.alias}"
    return named if len(named) <= 60 else f"{named[:57]}..."
