"""The rows of the printed register map: where a value stands, and what its words mean."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.drives.register import Register

REFERENCE_BASE = 400_001  # six-digit references to holding registers begin here


@dataclass(frozen=True, slots=True)
class Row:
    """One value of the map: where it stands and what its words mean. `max_age` in seconds; older is not answered."""

    unit_id: int
    drive: str
    address: int
    name: str
    title: str = ""
    scale: str = "1"
    unit: str = ""
    is_signed: bool = False
    is_long: bool = False
    max_age: float | None = None
    bits: Mapping[int, str] = field(default_factory=dict)
    codes: Mapping[int, str] = field(default_factory=dict)
    note: str = ""
    form: str = ""  # the type, where a user-defined map names it
    word_order: str = "big"  # of 32 bits: the high word first, or "little"

    @property
    def register_number(self) -> int:
        """Return the address as tools that count from 1 want it."""
        return self.address + 1

    @property
    def reference(self) -> str:
        """Return the address as a six-digit reference: FD00H is 464769."""
        return str(REFERENCE_BASE + self.address)

    @property
    def type_name(self) -> str:
        """Return the type as tag lists spell it; 32 bits are two words."""
        return self.form or self._plain_type

    @property
    def _plain_type(self) -> str:
        return "uint32" if self.is_long else "int16" if self.is_signed else "uint16"


@dataclass(frozen=True, slots=True)
class Table:
    """The rows of one drive, of the compact map, or of the counters. `tags` begins the names of their tags."""

    title: str
    rows: tuple[Row, ...]
    tags: str = ""


@dataclass(frozen=True, slots=True)
class MapDocument:
    """The whole map of one gateway."""

    gateway: str
    tables: tuple[Table, ...]

    @property
    def rows(self) -> tuple[Row, ...]:
        """Return every row, in the order of the tables."""
        return tuple(row for table in self.tables for row in table.rows)


def row_of(unit_id: int, drive: str, address: int, register: Register, max_age: float | None, note: str = "") -> Row:
    """Return the row of a drive's register, at its own or at another address."""
    texts = register.enumeration.texts if register.enumeration else {}
    return Row(
        unit_id=unit_id,
        drive=drive,
        address=address,
        name=register.name,
        title=register.title,
        scale=f"{register.scaling.scale:f}",
        unit=register.unit,
        is_signed=register.scaling.signed,
        max_age=max_age,
        bits=register.bits,
        codes=texts,
        note=note,
    )
