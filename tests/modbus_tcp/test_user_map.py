"""The user-defined map: values at addresses of the user's own, fresh, whole and in the right form, or not at all."""

from __future__ import annotations

import csv
import io
import struct
import tomllib
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from gateway import site
from gateway.config import MapSection, ModbusTcpSection
from gateway.control.door import Door
from gateway.drives.register import Derived
from gateway.image import Image, LinkState, Missing
from gateway.metrics import Stats
from gateway.modbus_tcp import gateway_unit, user_map
from gateway.modbus_tcp.map_rows import Row
from gateway.modbus_tcp.mapping import as_csv, as_markdown, register_map
from gateway.modbus_tcp.mirror_map import MIRROR_AT
from gateway.modbus_tcp.server import ModbusTcpServer
from gateway.site.mapping import FREE_AT_GATEWAY, GATEWAY_UNIT
from tests.modbus_tcp.plant import code_of, exchange
from tests.modbus_tcp.rig import ALL, NOW, StandingClock, answer, answers, drive, request

MAP = 247


def entry(point: str, address: int, form: str = "word", **more: Any) -> MapSection:
    """Make an entry of the map; a point without a drive is one of pump-1."""
    whole = point if "." in point else f"pump-1.{point}"
    return MapSection.model_validate({"point": whole, "address": address, "type": form, **more})


ENTRIES = (
    entry("output_frequency", 0, "float32"),
    entry("torque", 2, "signed", scale=100),
    entry("status", 3),
    entry("torque", 4, "int32", scale=1000, word_order="little"),
    entry("trip_code", 100),
    entry("amps", 200, "float32", word_order="little"),
    entry("pump-2.trip_code", 101),
    entry("output_current", 300, "signed", scale=100),
)


class Served:
    """A server with this map over two drives, and what it answers."""

    def __init__(self, *entries: MapSection, unit: int = MAP) -> None:
        first = replace(
            drive(max_ages={"trip_code": 10.0}),
            derived=(Derived("amps", "output_current", "rated_current", "A"),),
        )
        self.image = Image([first, drive("pump-2", 2)])
        self.clock = StandingClock()
        section = ModbusTcpSection(map=list(entries or ENTRIES), map_unit=unit)
        self.stats = Stats(0.0)
        self.server = ModbusTcpServer(section, self.image, self.stats, self.clock)

    def tell(self, **words: int) -> None:
        """Let both drives be online and tell all their values."""
        for image in self.image.drives:
            image.set_link(LinkState.ONLINE)
            answer(image, self.clock.now(), **{**ALL, **words})

    def ask(self, pdu: bytes, unit: int = MAP) -> bytes:
        """Return the PDU that answers a PDU, by the way that all requests take and again by that of known ones."""
        responder = self.server._reception.free
        whole = request(7, unit, pdu)
        again = responder.known.get(whole[2:])
        told_again = None if again is None else again(self.clock.now())
        told, _, _ = responder.respond(whole, 0, 16, self.clock.now())
        assert told_again in (None, told[2:])
        ((_, _, answered),) = answers(told)
        return answered

    def read(self, start: int, count: int, function: int = 3) -> bytes:
        """Return the registers that are read; empty for an exception."""
        told = self.ask(struct.pack(">BHH", function, start, count))
        return b"" if told[0] & 0x80 else told[2:]

    def code(self, start: int, count: int) -> int:
        """Return the exception of a read; 0 for none."""
        return code_of(self.ask(struct.pack(">BHH", 3, start, count)))


@pytest.fixture
def served() -> Served:
    """Return a server whose drives have just told all their values."""
    made = Served()
    made.image.by_name["pump-1"].bases = {"rated_current": Decimal("8.0")}
    made.tell()
    return made


@pytest.mark.parametrize("function", [3, 4])
def test_values_stand_where_and_as_the_map_says(served: Served, function: int) -> None:
    """One request over five entries: float, scaled and raw words, 32 bits with the low word first."""
    told = struct.pack(">fhH", 60.0, -1, 3) + struct.pack(">i", -10)[2:] + struct.pack(">i", -10)[:2]
    assert served.read(0, 6, function) == told
    assert served.read(2, 2, function) == told[4:8]
    assert served.read(100, 2, function) == struct.pack(">HH", 1, 1)


