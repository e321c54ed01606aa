"""Reads what controllers send: commands, values to be set, heartbeats.

Pure. What is retained, late or not understood is refused here, with its reason (SAFETY.md H01, H02). A stop is taken
whatever else its message says, and whatever the clocks say, unless it is an old one that the broker had kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.drives import notation
from gateway.drives.model import Model
from gateway.mqtt import exact
from gateway.mqtt.exact import NotExact
from gateway.mqtt.message import Beat, LineStop, Message, Moment, NotTaken
from gateway.mqtt.stop_words import stop_in, verb_of

COMMAND, SET, HEARTBEAT = "command", "set", "heartbeat"  # levels below a drive that are listened to
ANYBODY = Source(Channel.MQTT)
LINE = "line"  # the level before the name of a line
MOST_WORDS = 16  # that one command may write
KEPT = "it was retained: a command counts only when it is sent"

COMMON = ("command", "id", "source", "issued", "expires")
NUMBERS: Mapping[Verb, tuple[str, ...]] = {  # keys that carry a command's number; one of them may stand there
    Verb.RUN: ("frequency", "value"),
    Verb.FREQUENCY: ("frequency", "value"),
    Verb.SPEED: ("speed", "value"),
    Verb.PRESET: ("number", "value"),
    Verb.ACCELERATION: ("number", "value"),
    Verb.TERMINALS: ("value",),
    Verb.ANALOG: ("value",),
    Verb.SET: ("value",),
}
OTHERS: Mapping[Verb, tuple[str, ...]] = {
    Verb.RUN: ("direction", "reverse"),
    Verb.JOG: ("direction", "reverse"),
    Verb.SET: ("name",),
    Verb.WORDS: ("address", "words"),
}
KEYS = {verb: (*COMMON, *OTHERS.get(verb, ()), *NUMBERS.get(verb, ())) for verb in Verb}
SET_KEYS = ("value", "id", "source", "issued", "expires")
WORDED = (Verb.SET, Verb.TERMINALS)  # whose value may be a code, or bits by name
SHORT_NAMES = {verb.value: verb for verb in NUMBERS if verb not in (Verb.RUN, Verb.SET)}  # set/frequency and the like
DIRECTIONS = {"forward": False, "reverse": True}


Read = Command | Beat | LineStop | Result


@dataclass(frozen=True, slots=True)
class _Letter:
    """A message that is being read: the last level of its topic, the drive's model, the command so far."""

    name: str
    message: Message
    moment: Moment
    model: Model | None
    blank: Command


def read(
    message: Message, levels: Sequence[str], moment: Moment, model: Model | None = None, origin: Source = ANYBODY
) -> Read | None:
    """Return what a message asks for, its refusal, or None where it is neither a command nor a sign of life.

    `levels` are those of its topic below `<base>/<gateway>/`; `model` is that of the drive, where there is one;
    `origin` is who asks where the message gives no name: anybody by that broker.
    """
    take: Callable[[_Letter, Any], Read]
    match levels:
        case (drive, "heartbeat"):
            return _beat(drive, message, moment, origin)
        case (drive, "command"):
            take = _command
        case ("line", line, "command"):
            drive, take = f"{LINE}/{line}", _line_stop
        case (drive, "set", _):
            take = _setting
        case _:
            return None
    blank = Command(drive, Verb.SET, origin, moment.now, moment.now + moment.good_for)
    document: dict[str, Any] | str = ""
    letter = _Letter(levels[-1], message, moment, model, blank)
    try:
        document = exact.document(message.payload)
        if message.is_retained:
            raise NotTaken(Reason.RETAINED, KEPT)
        return take(letter, document)
    except NotExact as error:
        if not message.is_retained and levels[-1] == COMMAND and (stop := stop_in(message.payload)) is not None:
            return take(letter, stop)
        reason, text = (Reason.RETAINED, KEPT) if message.is_retained else (Reason.MALFORMED, str(error))
    except NotTaken as error:
        reason, text = error.reason, str(error)
    return Result(_named(blank, _table(document)), Status.REFUSED, reason, text)


def _beat(drive: str, message: Message, moment: Moment, origin: Source) -> Beat | None:
    """Read a heartbeat: any payload, or JSON with `source` where its owner has a name, and `issued`."""
    if message.is_retained or message.is_early or len(message.payload) > exact.LARGEST:
        return None
    name = ""
    if message.payload.lstrip().startswith(b"{"):
        try:
            table = _table(exact.document(message.payload))
            _check_age(table, moment)
            name = exact.name(table.get("source", ""), "source")
        except (NotExact, NotTaken):
            return None
    return Beat(drive, replace(origin, name=name), message.payload)


def _table(document: dict[str, Any] | str) -> dict[str, Any]:
    return {"command": document} if isinstance(document, str) else document


def _named(blank: Command, table: Mapping[str, Any]) -> Command:
    """Return the command with what of its verb, id and source can be told: enough for a stop, and for an answer."""
    found: dict[str, Any] = {}
    for key, read_one in (("id", exact.identity), ("source", exact.name)):
        try:
            name = read_one(table.get(key, ""), key)
        except NotExact:
            continue
        found[key] = replace(blank.source, name=name) if key == "source" else name
    verb = verb_of(table.get("command"))
    return replace(blank, verb=verb or blank.verb, **found)


