"""The printed register map says what the server answers."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.config import ModbusTcpSection
from gateway.control.command import Reason
from gateway.control.door import Door
from gateway.image import DriveImage, Image, LinkState, Missing
from gateway.metrics import Stats
from gateway.modbus_tcp.codes import REFUSED
from gateway.modbus_tcp.gateway_unit import COUNTERS, COUNTERS_AT, UNIT, VALUES, GatewayUnit
from gateway.modbus_tcp.map_rows import MapDocument
from gateway.modbus_tcp.mapping import as_csv, as_json, as_markdown, register_map
from gateway.modbus_tcp.mirror_map import LINES_AT, MIRROR_AT, ORDERS, PER_DRIVE, REASONS, Place
from gateway.modbus_tcp.mirror_rows import CODES
from gateway.modbus_tcp.server import IDENTITY, ModbusTcpServer
from gateway.site import Site
from tests.modbus_tcp.rig import NOW, StandingClock

NEVER_HERE = (Reason.NONE, Reason.RETAINED)  # refusals that MODBUS-TCP does not know
TABLE: dict[str, Any] = {
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


CONTROLLED = {
    **TABLE,
    "line": [
        *TABLE["line"],
        {
            "name": "b",
            "port": "/dev/ttyUSB1",
            "drive": [
                {"name": "saw", "number": 3, "model": "vf-nc3", "control": "direct",
                 "poll": [{"values": ["status", "frequency_command"], "every": "1s"}]},
                {"name": "mill", "number": 4, "model": "vf-mb1", "control": "leased", "allow_stored": True},
            ],
        },
    ],
}  # fmt: skip


@pytest.fixture(scope="module")
def controlled() -> Site:
    """Return a site whose second line may be commanded."""
    return site.build(CONTROLLED, "test", Path())


@pytest.fixture(scope="module")
def document(plant: Site) -> MapDocument:
    """Return its map."""
    return register_map(plant)


def test_a_drive_may_have_no_unit_of_its_own() -> None:
    """As many as like: each is in the compact map, and unit 0 answers for none of them."""
    line = {"name": "b", "port": "/dev/ttyUSB1"}
    drives = [{"name": f"d{n}", "number": n, "unit": 0, "model": "vf-nc3"} for n in range(1, 32)]
    many = site.build({**TABLE, "line": [*TABLE["line"], {**line, "drive": drives}]}, "test", Path())
    assert set(Image(many.drives).by_unit) == {1, 20}
    rows = register_map(many).rows
    assert {row.unit_id for row in rows} == {1, 20, UNIT}
    assert {row.drive for row in rows if row.unit_id == UNIT} >= {drive["name"] for drive in drives}


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


def test_every_row_of_drives_that_are_commanded_is_answered_and_nothing_else(controlled: Site) -> None:
    """Registers that are written are mapped, though not known before they were read back; mirror and lines too."""
    document = register_map(controlled)
    clock = StandingClock()
    image = Image(controlled.drives)
    door = Door.of(controlled, clock)
    served = ModbusTcpServer(ModbusTcpSection(), image, Stats(0.0), clock, door=door)._reception.free._units
    assert set(served) == {1, 20, 3, 4, UNIT}
    for number, unit in served.items():
        rows = [row for row in document.rows if row.unit_id == number]
        mapped = {row.address + word for row in rows for word in range(1 + row.is_long)}
        assert {a for a in range(0x10000) if unit.read(a, 1, NOW) is not Missing.UNMAPPED} == mapped


def test_what_is_written_is_marked(controlled: Site) -> None:
    """The drive's own registers, the first five of the mirror, and the lines; where nobody may write, it says so."""
    rows = {(row.unit_id, row.address): row for row in register_map(controlled).rows}
    assert rows[3, 0xFA00].note == "written; read for 5 s after it was read back"
    assert (rows[3, 0xFA01].note, rows[3, 0xFA01].max_age) == ("also written", 3.0)
    assert "written" in rows[4, 0x0009].note
    assert (3, 0x0009) not in rows
    places = [rows[UNIT, MIRROR_AT + PER_DRIVE * 2 + place].note for place in Place]
    assert places[:5] == ["written"] * 5
    assert not any("written" in note for note in places[5:])
    assert rows[UNIT, MIRROR_AT].note == "not controlled: cannot be written"
    assert [rows[UNIT, LINES_AT + line].note for line in (0, 1)] == ["no drive of it may be commanded", "written"]
    assert rows[UNIT, MIRROR_AT].codes[8] == "run"
    assert rows[UNIT, MIRROR_AT + Place.DRIVE_STATUS].bits[10] == "running"
    assert rows[UNIT, MIRROR_AT + PER_DRIVE + Place.OUTPUT_FREQUENCY].scale == "0.01"


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


MANUAL = (Path(__file__).parents[2] / "docs" / "modbus-tcp.md").read_text(encoding="utf-8")


def table(heading: str) -> dict[str, str]:
    """Return the first table behind a heading of the manual: first cell, second cell."""
    body = MANUAL.split(f"# {heading}\n", 1)[1].split("\n#", 1)[0]
    return dict(re.findall(r"^\| ([^|]+?) \| ([^|]+?) \|", body.split("|---", 1)[1], re.MULTILINE))


def test_the_manual_has_every_register_of_unit_255_at_its_place() -> None:
    """docs/modbus-tcp.md: offsets of the compact map and of the mirror, addresses of the counters."""
    for offset, name in enumerate(("link", "quality", "age", *VALUES, "present")):
        assert f"\n| {offset} | `{name}` |" in MANUAL
    address = COUNTERS_AT
    for counter in COUNTERS:
        assert f"\n| {address:04X}H | `{counter.name}` |" in MANUAL
        address += 1 + counter.is_long
    assert table("The command mirror") == {str(place.value): f"`{place.name.lower()}`" for place in Place}


def test_the_manual_has_every_number_of_the_mirror() -> None:
    """Commands, results, reasons, standings, owners."""
    assert table("Commands") == {str(code): f"`{order.word}`" for code, order in ORDERS.items()}
    assert table("Results") == {str(code): text for code, text in CODES[Place.RESULT].items()}
    reasons = {str(REASONS[reason]): f"`{reason.value}`" for reason in Reason if reason.value}
    assert table("Reasons") == reasons
    for place in (Place.STANDING, Place.OWNER):
        assert all(f"{code} {text}" in MANUAL for code, text in CODES[place].items())


def test_the_manual_has_every_exception_of_a_refusal() -> None:
    """Each reason stands in the row of its code."""
    body = MANUAL.split("## Exceptions of writes\n", 1)[1].split("\n#", 1)[0]
    rows = dict(re.findall(r"^\| (0[0-9A-F]) \| [^|]+ \| (.*) \|$", body, re.MULTILINE))
    for reason, code in REFUSED.items():
        if reason not in NEVER_HERE:
            assert f"`{reason.value}`" in rows[f"{code:02X}"], reason
