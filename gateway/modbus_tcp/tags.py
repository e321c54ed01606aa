"""Prints the register map as a list of tags: a CSV with the columns that tag importers ask for."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator

from gateway.modbus_tcp.map_rows import MapDocument, Row

NOT_IN_A_TAG = re.compile(r"[^A-Za-z0-9]+")
COLUMNS = (
    "Tag Name",
    "Unit ID",
    "Address",
    "Data Type",
    "Word Order",
    "Scaling",
    "Eng Units",
    "Description",
)


def as_tags(document: MapDocument) -> str:
    """Print a line a value; the address is a six-digit reference to a holding register, 4xxxxx."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(COLUMNS)
    for tag, row in _tagged(document):
        about = [row.title or row.name.replace("_", " "), row.note]
        description = "; ".join(part for part in about if part)
        place = (row.unit_id, row.reference, row.type_name, row.word_order)
        writer.writerow((tag, *place, row.scale, row.unit, f"{row.drive}: {description}"))
    return text.getvalue()


def _tagged(document: MapDocument) -> Iterator[tuple[str, Row]]:
    """Yield each row with a name that no other row has, of letters, digits and underscores."""
    named = [(_name(table.tags, row), row) for table in document.tables for row in table.rows]
    times = Counter(name for name, _ in named)
    for name, row in named:
        yield (name if times[name] == 1 else f"{name}_{row.unit_id}_{row.address:04X}"), row


def _name(first: str, row: Row) -> str:
    parts = (first, row.drive, row.name)
    return NOT_IN_A_TAG.sub("_", "_".join(part for part in parts if part))
