"""The forms in which a user-defined map shows numbers: 16 and 32 bits, in either word order. Pure."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import ROUND_HALF_UP, Decimal

Encode = Callable[[Decimal], bytes | None]
"""Turns an engineering value into registers as they stand on the wire; None where it does not fit."""


@dataclass(frozen=True, slots=True)
class Form:
    """How a number stands in `words` registers; whole ones lie between `low` and `high`."""

    name: str
    type_name: str  # as tag lists spell it
    words: int
    packing: struct.Struct
    low: int | None = None
    high: int | None = None

    def holds(self, number: Decimal) -> bool:
        """Say whether a number fits; every one fits a floating form, rounded to its digits."""
        if self.low is None or self.high is None:
            return True
        return self.low <= rounded(number) <= self.high


WORD = "word"
FORMS: Mapping[str, Form] = {
    WORD: Form(WORD, "uint16", 1, struct.Struct(">H"), 0, 2**16 - 1),  # the drive's own, neither scaled nor rounded
    "signed": Form("signed", "int16", 1, struct.Struct(">h"), -(2**15), 2**15 - 1),
    "int32": Form("int32", "int32", 2, struct.Struct(">i"), -(2**31), 2**31 - 1),
    "uint32": Form("uint32", "uint32", 2, struct.Struct(">I"), 0, 2**32 - 1),
    "float32": Form("float32", "float32", 2, struct.Struct(">f")),
}


def rounded(number: Decimal) -> int:
    """Return the nearest whole number; halves go away from zero."""
    return int(number.to_integral_value(ROUND_HALF_UP))


def encoder(form: Form, scale: Decimal, order: str) -> Encode:
    """Return what turns a value into registers: times `scale`; the high word first where `order` is big."""

    def encode(value: Decimal) -> bytes | None:
        number = value * scale
        if form.low is None:
            packed = form.packing.pack(float(number))
        elif form.holds(number):
            packed = form.packing.pack(rounded(number))
        else:
            return None
        return packed[2:] + packed[:2] if is_swapped else packed

    is_swapped = order == "little" and form.words > 1
    return encode
