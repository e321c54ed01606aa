"""Finds what is wrong in fact with the user-defined map of MODBUS-TCP: points, types, units, addresses."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import ValidationError

from gateway.config import DriveSection, MapSection, ModbusTcpSection
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.wire_forms import FORMS, WORD, rounded

UNITS = range(1, 248)  # that every client can ask for; libmodbus takes none of 248 to 254
GATEWAY_UNIT = 255
FREE_AT_GATEWAY = range(0x6000, 0x8000)  # of unit 255: between the compact map and the command mirror
ADDRESSES = 0x10000

Used = Sequence[tuple[str, DriveSection, Model]]  # key, drive and model of each drive that is right in itself


@dataclass(slots=True)
class _Found:
    """What the entries have been found to take so far."""

    units: Mapping[int, str]  # of drives, by their names
    registers: dict[tuple[int, int], str] = field(default_factory=dict)


def contradictions(table: Mapping[str, Any], used: Used) -> Iterator[str]:
    """Yield what is wrong with `modbus_tcp.map`, a line each; entries whose form is wrong are listed already."""
    section = table.get("modbus_tcp")
    entries = section.get("map") if isinstance(section, dict) else None
    if not isinstance(section, dict) or not isinstance(entries, list):
        return
    default = section.get("map_unit", ModbusTcpSection.model_fields["map_unit"].default)
    units = {drive.number if drive.unit is None else drive.unit: drive.name for _, drive, _ in used}
    found = _Found({unit: name for unit, name in units.items() if unit})
    named = set(_drive_names(table))
    for i, given in enumerate(entries):
        try:
            entry = MapSection.model_validate(given)
        except ValidationError:
            continue
        key = f"modbus_tcp.map[{i}]"
        yield from _wrong_point(key, entry, used, named)
        unit = default if entry.unit is None else entry.unit
        if isinstance(unit, int):
            yield from _wrong_place(key, entry, unit, found)


def _drive_names(table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the names of all drives, also of those that are not right in themselves."""
    lines = table.get("line")
    for line in lines if isinstance(lines, list) else ():
        drives = line.get("drive") if isinstance(line, dict) else None
        for drive in drives if isinstance(drives, list) else ():
            if isinstance(drive, dict) and isinstance(drive.get("name"), str):
                yield drive["name"]


def _wrong_point(key: str, entry: MapSection, used: Used, named: set[str]) -> Iterator[str]:
    """Find a point that no drive has or that is not read, and a type that it never fits."""
    drive = next(((section, model) for _, section, model in used if section.name == entry.drive), None)
    if drive is None:
        if entry.drive not in named:
            hint = _near(entry.drive, named) or f"; known: {', '.join(sorted(named))}"
            yield f"{key}.point: no drive {entry.drive!r}{hint}"
        return
    section, model = drive
    sources = {derived.name: derived.of for derived in model.derived}
    if entry.value not in model.registers and entry.value not in sources:
        hint = _near(entry.value, {*model.registers, *sources})
        yield f"{key}.point: {model.name} has no value {entry.value!r}{hint}"
        return
    polls = [tuple(poll.values) for poll in section.poll] or [values for values, _ in model.profile]
    read = {sources.get(name, name) for values in polls for name in values}
    source = sources.get(entry.value, entry.value)
    if source not in read:
        yield f"{key}.point: {entry.value!r} is not read from {section.name}: add it to a poll of that drive"
    if source in model.registers:
        is_derived = entry.value in sources
        yield from _unfit_type(key, entry, model.registers[source], is_derived=is_derived)


def _unfit_type(key: str, entry: MapSection, register: Register, *, is_derived: bool) -> Iterator[str]:
    """Find a type that cannot show the value: any other number than 0 is too large or too small for it."""
    form = FORMS[entry.type]
    if is_derived and entry.type == WORD:
        yield f"{key}.type: {entry.value!r} is computed and has no word: take signed, int32, uint32 or float32"
    if entry.type == "uint32" and register.scaling.signed:
        yield f"{key}.type: {entry.value!r} may be negative: take int32"
    if is_derived or entry.type == WORD or form.high is None:
        return
    step = register.scaling.scale * entry.factor
    low, high = register.scaling.limits
    if step > form.high:
        yield f"{key}.scale: {entry.value!r} times {entry.scale:g} fits {entry.type} as 0 only: take a smaller scale"
    elif rounded(max(-low, high) * step) == 0:
        yield f"{key}.scale: {entry.value!r} times {entry.scale:g} is always 0: take a larger scale, or float32"


def _wrong_place(key: str, entry: MapSection, unit: int, found: _Found) -> Iterator[str]:
    """Find a unit that is a drive's, and registers that are not free."""
    label = f"{key} ({entry.point})"
    taken = range(entry.address, entry.address + FORMS[entry.type].words)
    if unit in found.units:
        where = f"{key}.unit" if entry.unit is not None else "modbus_tcp.map_unit"
        free = max(set(UNITS) - set(found.units), default=GATEWAY_UNIT)
        whose = f"unit {unit} is that of drive {found.units[unit]!r}"
        yield f"{where}: {whose}; give {label} a unit of its own, such as {free}"
    elif taken.stop > ADDRESSES:
        yield f"{key}.address: {entry.type} takes two registers, and FFFFH is the last one: FFFEH at the most"
    elif unit == GATEWAY_UNIT and not set(taken) <= set(FREE_AT_GATEWAY):
        free_there = f"{FREE_AT_GATEWAY.start:04X}H to {FREE_AT_GATEWAY.stop - 1:04X}H"
        yield (
            f"{key}.address: {taken[-1]:04X}H of unit 255 is kept for the gateway's own registers;"
            f" {free_there} are free there, or give the map another unit"
        )
    else:
        yield from _overlaps(key, label, unit, taken, found)


def _overlaps(key: str, label: str, unit: int, taken: range, found: _Found) -> Iterator[str]:
    """Find entries that take one of these registers already, and take the others."""
    others = {found.registers[unit, at]: at for at in reversed(taken) if (unit, at) in found.registers}
    for other, at in others.items():
        yield f"{key}.address: {label} and {other} both take {at:04X}H of unit {unit}: give one another address"
    for at in taken:
        found.registers.setdefault((unit, at), label)


def _near(name: str, known: set[str]) -> str:
    near = difflib.get_close_matches(name, sorted(known), 1)
    return f"; did you mean {near[0]!r}?" if near else ""
