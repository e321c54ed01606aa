"""The list of tags names every value of the map once, by its reference."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from gateway import site
from gateway.modbus_tcp.mapping import register_map
from gateway.modbus_tcp.tags import COLUMNS, as_tags
from tests.modbus_tcp.test_user_map import TABLE

MANUAL = (Path(__file__).parents[2] / "docs" / "modbus-tcp.md").read_text(encoding="utf-8")


def test_tags_have_names_of_their_own_and_references() -> None:
    """Every row of the map once; letters, digits and underscores; a value that is mapped twice has two names."""
    document = register_map(site.build(TABLE, "test", Path()))
    rows = list(csv.DictReader(io.StringIO(as_tags(document), newline="")))
    names = [row["Tag Name"] for row in rows]
    assert len(names) == len(set(names)) == len(document.rows)
    assert all(name.replace("_", "").isalnum() and name.isascii() for name in names)
    found = {row["Tag Name"]: row for row in rows}
    own = found["pump_1_output_frequency"]
    assert (own["Unit ID"], own["Address"], own["Data Type"], own["Scaling"], own["Eng Units"]) == (
        "1", "464769", "uint16", "0.01", "Hz",
    )  # fmt: skip
    mapped = found["map_pump_1_output_frequency_247_000A"]
    assert (mapped["Address"], mapped["Data Type"], mapped["Word Order"]) == ("400011", "float32", "little")
    assert found["map_pump_1_output_current_amps"]["Scaling"] == "0.333333333"
    assert "compact_pump_1_output_frequency" in found
    assert "mirror_pump_1_output_frequency" in found


def test_the_manual_has_every_column() -> None:
    """In the order of the file."""
    rows = MANUAL.split("## Lists of tags\n", 1)[1].split("\n## ", 1)[0].split("|---|---|\n", 1)[1]
    assert [line.split(" | ")[0].removeprefix("| ") for line in rows.splitlines() if line[:1] == "|"] == list(COLUMNS)
