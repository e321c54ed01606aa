"""Reads what controllers send: commands, values to be set, heartbeats; and writes what became of them.

Pure. A command that is retained, late or not understood is refused here, with its reason (SAFETY.md H01, H02).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from typing import Any

from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.mqtt.payload import timestamp

COMMAND, SET, HEARTBEAT = "command", "set", "heartbeat"  # levels below a drive that are listened to
RESULT, EVENT = "result", "event"  # levels below a drive that tell what came of it
LARGEST = 4096  # bytes of a payload; no command needs more
LONGEST_ID = 128
SHORT_NAMES = {"frequency": Verb.FREQUENCY, "speed": Verb.SPEED, "terminals": Verb.TERMINALS, "analog": Verb.ANALOG}
VALUE_KEYS = ("value", "frequency", "speed", "number")  # what carries a command's number
KEYS = frozenset({"id", "command", "direction", "name", "issued", "expires", "source", *VALUE_KEYS})
DIRECTIONS = {"forward": False, "reverse": True}


@dataclass(frozen=True, slots=True)
class Message:
    """A message as it came: its topic below `<base>/<gateway>/`, and whether the broker had kept it."""

    levels: tuple[str, ...]
    payload: bytes
    is_retained: bool = False
    expiry: int | None = None  # seconds that the broker says it is still good for
    response_topic: str = ""  # of MQTT 5
    correlation: bytes = b""


@dataclass(frozen=True, slots=True)
class Beat:
    """A sign of life of a controller."""

    drive: str
    source: Source
    beat: bytes


@dataclass(frozen=True, slots=True)
class Moment:
    """When a message came: monotonic and UTC seconds, and how long a command is good for by default."""

    now: float
    wall: float
    good_for: float


class NotUnderstood(Exception):
    """A message that is no command; `reason` is for programs."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason = reason


def read(message: Message, moment: Moment) -> Command | Beat | Result | None:
    """Return what a message asks for, its refusal, or None where it is none of ours."""
    drive, kind = message.levels[0], message.levels[1] if len(message.levels) > 1 else ""
    blank = Command(drive, Verb.SET, Source(Channel.MQTT), moment.now, moment.now + moment.good_for)
    if kind == HEARTBEAT and len(message.levels) == 2:
        return None if message.is_retained else _beat(drive, message.payload)
    if kind not in (COMMAND, SET) or len(message.levels) != (2 if kind == COMMAND else 3):
        return None
    try:
        return _command(message, blank, moment)
    except NotUnderstood as error:
        known = replace(blank, id=_id_of(message.payload))
        return Result(known, Status.REFUSED, error.reason, str(error))


def _beat(drive: str, payload: bytes) -> Beat:
    """Read a heartbeat: any payload, or JSON with `source` where several controllers share a drive."""
    table = _table(payload)
    name = table.get("source") if table else None
    return Beat(drive, Source(Channel.MQTT, name if isinstance(name, str) else ""), payload[:LARGEST])


def _command(message: Message, blank: Command, moment: Moment) -> Command:
    if message.is_retained:
        raise NotUnderstood(Reason.RETAINED, "it was retained: a command counts only when it is sent")
    if len(message.payload) > LARGEST:
        raise NotUnderstood(Reason.MALFORMED, f"{len(message.payload)} bytes; at most {LARGEST}")
    table = _table(message.payload)
    if message.levels[1] == SET:
        return _setting(message, table, blank, moment)
    if table is None:
        table = {"command": _text(message.payload).strip()}
    return _typed(table, blank, moment, message.expiry)


def _table(payload: bytes) -> dict[str, Any] | None:
    """Return a JSON object with exact numbers; None where it is something else."""
    try:
        table = json.loads(payload, parse_float=Decimal, parse_int=Decimal)
    except (ValueError, RecursionError):
        return None
    return table if isinstance(table, dict) else None


def _text(payload: bytes) -> str:
    try:
        return payload.decode()
    except UnicodeDecodeError:
        raise NotUnderstood(Reason.MALFORMED, "neither text nor JSON") from None


def _id_of(payload: bytes) -> str:
    table = _table(payload[:LARGEST]) or {}
    known = table.get("id", "")
    return str(known)[:LONGEST_ID] if isinstance(known, str | Decimal) else ""


