"""One register of a drive model: what a communication number means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from enum import Enum

from gateway.drives.scaling import OutOfRange, Scaling


class Kind(Enum):
    """What a register is for.

    COMMAND is written to act (FAxx). MONITOR is a quantity, measured or counted. STATUS is what the drive is
    or does, in bits or codes. TRIP_HELD follows the drive as well, and keeps what was when the drive tripped
    (FExx). PARAMETER is a setting (0000-0999).
    """

    COMMAND = "command"
    MONITOR = "monitor"
    TRIP_HELD = "trip_held"
    PARAMETER = "parameter"
    STATUS = "status"


class Storage(Enum):
    """Where a write goes: RAM only, RAM and EEPROM (about 10,000 writes), or nowhere (read only)."""

    RAM = "ram"
    EEPROM = "eeprom"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class Enumeration:
    """A named set of codes: code -> short name, code -> text.

    It holds the codes that the manual names, and need not be complete: a drive may know more.
    """

    name: str
    names: Mapping[int, str]
    texts: Mapping[int, str]


@dataclass(frozen=True, slots=True)
class Derived:
    """A value computed from a percentage register and its base: `value x base / 100`."""

    name: str
    of: str
    base: str
    unit: str
    digits: int = 2


@dataclass(frozen=True, slots=True)
class Register:
    """A communication number of a model, with all that the manual says of it.

    `minimum` and `maximum` bound the raw value (signed where the register is); `mask` keeps the defined
    bits: undefined ones are unstable and are no data. `source` is the manual's section.
    """

    name: str
    address: int
    kind: Kind
    source: str
    title: str = ""
    unit: str = ""
    scaling: Scaling = field(default_factory=Scaling)
    minimum: int | None = None
    maximum: int | None = None
    minimum_from: str = ""
    maximum_from: str = ""
    is_writable: bool = False
    storage: Storage = Storage.NONE
    writable_while_running: bool = True
    takes_effect_after_reset: bool = False
    initial: int = 0
    mask: int = 0xFFFF
    bits: Mapping[int, str] = field(default_factory=dict)
    enumeration: Enumeration | None = None

    def decode(self, word: int) -> Decimal:
        """Return the engineering value of a raw word, undefined bits removed."""
        return self.scaling.decode(word & self.mask)

    def encode(self, value: Decimal) -> int:
        """Return the raw word of an engineering value; OutOfRange where the register does not take it."""
        word = self.scaling.encode(value)
        raw, digits = self.scaling.raw(word), self.scaling.digits
        low, high = self.scaling.limits
        low = low if self.minimum is None else self.minimum
        high = high if self.maximum is None else self.maximum
        if not low <= raw <= high:
            scale = self.scaling.scale
            raise OutOfRange(f"{value} is outside {low * scale:.{digits}f} to {high * scale:.{digits}f}")
        if word & ~self.mask:
            raise OutOfRange(f"{word:04X}H sets undefined bits: {word & ~self.mask:04X}H")
        return word

    def format(self, word: int) -> str:
        """Return the engineering value as text with the scale's decimals: 6000 at 0.01 is "60.00"."""
        return self.scaling.format(word & self.mask)

    def text(self, word: int) -> str | None:
        """Say a bit field's set bits, or a code's name and text, in words; None for a plain number."""
        if self.bits:
            return ", ".join(name for bit, name in self.bits.items() if word >> bit & 1)
        if self.enumeration is None:
            return None
        if word not in self.enumeration.texts:
            return f"unknown code {word}"
        name, text = self.enumeration.names[word], self.enumeration.texts[word]
        return f"{name}: {text}" if name else text
