"""Reads registers by hand: raw, scaled and in words; derived values too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal

from gateway.bus.session import Session
from gateway.drives.model import Model
from gateway.drives.notation import address_of, find, found
from gateway.drives.register import Derived, Kind, Register
from gateway.errors import Refused
from gateway.site import Drive

Wanted = Register | Derived


@dataclass(frozen=True, slots=True)
class Reading:
    """A value as it is shown: its number and raw word where it has them. `problem` is why it could not be read."""

    drive: str
    name: str
    address: int | None = None
    word: int | None = None
    value: str = ""
    unit: str = ""
    text: str | None = None
    problem: str = ""


def wanted(model: Model, text: str) -> Wanted:
    """Return what a name or number stands for; a number that the catalogue does not know is read as it is."""
    derived = next((derived for derived in model.derived if derived.name == text), None)
    if derived is not None:
        return derived
    address = address_of(text)
    if find(model, text) is None and address is not None:
        return Register(name="", address=address, kind=Kind.PARAMETER, source="")
    return found(model, text)


async def read(session: Session, drive: Drive, asked: Sequence[Wanted]) -> list[Reading]:
    """Read values one after another; a refusal is noted with its value, silence ends it all (NoReply)."""
    return [await _read(session, drive, item) for item in asked]


async def _read(session: Session, drive: Drive, item: Wanted) -> Reading:
    try:
        if isinstance(item, Derived):
            return await _derived(session, drive, item)
        word = await session.read(drive, item)
    except Refused as refused:
        address = item.address if isinstance(item, Register) else None
        return Reading(drive.name, item.name, address, problem=str(refused))
    return reading(drive, item, word)


def reading(drive: Drive, register: Register, word: int) -> Reading:
    """Put a word into the register's words."""
    text = register.text(word)
    value = "" if register.bits else register.format(word)
    return Reading(drive.name, register.name, register.address, word, value, register.unit, text)


async def _derived(session: Session, drive: Drive, derived: Derived) -> Reading:
    """Compute a derived value from the percentage and the rating that it is a percentage of."""
    of, base = (drive.model.registers[name] for name in (derived.of, derived.base))
    value = of.decode(await session.read(drive, of)) * base.decode(await session.read(drive, base)) / 100
    shown = value.quantize(Decimal(1).scaleb(-derived.digits))
    return Reading(drive.name, derived.name, value=f"{shown:f}", unit=derived.unit)


def in_words(register: Register, word: int | None) -> str:
    """Return a value for a sentence: "30.00 Hz (0BB8H)", "run, command_priority (8400H)", "?"."""
    if word is None:
        return "?"
    text = register.text(word)
    if text is None:
        text = f"{register.format(word)} {register.unit}".strip()
    elif register.bits:
        text = text or "none"
    return f"{text} ({word:04X}H)"


def as_lines(readings: Sequence[Reading]) -> list[str]:
    """Lay readings out, a line each, in columns; the drive's name in front where there are several."""
    rows = [_row(item) for item in readings]
    if len({item.drive for item in readings}) == 1:
        rows = [row[1:] for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))] if rows else []
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _row(item: Reading) -> list[str]:
    number = "" if item.address is None else f"{item.address:04X}"
    raw = ["", ""] if item.word is None else [f"{item.word:04X}H", str(item.word)]
    if item.problem:
        return [item.drive, item.name, number, *raw, item.problem]
    value = f"{item.value} {item.unit}".strip() if item.text is None else item.text or "none"
    return [item.drive, item.name, number, *raw, value]


def as_objects(readings: Sequence[Reading]) -> list[dict[str, object]]:
    """Return readings for JSON: without the keys that a value has not got."""
    return [_object(item) for item in readings]


def _object(item: Reading) -> dict[str, object]:
    pairs: dict[str, object | None] = {
        "drive": item.drive,
        "name": item.name or None,
        "number": None if item.address is None else f"{item.address:04X}",
        "raw": item.word,
        "value": float(item.value) if item.value and item.text is None else None,
        "unit": item.unit or None,
        "text": item.text,
        "problem": item.problem or None,
    }
    return {key: value for key, value in pairs.items() if value is not None}