def _command(letter: _Letter, document: dict[str, Any] | str) -> Command:
    table = _table(document)
    word = table.get("command")
    verb = verb_of(word)
    if verb is None:
        raise NotExact(f"command {exact.shown(word)} is not known; known: {', '.join(Verb)}")
    if verb.is_stopping:
        return _named(letter.blank, table)
    exact.known_keys(table, KEYS[verb])
    command = replace(_common(letter, table), verb=verb, is_reverse=_is_reverse(table))
    if verb is Verb.WORDS:
        return replace(command, **_words(letter, table))
    if verb is Verb.SET:
        command = replace(command, name=_register(letter, exact.name(table.get("name", ""), "name")))
    return replace(command, **_value(verb, table))


def _line_stop(letter: _Letter, document: dict[str, Any] | str) -> LineStop:
    table = _table(document)
    command = _named(letter.blank, table)
    if not command.verb.is_stopping:
        known = ", ".join(verb for verb in Verb if verb.is_stopping)
        raise NotExact(f"command {exact.shown(table.get('command'))}: a line takes only {known}")
    return LineStop(command.drive.removeprefix(f"{LINE}/"), command)


def _setting(letter: _Letter, document: dict[str, Any] | str) -> Command:
    """Read a value to be set: plain, or JSON with `value`, or with the value's own name as the key."""
    table = {"value": document} if isinstance(document, str) else document
    name = letter.name
    verb = SHORT_NAMES.get(name, Verb.SET)
    named = name if verb is not Verb.SET else _register(letter, name)
    own = tuple(dict.fromkeys(key for key in (name, named, *NUMBERS[verb]) if key not in SET_KEYS))
    exact.known_keys(table, (*SET_KEYS, *own))
    return replace(_common(letter, table), verb=verb, name=named, **_value(verb, table, own))


def _common(letter: _Letter, table: Mapping[str, Any]) -> Command:
    """Read who asks, the id, and until when it is good."""
    source = exact.name(table.get("source", ""), "source")
    known = exact.identity(table.get("id", ""), "id")
    if letter.message.is_early:
        raise NotTaken(Reason.EXPIRED, "it came before the subscription was confirmed, perhaps from an earlier one")
    if letter.message.is_repeated and not known:
        raise NotTaken(Reason.EXPIRED, "it was delivered again, and has no id to tell whether it was done before")
    deadline = _deadline(table, letter.message.expiry, letter.moment)
    return replace(letter.blank, source=replace(letter.blank.source, name=source), id=known, deadline=deadline)


def _deadline(table: Mapping[str, Any], expiry: int | None, moment: Moment) -> float:
    """Return until when a command may be carried out, monotonic; NotTaken where that is over (SAFETY.md H02)."""
    _check_age(table, moment)
    left = [moment.good_for]
    if expiry is not None:
        left.append(expiry)
    if "expires" in table:
        left.append(exact.moment(table["expires"], "expires") - moment.wall)
    if min(left) <= 0:
        raise NotTaken(Reason.EXPIRED, f"it expired {abs(min(left)):.1f} s before it came")
    return moment.now + min(left)


def _check_age(table: Mapping[str, Any], moment: Moment) -> None:
    if "issued" not in table:
        return
    age = moment.wall - exact.moment(table["issued"], "issued")
    if age > moment.max_age:
        raise NotTaken(Reason.EXPIRED, f"issued {age:.1f} s ago; at most {moment.max_age:g} s (mqtt.command_max_age)")
    if age < -moment.max_age:
        text = f"issued {-age:.1f} s in the future: set the clock of the controller, or of the gateway"
        raise NotTaken(Reason.EXPIRED, text)


def _is_reverse(table: Mapping[str, Any]) -> bool:
    """Read `direction`, or `reverse`, which must not contradict each other."""
    said = set()
    if "direction" in table:
        direction = table["direction"]
        is_reverse = DIRECTIONS.get(direction.strip().lower()) if isinstance(direction, str) else None
        if is_reverse is None:
            raise NotExact(f"direction {exact.shown(direction)}: forward or reverse")
        said.add(is_reverse)
    if "reverse" in table:
        said.add(exact.boolean(table["reverse"], "reverse"))
    if len(said) > 1:
        raise NotExact("direction and reverse contradict each other")
    return True in said


def _value(verb: Verb, table: Mapping[str, Any], own: tuple[str, ...] = ()) -> dict[str, Any]:
    """Read a command's number, or the words of a code or of bits; `own` are more keys that it may stand at."""
    keys = tuple(dict.fromkeys((*own, *NUMBERS.get(verb, ()))))
    given = [key for key in keys if key in table]
    if len(given) > 1:
        raise NotExact(f"only one of {', '.join(given)}")
    if not given:
        if keys and verb is not Verb.RUN:
            raise NotExact(f"{verb} needs {' or '.join(keys)}")
        return {}
    value = table[given[0]]
    found = exact.number_or_words(value) if verb in WORDED else exact.number(value)
    return {"value": found} if isinstance(found, Decimal) else {"text": found}


def _words(letter: _Letter, table: Mapping[str, Any]) -> dict[str, Any]:
    """Read raw words from a register on, which is given by its name, number or name on the panel."""
    text = exact.name(table.get("address", ""), "address")
    register = notation.find(letter.model, text) if letter.model is not None else None
    if register is None and letter.model is not None:
        raise NotTaken(Reason.NOT_IN_MODEL, f"{letter.model.name} has no register {exact.shown(text)}")
    address = 0 if register is None else register.address
    return {"address": address, "words": exact.words(table.get("words"), MOST_WORDS)}


def _register(letter: _Letter, text: str) -> str:
    """Return the name of the register that is given by its name, number or name on the panel."""
    if letter.model is None:
        return text
    register = notation.find(letter.model, text)
    if register is None:
        raise NotTaken(Reason.NOT_IN_MODEL, f"{letter.model.name} has no register {exact.shown(text)}")
    return register.name
