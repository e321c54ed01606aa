"""One register of a drive model: what a communication number means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from enum import Enum

from gateway.drives.scaling import Scaling


class Kind(Enum):
    """Which table of the manual a register stands in."""

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
    """A named set of codes: code -> (short name, text)."""

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

    def format(self, word: int) -> str:
        """Return the engineering value as text with the scale's decimals: 6000 at 0.01 is "60.00"."""
        return f"{self.decode(word):.{self.scaling.digits}f}"

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
