"""Lays out the register map of a site for the SCADA engineer, and prints it as Markdown, CSV or JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from gateway.drives.register import Register
from gateway.image import LinkState, Quality
from gateway.modbus_tcp import gateway_unit
from gateway.site import Drive, Site

REFERENCE_BASE = 400_001  # six-digit references to holding registers begin here
MOST_CODES_IN_A_CELL = 6


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
        """Return the type as tag lists spell it; 32 bits are two words, the high one first."""
        return "uint32" if self.is_long else "int16" if self.is_signed else "uint16"


@dataclass(frozen=True, slots=True)
class Table:
    """The rows of one drive, of the compact map, or of the counters."""

    title: str
    rows: tuple[Row, ...]


@dataclass(frozen=True, slots=True)
class MapDocument:
    """The whole map of one gateway."""

    gateway: str
    tables: tuple[Table, ...]

    @property
    def rows(self) -> tuple[Row, ...]:
        """Return every row, in the order of the tables."""
        return tuple(row for table in self.tables for row in table.rows)


def register_map(site: Site) -> MapDocument:
    """Lay out all that the server answers for this site."""
    own = gateway_unit.UNIT
    compact = (row for i, drive in enumerate(site.drives) for row in _compact_rows(drive, i))
    return MapDocument(
        site.config.gateway.name,
        (
            *(_drive_table(drive) for drive in site.drives),
            Table(f"Unit {own}: compact map, 16 registers a drive (8000H: no value)", tuple(compact)),
            Table(f"Unit {own}: counters of the gateway", tuple(_counter_rows())),
        ),
    )


def _drive_table(drive: Drive) -> Table:
    points = sorted(drive.points.values(), key=lambda point: point.register.address)
    rows = (_row(drive.unit, drive.name, p.register.address, p.register, p.max_age) for p in points)
    return Table(f"Unit {drive.unit}: {drive.name} ({drive.model.title}, line {drive.line})", tuple(rows))


def _row(
    unit_id: int, drive: str, address: int, register: Register, max_age: float | None, note: str = ""
) -> Row:
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


def _compact_rows(drive: Drive, place: int) -> Iterator[Row]:
    unit, start = gateway_unit.UNIT, gateway_unit.REGISTERS_PER_DRIVE * place
    links = {state.value: state.word for state in LinkState}
    qualities = {quality.value: quality.word for quality in Quality}
    yield Row(unit, drive.name, start, "link", "state of the connection", codes=links)
    yield Row(unit, drive.name, start + 1, "quality", "the worst of all values of the drive", codes=qualities)
    age_note = f"{gateway_unit.NEVER_HEARD}: so many or more, or never"
    yield Row(unit, drive.name, start + gateway_unit.AGE_AT, "age", "since the last answer", unit="ms", note=age_note)
    for address, name in enumerate(gateway_unit.VALUES, start + gateway_unit.VALUES_AT):
        point, register = drive.points.get(name), drive.model.registers.get(name)
        if point is not None:
            yield _row(unit, drive.name, address, point.register, point.max_age)
        elif register is not None:
            yield _row(unit, drive.name, address, register, None, "not read from this drive: always 8000H")
        else:
            yield Row(unit, drive.name, address, name, note="this model has no such value: always 8000H")
    held = {gateway_unit.VALUES_AT + i: name for i, name in enumerate(gateway_unit.VALUES)}
    title = "which registers of this block hold a value"
    yield Row(unit, drive.name, start + gateway_unit.PRESENT_AT, "present", title, bits=held)


def _counter_rows() -> Iterator[Row]:
    address = gateway_unit.COUNTERS_AT
    for counter in gateway_unit.COUNTERS:
        yield Row(
            unit_id=gateway_unit.UNIT,
            drive="gateway",
            address=address,
            name=counter.name,
            title=counter.title,
            unit=counter.unit,
            is_long=counter.is_long,
        )
        address += 2 if counter.is_long else 1


def as_csv(document: MapDocument) -> str:
    """Print the map as CSV by RFC 4180, a line a value."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(_record(document.rows[0])))
    writer.writeheader()
    for row in document.rows:
        cells = {**_record(row), "bits": _listed(row.bits), "codes": _listed(row.codes)}
        writer.writerow({key: "" if cell is None else cell for key, cell in cells.items()})
    return text.getvalue()


def as_json(document: MapDocument) -> str:
    """Print the map as JSON."""
    registers = [_record(row) for row in document.rows]
    whole = {"gateway": document.gateway, "map_version": gateway_unit.MAP_VERSION, "registers": registers}
    return json.dumps(whole, indent=2, ensure_ascii=False)


def _record(row: Row) -> dict[str, object]:
    return {
        "unit_id": row.unit_id,
        "drive": row.drive,
        "address": row.address,
        "address_hex": f"{row.address:04X}",
        "register_number": row.register_number,
        "reference": row.reference,
        "name": row.name,
        "title": row.title,
        "type": row.type_name,
        "scale": row.scale,
        "unit": row.unit,
        "max_age": None if row.max_age is None else round(row.max_age, 3),
        "bits": row.bits,
        "codes": row.codes,
        "note": row.note,
    }


def as_markdown(document: MapDocument) -> str:
    """Print the map as Markdown, a table a unit; long lists of codes stand once, behind the tables."""
    lines = [
        f"# MODBUS-TCP register map of {document.gateway}",
        "",
        "Functions 03 and 04 read the same registers. Addresses count from 0; the register number is for tools that "
        "count from 1, the reference for those that number holding registers 4xxxxx. 32 bits: high word first.",
    ]
    for table in document.tables:
        lines += ["", f"## {table.title}", "", _line(*COLUMNS), _line(*["---"] * len(COLUMNS))]
        lines += [_line(*_cells(row)) for row in table.rows]
    long_lists = {row.name: row.codes for row in document.rows if len(row.codes) > MOST_CODES_IN_A_CELL}
    for name, codes in long_lists.items():
        lines += ["", f"## Codes of {name}", "", _line("code", "meaning"), _line("---", "---")]
        lines += [_line(f"{code}", text) for code, text in codes.items()]
    return "\n".join(lines) + "\n"


COLUMNS = ("address", "hex", "register", "reference", "name", "meaning", "type", "scale", "max. age", "note")


def _cells(row: Row) -> Iterator[str]:
    """Yield the cells of a row in the order of COLUMNS."""
    yield from (f"{row.address}", f"{row.address:04X}H", f"{row.register_number}", row.reference)
    yield from (row.name, row.title, row.type_name, f"{row.scale} {row.unit}".strip())
    yield "" if row.max_age is None else f"{row.max_age:.1f} s"
    notes = [row.note, f"bits: {_listed(row.bits)}" if row.bits else ""]
    if row.codes:
        is_long = len(row.codes) > MOST_CODES_IN_A_CELL
        notes.append(f"codes of {row.name}: see below" if is_long else _listed(row.codes))
    yield "; ".join(note for note in notes if note)


def _line(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _listed(texts: Mapping[int, str]) -> str:
    return ", ".join(f"{number} = {text}" for number, text in texts.items())
