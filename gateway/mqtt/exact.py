"""Reads what others write, exactly or not at all: text, JSON, numbers, times, names.

Nothing is guessed: no NaN, no number beyond what a register could hold, no key twice, no other encoding than UTF-8.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from decimal import Decimal, InvalidOperation
from typing import Any

LARGEST = 4096  # bytes of a payload; no command needs more
LONGEST_NAME = 128  # characters of an id or a source
NUMBER = re.compile(r"[+-]?\d{1,40}(\.\d{1,40})?([eE][+-]?\d{1,2})?", re.ASCII)
WHOLE = re.compile(r"-?\d{1,40}", re.ASCII)
MOMENT = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d(\.\d{1,9})?)?(Z|[+-]\d\d:\d\d)?", re.ASCII)
WORD = re.compile(r"0[xX]([0-9A-Fa-f]{1,4})|([0-9A-Fa-f]{1,4})[Hh]", re.ASCII)
MILLISECONDS_FROM = 100_000_000_000  # as seconds that is the year 5138: clocks of JavaScript count milliseconds
LATEST = 10**15


class NotExact(Exception):
    """A text that is not what was wanted; the message says what would be right."""


def text(payload: bytes) -> str:
    """Return a payload as text; NotExact where it is too long or not UTF-8."""
    if len(payload) > LARGEST:
        raise NotExact(f"{len(payload)} bytes; at most {LARGEST}")
    try:
        return payload.decode()
    except UnicodeDecodeError as error:
        raise NotExact(f"byte {error.start} is not UTF-8") from None


def document(payload: bytes) -> dict[str, Any] | str:
    """Return a JSON object with exact numbers, or plain text without the space around it, quoted or not."""
    plain = text(payload).strip()
    if not plain.startswith(("{", "[", '"')):
        return plain
    try:
        found = json.loads(
            plain,
            parse_float=_number,
            parse_int=_number,
            parse_constant=_constant,
            object_pairs_hook=_table,
        )
    except (ValueError, RecursionError) as error:
        reason = "nested too deep" if isinstance(error, RecursionError) else str(error)
        raise NotExact(f"no JSON: {reason}") from None
    if isinstance(found, str):
        return found.strip()
    if not isinstance(found, dict):
        raise NotExact('a JSON object is wanted: {"command": "stop"}')
    return found


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) != len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise NotExact(f"key {shown(twice)} stands there twice")
    return table


def _constant(name: str) -> Any:
    raise NotExact(f"{name} is no number")


def _number(token: str) -> Decimal:
    if NUMBER.fullmatch(token) is None:
        raise NotExact(f"{shown(token)} is no number that anything here could hold")
    return Decimal(token)


def number(value: object) -> Decimal:
    """Return a number, or one in a text, exactly as it was written."""
    if isinstance(value, Decimal):
        return value
    if isinstance(value, str):
        plain = value.strip()
        if NUMBER.fullmatch(plain):
            return Decimal(plain)
    raise NotExact(f"{shown(value)} is no number: 30.0")


def number_or_words(value: object) -> Decimal | str:
    """Return a number, or the words that name a code or bits; a number in an odd spelling is neither."""
    if not isinstance(value, str):
        return number(value)
    plain = value.strip()
    if NUMBER.fullmatch(plain):
        return Decimal(plain)
    if not plain or len(plain) > LONGEST_NAME or not plain.isprintable():
        raise NotExact(f"{shown(value)} is no value: a number, a code, or bits by name are wanted")
    try:
        Decimal(plain)
    except InvalidOperation:
        return plain
    raise NotExact(f"{shown(value)} is no number: 30.0")


def words(value: object, most: int) -> tuple[int, ...]:
    """Return raw words: a list of whole numbers from 0 to 65535, or of hexadecimal texts such as "C400H"."""
    if not isinstance(value, list) or not 1 <= len(value) <= most:
        raise NotExact(f"words is a list of 1 to {most} words: [50176] or [\"C400H\"]")
    return tuple(_word(each) for each in value)


def _word(value: object) -> int:
    if isinstance(value, str) and (match := WORD.fullmatch(value)):
        return int(match[1] or match[2], 16)
    if isinstance(value, Decimal) and WHOLE.fullmatch(str(value)) and 0 <= value <= 0xFFFF:
        return int(value)
    raise NotExact(f"{shown(value)} is no word: a whole number from 0 to 65535, or \"C400H\"")


def name(value: object, what: str) -> str:
    """Return an id or a name: a short printable text, or a whole number."""
    if isinstance(value, Decimal) and WHOLE.fullmatch(str(value)):
        return str(value)
    if isinstance(value, str) and len(value) <= LONGEST_NAME and value.isprintable():
        return value
    raise NotExact(f"{what} {shown(value)}: a printable text of at most {LONGEST_NAME} characters is wanted")


def identity(value: object, what: str) -> str:
    """Return an id: a name, any number as it was written, or "" for null."""
    if value is None:
        return ""
    return str(value) if isinstance(value, Decimal) else name(value, what)


def moment(value: object, what: str) -> float:
    """Return UTC seconds since 1970 from ISO 8601 (UTC where it names no offset), from seconds or milliseconds."""
    if isinstance(value, Decimal) and 0 <= value < LATEST:
        return float(value if value < MILLISECONDS_FROM else value / 1000)
    if isinstance(value, str) and MOMENT.fullmatch(value):
        try:
            found = datetime.fromisoformat(value)
        except ValueError:
            found = None
        if found is not None:
            return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()
    raise NotExact(f'{what} {shown(value)} is no time: "2026-03-01T12:00:00Z", or seconds since 1970')


def boolean(value: object, what: str) -> bool:
    """Return true or false."""
    if isinstance(value, bool):
        return value
    raise NotExact(f"{what} {shown(value)}: true or false is wanted")


def known_keys(table: Mapping[str, Any], known: tuple[str, ...]) -> None:
    """Refuse keys that mean nothing here."""
    if unknown := sorted(set(table) - set(known)):
        raise NotExact(f"unknown key {shown(unknown[0])}; known: {', '.join(known)}")


def shown(value: object) -> str:
    """Return a value as it can be repeated to people and in logs: short, in printable ASCII, spelt as in JSON."""
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "an object"
    found = str(value) if isinstance(value, Decimal) else json.dumps(value)
    return found if len(found) <= 60 else f"{found[:57]}..."
