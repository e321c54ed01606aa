"""The quantities in the file of a simulated line and in requests to it, and what is wrong with one, in words."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, PlainSerializer, StringConstraints, ValidationError

from gateway.config import Duration, seconds
from gateway.sim.faults import Range

LARGEST_NUMBER = 247  # F802
LARGEST = 65_535  # seconds, bytes or bits of a fault
DRIVE_NAME = r"^[A-Za-z][A-Za-z0-9_.-]*$"


def _text(value: float) -> str:
    return f"{value:.9f}s"


def _texts(both: Range) -> list[str]:
    return [_text(value) for value in both]


def _span_range(value: object) -> Range:
    """Read a duration or two of them; ValueError says the form."""
    both = value if isinstance(value, list | tuple) else [value, value]
    if len(both) != 2:
        raise ValueError('a duration is wanted, or two between which one is drawn: ["1s", "3s"]')
    low, high = (seconds(item) for item in both)
    if low > high:
        raise ValueError("of two durations the shorter one stands first")
    return low, high


def _amount(value: object) -> float | Range:
    """Read a number or two of them; ValueError says the form."""
    both = value if isinstance(value, list | tuple) else [value]
    numbers = [float(item) for item in both if isinstance(item, int | float) and not isinstance(item, bool)]
    if len(numbers) != len(both) or len(both) not in (1, 2) or not all(0 <= number <= LARGEST for number in numbers):
        raise ValueError(f"a number from 0 to {LARGEST} is wanted, or two between which one is drawn: [1, 8]")
    if numbers[0] > numbers[-1]:
        raise ValueError("of two numbers the smaller one stands first")
    return (numbers[0], numbers[1]) if isinstance(value, list | tuple) and len(numbers) == 2 else numbers[0]


def _drive_key(value: object) -> int | str:
    """Read whom something is done to; ValueError says what would be right."""
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= LARGEST_NUMBER:
        return value
    if isinstance(value, str) and re.fullmatch(DRIVE_NAME, value):
        return value
    raise ValueError(f"a drive's number (0 to {LARGEST_NUMBER}) is wanted, or the name that the file gives it")


Span = Annotated[Duration, PlainSerializer(_text, when_used="json")]
SpanRange = Annotated[Range, BeforeValidator(_span_range), PlainSerializer(_texts, when_used="json")]
Amount = Annotated[float | Range, BeforeValidator(_amount)]
Number = Annotated[int, Field(ge=0, le=LARGEST_NUMBER)]
DriveKey = Annotated[int | str, BeforeValidator(_drive_key)]  # the number as it is at the moment, or the name
DriveName = Annotated[str, StringConstraints(pattern=DRIVE_NAME)]
Hertz = Annotated[float, Field(ge=0, le=500)]
Word = Annotated[int, Field(ge=0, le=0xFFFF)]


def is_whole(amount: float | Range | None) -> bool:
    """Say whether an amount counts things: it has no fractions."""
    numbers = amount if isinstance(amount, tuple) else (amount,)
    return all(number is None or float(number).is_integer() for number in numbers)


# -- what is wrong ----------------------------------------------------------------------------------------------

UNSEEN = ("when", "doing")  # parts of an event that the file does not name


def problems(error: ValidationError, *, of_request: bool = False) -> Iterator[str]:
    """Say of each wrong key where it stands, what would be right and what was given; once for each key.

    The paths of a request begin with what it does, which is no key.
    """
    seen = set()
    for item in error.errors(include_url=False):
        key = _key(item["loc"][of_request:])
        if key not in seen:
            seen.add(key)
            yield _problem(key, item)


def _key(path: Sequence[int | str]) -> str:
    """Write a path as the file would: event[2].code; the tag of an alternative is no part of it."""
    parts = ""
    for before, part in zip(("", *path), path, strict=False):
        if (isinstance(before, int) and part in UNSEEN) or before == "doing":
            continue
        parts += f"[{part}]" if isinstance(part, int) else f".{part}"
    return parts.lstrip(".")


def _problem(key: str, item: Mapping[str, Any]) -> str:
    context = item.get("ctx", {})
    if item["type"] == "extra_forbidden":
        return f"{key}: unknown key"
    if item["type"] == "union_tag_not_found":
        return f"{key}.do: missing: say what is to be done".lstrip(".")
    if item["type"] == "union_tag_invalid":
        known = str(context["expected_tags"]).replace("'", "")
        return f"{key}.do: no such doing {context['tag']!r}; known: {known}".lstrip(".")
    reason = item["msg"].removeprefix("Value error, ")
    is_of_a_table = item["type"] == "missing" or isinstance(item["input"], Mapping)
    given = "" if is_of_a_table else f" (given: {item['input']!r:.60})"
    return f"{key}: {reason}{given}".removeprefix(": ")