def test_computed_values_are_mapped_as_well(served: Served) -> None:
    """Amperes: 46.60 % of 8.0 A; a foreign client decodes the little word order."""
    words = struct.unpack(">2H", served.read(200, 2))
    decoded = ModbusClientMixin.convert_from_registers(
        words, ModbusClientMixin.DATATYPE.FLOAT32, word_order="little"
    )
    assert decoded == pytest.approx(3.73)


def test_a_computed_value_without_its_base_is_not_answered() -> None:
    """What 100 % are is read when the drive is identified."""
    made = Served()
    made.tell()
    assert made.code(200, 2) == 0x0B
    assert made.code(0, 2) == 0


def test_values_follow_the_drive(served: Served) -> None:
    """Each answer shows at the next read, by both ways."""
    for word in (6000, 5000, 0, 5000):
        answer(served.image.by_name["pump-1"], output_frequency=word)
        assert served.read(0, 2) == struct.pack(">f", word / 100)


@pytest.mark.parametrize(
    ("start", "count"), [(6, 1), (99, 1), (3, 4), (99, 2), (100, 3), (0, 1), (1, 1), (1, 2), (4, 1), (5, 1), (3, 2)]
)
def test_a_hole_and_a_part_of_a_value_are_no_address(served: Served, start: int, count: int) -> None:
    """02, as in a hole of a drive's own numbers; 32 bits are never read in halves."""
    assert served.code(start, count) == 0x02


@given(st.integers(0, 400), st.integers(1, 125))
def test_a_read_is_answered_where_it_begins_and_ends_at_values_without_a_hole(start: int, count: int) -> None:
    """Every range, against the map laid out register by register."""
    made = Served()
    made.image.by_name["pump-1"].bases = {"rated_current": Decimal("8.0")}
    made.tell()
    sizes = {each.address: 2 if each.type in ("float32", "int32") else 1 for each in ENTRIES}
    at = start
    while at < start + count and at in sizes:
        at += sizes[at]
    assert (made.code(start, count) == 0) == (at == start + count)


@pytest.mark.hazard("H19")
def test_one_old_value_refuses_what_covers_it_and_nothing_else(served: Served) -> None:
    """0BH as under the drive's own unit; trip_code holds for ten seconds, the others for one."""
    served.clock.moment = NOW + 1.0
    assert served.code(0, 6) == 0
    served.clock.moment = NOW + 1.1
    assert served.code(0, 6) == 0x0B
    assert served.code(100, 1) == 0
    assert served.code(100, 2) == 0x0B
    answer(served.image.by_name["pump-1"], served.clock.now(), output_frequency=5000)
    assert served.read(0, 2) == struct.pack(">f", 50.0)
    assert served.code(0, 3) == 0x0B


@pytest.mark.hazard("H19")
@pytest.mark.parametrize(("link", "code"), [(LinkState.OFFLINE, 0x0B), (LinkState.LINE_DOWN, 0x0A)])
def test_a_lost_drive_is_told_as_under_its_own_unit(served: Served, link: LinkState, code: int) -> None:
    """Also where it has come back and told nothing yet; the other drive is answered all the time."""
    image = served.image.by_name["pump-1"]
    assert served.code(0, 6) == 0
    image.set_link(link, "lost")
    assert served.code(0, 6) == served.code(100, 2) == code
    assert served.code(101, 1) == 0
    image.set_link(LinkState.ONLINE)
    assert served.code(0, 6) == 0x0B
    answer(image, **ALL)
    assert served.code(0, 6) == 0


def test_the_line_is_told_before_what_is_old(served: Served) -> None:
    """One drive silent, the other behind a line that is down: 0AH."""
    served.image.by_name["pump-1"].set_link(LinkState.OFFLINE, "lost")
    served.image.by_name["pump-2"].set_link(LinkState.LINE_DOWN, "lost")
    assert served.code(100, 2) == 0x0A


@pytest.mark.hazard("H20")
def test_what_does_not_fit_is_refused_and_not_saturated(served: Served) -> None:
    """04 for 327.68 % in hundredths; good again with the next value that fits, and old before it is wrong."""
    image = served.image.by_name["pump-1"]
    answer(image, output_current=0x8000)
    assert served.code(300, 1) == 0x04
    assert served.code(300, 1) == 0x04
    served.clock.moment = NOW + 5
    assert served.code(300, 1) == 0x0B
    for word in (0x7FFF, 0x8000, 0x7FFF):
        answer(image, served.clock.now(), output_current=word)
        assert served.read(300, 1) == (struct.pack(">H", word) if word < 0x8000 else b"")