def _setting(message: Message, table: dict[str, Any] | None, blank: Command, moment: Moment) -> Command:
    """Read a value to be set: plain, or JSON with `value`."""
    name = message.levels[2]
    if table is None:
        table = {"value": _text(message.payload).strip()}
    if "value" not in table:
        raise NotUnderstood(Reason.MALFORMED, 'a value is wanted: 30.0, or {"value": 30.0, "id": "42"}')
    command = _common(table, blank, moment, message.expiry)
    verb = SHORT_NAMES.get(name, Verb.SET)
    return replace(command, verb=verb, name=name, **_value(table["value"], may_be_text=verb is Verb.SET))


def _typed(table: Mapping[str, Any], blank: Command, moment: Moment, expiry: int | None) -> Command:
    if unknown := sorted(set(table) - KEYS):
        raise NotUnderstood(Reason.MALFORMED, f"unknown key {unknown[0]!r}; known: {', '.join(sorted(KEYS))}")
    word = table.get("command")
    if word not in set(Verb) - {Verb.WORDS}:
        known = ", ".join(verb for verb in Verb if verb is not Verb.WORDS)
        raise NotUnderstood(Reason.MALFORMED, f"command {word!r} is not known; known: {known}")
    direction = table.get("direction", "forward")
    if direction not in DIRECTIONS:
        raise NotUnderstood(Reason.MALFORMED, f"direction {direction!r}: forward or reverse")
    command = replace(_common(table, blank, moment, expiry), verb=Verb(word), is_reverse=DIRECTIONS[direction])
    numbers = [table[key] for key in VALUE_KEYS if key in table]
    if len(numbers) > 1:
        raise NotUnderstood(Reason.MALFORMED, f"only one of {', '.join(VALUE_KEYS)}")
    if command.verb is Verb.SET and not isinstance(table.get("name"), str):
        raise NotUnderstood(Reason.MALFORMED, "set needs a name and a value")
    value = _value(numbers[0], may_be_text=command.verb is Verb.SET) if numbers else {}
    return replace(command, name=str(table.get("name", "")), **value)


def _value(value: object, *, may_be_text: bool) -> dict[str, Any]:
    """Return a number exactly as it was written, or a code or bits by name."""
    if isinstance(value, Decimal) and value.is_finite():
        return {"value": value}
    if isinstance(value, str):
        try:
            number = Decimal(value)
        except InvalidOperation:
            if may_be_text and value:
                return {"text": value}
        else:
            if number.is_finite():
                return {"value": number}
    raise NotUnderstood(Reason.MALFORMED, f"{value!r} is no number")


def _common(table: Mapping[str, Any], blank: Command, moment: Moment, expiry: int | None) -> Command:
    """Read who asks, the id, and until when it is good."""
    name = table.get("source", "")
    if not isinstance(name, str) or len(name) > LONGEST_ID:
        raise NotUnderstood(Reason.MALFORMED, "source is a short text")
    deadline = blank.deadline
    if expiry is not None:
        deadline = min(deadline, moment.now + expiry)
    if "issued" in table and moment.wall - _time(table["issued"]) > moment.good_for:
        raise NotUnderstood(Reason.EXPIRED, f"issued {timestamp(_time(table['issued']))}: too old")
    if "expires" in table:
        left = _time(table["expires"]) - moment.wall
        if left <= 0:
            raise NotUnderstood(Reason.EXPIRED, f"it expired {-left:.3f} s before it came")
        deadline = min(deadline, moment.now + left)
    known = table.get("id", "")
    if not isinstance(known, str | Decimal) or len(str(known)) > LONGEST_ID:
        raise NotUnderstood(Reason.MALFORMED, "id is a short text")
    return replace(blank, source=Source(Channel.MQTT, name), id=str(known), deadline=deadline)


def _time(value: object) -> float:
    """Return UTC seconds from ISO 8601 or from a number of seconds."""
    if isinstance(value, Decimal):
        return float(value)
    try:
        moment = datetime.fromisoformat(str(value))
    except ValueError:
        raise NotUnderstood(Reason.MALFORMED, f"{value!r} is no time: 2026-03-01T12:00:00Z") from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def result(outcome: Result, wall: float) -> str:
    """Return what is published of a result."""
    command = outcome.command
    table: dict[str, Any] = {
        "id": command.id,
        "command": str(command.verb),
        "source": str(command.source),
        "status": str(outcome.status),
        "reason": str(outcome.reason) or None,
        "text": outcome.text or None,
        "raw": dict(outcome.raw),
        "read_back": dict(outcome.read_back),
        "time": timestamp(wall),
    }
    return json.dumps({key: value for key, value in table.items() if value not in (None, "", {})})


def event(kind: str, reason: str, wall: float) -> str:
    """Return what is published of an event."""
    return json.dumps({"event": kind, "reason": reason, "time": timestamp(wall)})
