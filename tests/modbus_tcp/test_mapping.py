"""The printed register map says what the server answers."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest

from gateway import site
from gateway.image import DriveImage, Image, LinkState
from gateway.metrics import Stats
from gateway.modbus_tcp.gateway_unit import COUNTERS, COUNTERS_AT, UNIT, VALUES, GatewayUnit
from gateway.modbus_tcp.mapping import MapDocument, as_csv, as_json, as_markdown, register_map
from gateway.modbus_tcp.server import IDENTITY
from gateway.site import Site
from tests.modbus_tcp.rig import NOW

TABLE = {
    "gateway": {"name": "hall-3"},
    "modbus_tcp": {},
    "line": [
        {
            "name": "a",
            "port": "/dev/ttyUSB0",
            "drive": [
                {
                    "name": "pump-1",
                    "number": 1,
                    "model": "vf-nc3",
                    "poll": [
                        {"values": ["status", "output_frequency", "torque"], "every": "100ms", "max_age": "2s"},
                        {"values": ["trip_code"], "every": "10s", "max_age": "30s"},
                    ],
                },
                {"name": "fan", "number": 2, "unit": 20, "model": "vf-as3"},
            ],
        }
    ],
}


@pytest.fixture(scope="module")
def plant() -> Site:
    """Return a site with two drives."""
    return site.build(TABLE, "test", Path())


@pytest.fixture(scope="module")
def document(plant: Site) -> MapDocument:
    """Return its map."""
    return register_map(plant)


def test_a_drive_stands_at_its_own_numbers(document: MapDocument) -> None:
    """FD00H is address 64768, register 64769, reference 464769."""
    row = next(row for row in document.rows if row.drive == "pump-1" and row.name == "output_frequency")
    assert (row.unit_id, row.address, row.register_number, row.reference) == (1, 64768, 64769, "464769")
    assert (row.scale, row.unit, row.type_name, row.max_age) == ("0.01", "Hz", "uint16", 2.0)
    torque = next(row for row in document.rows if row.unit_id == 1 and row.name == "torque")
    assert torque.type_name == "int16"
    assert {row.unit_id for row in document.rows} == {1, 20, UNIT}


def test_the_compact_map_has_sixteen_rows_a_drive(document: MapDocument) -> None:
    """Contiguous from 0; what is not read says so."""
    rows = [row for row in document.rows if row.unit_id == UNIT and row.drive != "gateway"]
    assert [row.address for row in rows] == list(range(32))
    assert [row.name for row in rows[:5]] == ["link", "quality", "age", "status", "output_frequency"]
    assert rows[15].bits[4] == "output_frequency"
    assert "always 8000H" in rows[5].note
    assert "no such value" in rows[19].note


def test_every_row_is_answered_and_nothing_else(plant: Site, document: MapDocument) -> None:
    """The map and the server are of one mind: each address of 65536, under each unit."""
    image = Image(plant.drives)
    for each in image.drives:
        each.set_link(LinkState.ONLINE)
        each.apply([(point.register.address, 1) for point in each.points.values()], NOW, NOW)
    units: dict[int, DriveImage | GatewayUnit] = dict(image.by_unit)
    units[UNIT] = GatewayUnit(image, Stats(0.0), IDENTITY, NOW)
    for number, served in units.items():
        rows = [row for row in document.rows if row.unit_id == number]
        mapped = {row.address + word for row in rows for word in range(1 + row.is_long)}
        assert {a for a in range(0x10000) if isinstance(served.read(a, 1, NOW), bytes)} == mapped


def test_csv_is_rfc_4180(document: MapDocument) -> None:
    """CRLF, a heading, and every row comes back through a reader whole."""
    text = as_csv(document)
    assert text.count("\r\n") == text.count("\n") == len(document.rows) + 1
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert [row["name"] for row in rows] == [row.name for row in document.rows]
    trip = next(row for row in rows if row["name"] == "trip_code")
    assert trip["address_hex"] == "FC90"
    assert "1 = Overcurrent during acceleration" in trip["codes"]
    assert trip["max_age"] == "30.0"
    counter = next(row for row in rows if row["name"] == "uptime")
    assert (counter["type"], counter["max_age"]) == ("uint32", "")


def test_json_has_bits_and_codes_as_objects(document: MapDocument) -> None:
    """For scripts that make tag lists."""
    whole = json.loads(as_json(document))
    assert whole["gateway"] == "hall-3"
    assert len(whole["registers"]) == len(document.rows)
    status = next(row for row in whole["registers"] if row["name"] == "status")
    assert status["bits"]["10"] == "running"


def test_markdown_has_a_table_a_unit_and_long_lists_once(document: MapDocument) -> None:
    """Every table has as many cells in each line."""
    text = as_markdown(document)
    assert "## Unit 1: pump-1" in text
    assert text.count("## Codes of trip_code") == 1
    for block in text.split("\n\n"):
        lines = [line for line in block.splitlines() if line.startswith("|")]
        assert len({line.replace("\\|", "").count("|") for line in lines}) <= 1


def test_the_manual_has_every_register_of_unit_255_at_its_place() -> None:
    """docs/modbus-tcp.md: offsets of the compact map, addresses of the counters."""
    text = (Path(__file__).parents[2] / "docs" / "modbus-tcp.md").read_text(encoding="utf-8")
    for offset, name in enumerate(("link", "quality", "age", *VALUES, "present")):
        assert f"\n| {offset} | `{name}` |" in text
    address = COUNTERS_AT
    for counter in COUNTERS:
        assert f"\n| {address:04X}H | `{counter.name}` |" in text
        address += 1 + counter.is_long