def test_the_map_is_read_only_and_answers_as_the_gateway(served: Served) -> None:
    """Writes are 01, the identification is the gateway's."""
    assert served.ask(bytes([6, 0, 0, 0, 1])) == bytes([0x86, 1])
    assert served.ask(bytes([16, 0, 0, 0, 1, 2, 0, 1])) == bytes([0x90, 1])
    assert served.ask(exchange(0, 2, 0, 1)) == bytes([0x97, 1])
    assert b"tosvert-gateway" in served.ask(bytes([0x2B, 14, 1, 0]))


@pytest.mark.hazard("H21")
@given(st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=20))
def test_both_words_are_of_one_sample(words: list[int]) -> None:
    """Whatever the drive tells between two reads, 32 bits are always one of its values, exactly."""
    made = Served(entry("output_frequency", 9, "uint32", scale=65537 / 100, word_order="little"))
    made.image.by_name["pump-1"].set_link(LinkState.ONLINE)
    scale = Decimal(str(65537 / 100))
    for word in words:
        answer(made.image.by_name["pump-1"], output_frequency=word)
        low, high = struct.unpack(">2H", made.read(9, 2))
        assert high << 16 | low == int((Decimal(word) / 100 * scale).to_integral_value("ROUND_HALF_UP"))


def test_a_read_of_what_has_not_changed_encodes_nothing(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is a comparison, until a drive tells something."""
    assert served.code(0, 6) == 0
    refreshed: list[float] = []
    refresh = user_map.MappedValue.refresh

    def counted(value: user_map.MappedValue, now: float) -> None:
        refreshed.append(now)
        refresh(value, now)

    monkeypatch.setattr(user_map.MappedValue, "refresh", counted)
    assert served.code(0, 6) == served.code(2, 1) == 0
    assert refreshed == []
    reading = served.server._reception.free._units[MAP].reading(0, 6)
    assert reading(served.clock.now()) is reading(served.clock.now())  # not even a slice
    answer(served.image.by_name["pump-1"], **ALL)
    assert served.code(0, 6) == 0
    assert len(refreshed) == 4


def test_unit_255_has_room_for_a_map_beside_its_own_registers() -> None:
    """For masters whose unit id is fixed; compact map and counters are as ever."""
    made = Served(entry("status", 0x6000), entry("output_frequency", 0x7FFE, "float32"), unit=255)
    made.tell()
    assert made.ask(struct.pack(">BHH", 3, 0x6000, 1), 255) == bytes([3, 2, 0, 3])
    assert made.ask(struct.pack(">BHH", 3, 0x7FFE, 2), 255) == bytes([3, 4]) + struct.pack(">f", 60.0)
    assert made.ask(struct.pack(">BHH", 3, 0x6001, 1), 255) == bytes([0x83, 2])
    assert made.ask(struct.pack(">BHH", 3, 0, 1), 255) == bytes([3, 2, 0, 0])
    assert code_of(made.ask(struct.pack(">BHH", 3, 0xF000, 1), 255)) == 0


def test_the_room_is_kept_free_by_the_gateway() -> None:
    """Between the compact map and the command mirror."""
    assert GATEWAY_UNIT == gateway_unit.UNIT
    assert FREE_AT_GATEWAY.stop <= MIRROR_AT
    assert FREE_AT_GATEWAY.start % gateway_unit.REGISTERS_PER_DRIVE == 0


TABLE: dict[str, Any] = {
    "gateway": {"name": "hall-3"},
    "modbus_tcp": {
        "map": [
            {"point": "pump.1.output_frequency", "address": 10, "type": "float32", "word_order": "little"},
            {"point": "pump.1.output_frequency", "address": 12, "type": "signed", "scale": 100},
            {"point": "pump.1.output_current_amps", "address": 13, "type": "int32", "scale": 3},
            {"point": "pump.1.status", "address": 0x6000, "unit": 255},
            {"point": "pump.1.torque", "address": 15, "type": "signed", "scale": 10},
        ]
    },
    "line": [
        {
            "name": "a",
            "port": "/dev/ttyUSB0",
            "drive": [
                {
                    "name": "pump.1",
                    "number": 1,
                    "model": "vf-nc3",
                    "control": "direct",
                    "poll": [
                        {
                            "values": ["status", "output_frequency", "output_current_amps", "torque"],
                            "every": "1s",
                        }
                    ],
                }
            ],
        }
    ],
}


@pytest.fixture(scope="module")
def built() -> site.Site:
    """Return a site with a map of its own."""
    return site.build(TABLE, "test", Path())


def rows_of(built: site.Site, unit: int) -> dict[int, Row]:
    """Return the printed rows of a unit by address."""
    return {row.address: row for row in register_map(built).rows if row.unit_id == unit}


def test_the_printed_map_says_type_scale_order_and_what_does_not_fit(built: site.Site) -> None:
    """`map` and `check` show it behind the gateway's own."""
    rows = rows_of(built, MAP)
    assert sorted(rows) == [10, 12, 13, 15]
    assert (rows[10].type_name, rows[10].word_order, rows[10].scale, rows[10].note) == ("float32", "little", "1", "")
    assert (rows[12].type_name, rows[12].scale, rows[12].unit) == ("int16", "0.01", "Hz")
    assert rows[12].note == "04 outside -327.68 to 327.67"
    assert (rows[13].type_name, rows[13].scale, rows[13].unit) == ("int32", "0.333333333", "A")
    assert rows[15].note == ""
    assert rows_of(built, 255)[0x6000].bits[10] == "running"
    assert "| 10 | 000AH | 11 | 400011 | output_frequency" in as_markdown(register_map(built))
    assert "low word first" in as_markdown(register_map(built))


def test_every_printed_entry_is_answered_and_nothing_else(built: site.Site) -> None:
    """The map and the server are of one mind, also beside the command mirror."""
    image = Image(built.drives)
    assert built.config.modbus_tcp is not None
    clock = StandingClock()
    server = ModbusTcpServer(
        built.config.modbus_tcp, image, Stats(0.0), clock, door=Door.of(built, clock)
    )
    units = server._reception.free._units
    assert set(units) == {1, MAP, 255}
    rows = rows_of(built, MAP)
    for address in range(0x10000):
        words = 2 if address in rows and rows[address].is_long else 1
        told = units[MAP].read(address, words, NOW)
        assert (told is not Missing.UNMAPPED) == (address in rows)
    assert units[255].read(0x6000, 1, NOW) is Missing.NOT_FRESH
    assert isinstance(units[255].read(MIRROR_AT, 16, NOW), bytes)


def test_csv_has_the_word_order(built: site.Site) -> None:
    """A column of its own."""
    rows = list(csv.DictReader(io.StringIO(as_csv(register_map(built)), newline="")))
    found = next(row for row in rows if row["unit_id"] == "247" and row["address"] == "10")
    assert (found["type"], found["word_order"]) == ("float32", "little")
    assert {row["word_order"] for row in rows} == {"big", "little"}


MANUAL = (Path(__file__).parents[2] / "docs" / "modbus-tcp.md").read_text(encoding="utf-8")


def test_the_example_of_the_manual_is_right() -> None:
    """It loads, and its first four registers are what the manual says."""
    example = MANUAL.split("## A map of your own\n", 1)[1].split("```toml\n", 1)[1].split("```", 1)[0]
    drives = [{"name": name, "number": i, "model": "vf-nc3"} for i, name in enumerate(("pump-1", "fan-1"), 1)]
    line = {"name": "a", "port": "/dev/ttyUSB0", "drive": drives}
    manual = site.build({**TABLE, **tomllib.loads(example), "line": [line]}, "test", Path())
    rows = rows_of(manual, MAP)
    assert [(at, row.drive, row.type_name) for at, row in rows.items()] == [
        (0, "pump-1", "float32"), (2, "pump-1", "int16"), (3, "pump-1", "uint16"), (4, "fan-1", "int32"),
    ]  # fmt: skip
    assert struct.pack(">f", 60.0).hex() == "42700000"


def test_maps_of_several_units_are_apart() -> None:
    """Each unit answers its own entries only."""
    made = Served(entry("status", 0), entry("trip_code", 0, unit=251))
    made.tell()
    assert made.ask(struct.pack(">BHH", 3, 0, 1), 247) == bytes([3, 2, 0, 3])
    assert made.ask(struct.pack(">BHH", 3, 0, 1), 251) == bytes([3, 2, 0, 1])
