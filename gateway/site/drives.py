"""Finds what is wrong in fact with one drive: its number, its model, what is read, and its control. Pure."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any

from gateway.config import DriveSection
from gateway.drives.catalogue import Catalogue
from gateway.drives.model import Model
from gateway.protocol.registry import PROTOCOLS
from gateway.site.once import Once, only_once

COMMAND_BITS = frozenset(  # of FA00, without which a drive cannot be commanded
    ("run", "coast", "emergency_stop", "fault_reset", "frequency_priority", "command_priority")
)


def contradictions(
    label: str, line: Mapping[str, Any], drive: DriveSection, models: Catalogue, once: Once
) -> Iterator[str]:
    """Yield what is wrong with a drive whose form is right, a line each; `label` is its key with its name."""
    yield from only_once(once, "drive name", drive.name, f"{label}.name")
    unit = drive.number if drive.unit is None else drive.unit
    hint = "" if drive.unit else "; give this drive a unit of its own, or unit = 0: by unit 255 only"
    if unit:
        yield from only_once(once, "MODBUS-TCP unit", unit, f"{label}.unit", hint)
    yield from _wrong_number(label, drive)
    family = "MODBUS-RTU" if drive.protocol == "modbus-rtu" else "TOSHIBA"
    yield from only_once(once, f"{family} number on line {line.get('name')}", drive.number, f"{label}.number")
    model = models.get(drive.model)
    if model is None:
        yield f"{label}.model: no model {drive.model!r}; known: {', '.join(sorted(models))}"
        return
    yield from _unknown_values(label, drive, model)
    yield from _wrong_control(label, drive, model)


def _wrong_number(label: str, drive: DriveSection) -> Iterator[str]:
    """Find a number that the drive's protocol or the MODBUS-TCP server cannot address."""
    numbers = PROTOCOLS[drive.protocol].forms.numbers
    if drive.number not in numbers:
        known = f"{numbers.start} to {numbers.stop - 1}"
        yield f"{label}.number: {drive.protocol} has the numbers {known} (given: {drive.number})"
    elif drive.number == 0 and drive.unit is None:
        yield f"{label}.unit: number 0 is no MODBUS-TCP unit id; give this drive one of 1 to 247, or 0 for none"


def _unknown_values(label: str, drive: DriveSection, model: Model) -> Iterator[str]:
    derived = {d.name for d in model.derived}
    names = [(f"poll[{g}].values", name) for g, poll in enumerate(drive.poll) for name in poll.values]
    if not drive.poll and not model.profile:
        yield f"{label}.poll: {model.name} has no default profile: say what to read"
    for key, name in names + [("deadband", name) for name in drive.deadband]:
        if name in model.registers or name in derived:
            continue
        near = difflib.get_close_matches(name, [*model.registers, *derived], 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        yield f"{label}.{key}: {model.name} has no value {name!r}{hint}"


def _wrong_control(label: str, drive: DriveSection, model: Model) -> Iterator[str]:
    """Find a control that nobody could use, that the model has no registers for, or that is not what it says."""
    if drive.control == "off":
        return
    command = model.registers.get("command")
    if command is None:
        yield f"{label}.control: {model.name} has no register 'command' (FA00): add it in a catalogue file"
    elif missing := sorted(COMMAND_BITS - set(command.bits.values())):
        yield f"{label}.control: register 'command' of {model.name} has no bit {', '.join(missing)}"
    elif model.cautions.unanswered.get("command") != "fault_reset":
        yield f'{label}.control: {model.name}: [cautions] has to say unanswered = {{ command = "fault_reset" }}'
    connector = model.connector()
    roles = connector.parameters if connector else {}
    asked = {
        "timeout": ("communication_timeout", drive.communication_timeout),
        "timeout_action": ("timeout_action", drive.timeout_action),
        "timeout_detection": ("timeout_detection", drive.timeout_detection),
    }
    for role, (key, value) in asked.items():
        if value is not None and roles.get(role) not in model.registers:
            yield f"{label}.{key}: {model.name} has no such parameter in its catalogue"
    if drive.on_loss == "quiesce" and drive.timeout_action in (None, "alarm"):
        yield f'{label}.on_loss: "quiesce" leaves the stop to F804: set timeout_action to "stop" or "coast"'
