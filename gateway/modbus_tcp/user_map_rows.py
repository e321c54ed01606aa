"""The rows of the printed register map for the user-defined map: type, scale and limits of each entry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from decimal import Decimal

from gateway.config import MapSection
from gateway.drives.register import Register
from gateway.modbus_tcp.map_rows import Row, Table, row_of
from gateway.site import Drive, Site
from gateway.wire_forms import FORMS, WORD

DIGITS = Decimal("1e-9")  # a printed scale has no more


def user_tables(site: Site) -> Iterator[Table]:
    """Lay out the user-defined map, a table a unit; nothing where there is none."""
    section = site.config.modbus_tcp
    if section is None:
        return
    drives = {drive.name: drive for drive in site.drives}
    for unit in sorted({section.unit_of(entry) for entry in section.map}):
        entries = sorted(
            (entry for entry in section.map if section.unit_of(entry) == unit), key=lambda entry: entry.address
        )
        rows = tuple(_row(unit, entry, drives[entry.drive]) for entry in entries)
        yield Table(f"Unit {unit}: user-defined map", rows, "map")


def _row(unit: int, entry: MapSection, drive: Drive) -> Row:
    derived = next((derived for derived in drive.derived if derived.name == entry.value), None)
    point = drive.points[derived.of if derived else entry.value]
    row = row_of(unit, drive.name, entry.address, point.register, point.max_age)
    if derived is not None:
        title = f"{derived.of} of {derived.base}"
        row = replace(row, name=derived.name, title=title, unit=derived.unit, bits={}, codes={})
    if entry.type == WORD:
        return row
    form = FORMS[entry.type]
    return replace(
        row,
        form=form.type_name,
        is_long=form.words > 1,
        word_order=entry.word_order,
        scale=_plain(1 / entry.factor),
        note=_limits(entry, None if derived else point.register),
    )


def _limits(entry: MapSection, register: Register | None) -> str:
    """Say which values do not fit, where a drive's word may hold such."""
    form = FORMS[entry.type]
    if form.low is None or form.high is None:
        return ""
    low, high = (Decimal(limit) / entry.factor for limit in (form.low, form.high))
    if register is not None:
        least, most = (limit * register.scaling.scale for limit in register.scaling.limits)
        if form.holds(least * entry.factor) and form.holds(most * entry.factor):
            return ""
    return f"04 outside {_plain(low)} to {_plain(high)}"


def _plain(number: Decimal) -> str:
    """Return a number without exponent and trailing zeros, with nine decimals at the most."""
    return f"{number.quantize(DIGITS).normalize() + 0:f}"
