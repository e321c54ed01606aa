"""Lays out the register map of a site for the SCADA engineer, and prints it as Markdown, CSV or JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping

from gateway.image import LinkState, Quality
from gateway.modbus_tcp import gateway_unit
from gateway.modbus_tcp.map_rows import MapDocument, Row, Table, row_of
from gateway.modbus_tcp.mirror_rows import command_tables
from gateway.modbus_tcp.read_back import FRESH_FOR, commanded_registers
from gateway.modbus_tcp.user_map_rows import user_tables
from gateway.site import Drive, Site

MOST_CODES_IN_A_CELL = 6
POLLED_AND_WRITTEN = "also written"
WRITTEN = f"written; read for {FRESH_FOR:g} s after it was read back"


def register_map(site: Site) -> MapDocument:
    """Lay out all that the server answers for this site."""
    own = gateway_unit.UNIT
    compact = (row for i, drive in enumerate(site.drives) for row in _compact_rows(drive, i))
    return MapDocument(
        site.config.gateway.name,
        (
            *(_drive_table(drive) for drive in site.drives if drive.unit),
            Table(f"Unit {own}: compact map, 16 registers a drive (8000H: no value)", tuple(compact), "compact"),
            *command_tables(site),
            *user_tables(site),
            Table(f"Unit {own}: counters of the gateway", tuple(_counter_rows())),
        ),
    )


def _drive_table(drive: Drive) -> Table:
    """Lay out what is polled and, of a drive that may be commanded, what may be written."""
    rows = {
        register.address: row_of(drive.unit, drive.name, register.address, register, None, WRITTEN)
        for register in commanded_registers(drive)
    }
    for point in drive.points.values():
        address = point.register.address
        note = POLLED_AND_WRITTEN if address in rows else ""
        rows[address] = row_of(drive.unit, drive.name, address, point.register, point.max_age, note)
    title = f"Unit {drive.unit}: {drive.name} ({drive.model.title}, line {drive.line})"
    return Table(title, tuple(rows[address] for address in sorted(rows)))


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
            yield row_of(unit, drive.name, address, point.register, point.max_age)
        elif register is not None:
            yield row_of(unit, drive.name, address, register, None, "not read from this drive: always 8000H")
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
        "word_order": row.word_order,
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
        "count from 1, the reference for those that number holding registers 4xxxxx. "
        "32 bits: high word first, where no note says otherwise.",
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
    order = "" if row.word_order == "big" else "low word first"
    notes = [row.note, order, f"bits: {_listed(row.bits)}" if row.bits else ""]
    if row.codes:
        is_long = len(row.codes) > MOST_CODES_IN_A_CELL
        notes.append(f"codes of {row.name}: see below" if is_long else _listed(row.codes))
    yield "; ".join(note for note in notes if note)


def _line(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _listed(texts: Mapping[int, str]) -> str:
    return ", ".join(f"{number} = {text}" for number, text in texts.items())
