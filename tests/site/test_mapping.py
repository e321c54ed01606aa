"""What is wrong in fact with a user-defined map is said before anything runs: all at once, with key and remedy."""

from __future__ import annotations

from typing import Any

import pytest

from tests.config.test_config import build, errors, table

ENTRY: dict[str, Any] = {"point": "pump-1.output_frequency", "address": 0}
AMPS = "pump-1.output_current_amps"


def mapped(*entries: dict[str, Any], **section: Any) -> dict[str, Any]:
    """Return a configuration with these entries, each of which is right but for what it says."""
    made = table()
    made["modbus_tcp"] |= {"map": [{**ENTRY, **each} for each in entries], **section}
    return made


def test_a_right_map_is_taken() -> None:
    """Drives of either line of the file, computed values, every type, units that repeat addresses."""
    built = build(
        mapped(
            {"type": "word"},
            {"address": 1, "type": "float32", "word_order": "little", "scale": 0.5},
            {"address": 3, "point": AMPS, "type": "int32", "scale": 100},
            {"address": 0xFFFF, "point": "pump-2.status"},
            {"address": 0, "unit": 251, "type": "uint32", "scale": 1000},
            {"address": 0x6000, "unit": 255, "type": "signed"},
            {"address": 0x7FFF, "unit": 255},
        )
    )
    section = built.config.modbus_tcp
    assert section is not None
    assert [section.unit_of(entry) for entry in section.map] == [247, 247, 247, 247, 251, 255, 255]
    assert (section.map[2].drive, section.map[2].value) == ("pump-1", "output_current_amps")


@pytest.mark.hazard("H34")
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"point": "pump-1"}, "modbus_tcp.map[0].point"),
        ({"point": "pump-3.status"}, "modbus_tcp.map[0].point: no drive 'pump-3'; did you mean"),
        ({"point": "x.status"}, "no drive 'x'; known: pump-1, pump-2"),
        ({"point": "pump-1.output_freqency"}, "no value 'output_freqency'; did you mean 'output_frequency'?"),
        ({"point": "pump-1.torque"}, "point: 'torque' is not read from pump-1: add it to a poll"),
        ({"point": "pump-1.output_voltage_volts", "type": "signed"}, "is not read from pump-1"),
        ({"point": AMPS}, "map[0].type: 'output_current_amps' is computed and has no word: take signed"),
        ({"type": "float64"}, "'word', 'signed', 'int32', 'uint32' or 'float32'"),
        ({"type": "signed", "scale": 1e6, "point": "pump-1.status"}, "fits signed as 0 only: take a smaller"),
        ({"type": "signed", "scale": 1e-6}, "is always 0: take a larger scale, or float32"),
        ({"type": "signed", "scale": 0.0}, "modbus_tcp.map[0].scale"),
        ({"scale": 2.0}, 'scale: a "word" is as the drive has it'),
        ({"type": "signed", "word_order": "big"}, 'word_order: "signed" is one word'),
        ({"word_order": "middle", "type": "int32"}, "'big' or 'little'"),
        ({"address": 0x10000}, "less than or equal to 65535"),
        ({"address": 0xFFFF, "type": "int32"}, "address: int32 takes two registers, and FFFFH is the last one"),
        ({"unit": 0}, "modbus_tcp.map[0].unit"),
        ({"unit": 2}, "map[0].unit: unit 2 is that of drive 'pump-2'; give modbus_tcp.map[0]"),
        ({"unit": 255}, "address: 0000H of unit 255 is kept for the gateway's own registers; 6000H to 7FFFH"),
        ({"unit": 255, "address": 0x8000}, "8000H of unit 255 is kept"),
        ({"unit": 255, "address": 0x7FFF, "type": "float32"}, "8000H of unit 255 is kept"),
        ({"unit": 255, "address": 0xE000}, "E000H of unit 255 is kept"),
        ({"unit": 255, "address": 0xF000}, "F000H of unit 255 is kept"),
        ({"adress": 1}, "modbus_tcp.map[0].adress: unknown key; did you mean 'address'?"),
    ],
)
def test_a_wrong_entry_is_named_with_what_would_be_right(wrong: dict[str, Any], said: str) -> None:
    """One line, and only one."""
    lines = errors(mapped(wrong))
    assert len(lines) == 1, lines
    assert said in lines[0]


def test_a_value_that_may_be_negative_is_no_uint32() -> None:
    """The catalogue knows which they are."""
    wrong = mapped({"point": "pump-1.torque", "type": "uint32"})
    wrong["line"][0]["drive"][0]["poll"].append({"values": ["torque"], "every": "1s"})
    (line,) = errors(wrong)
    assert "modbus_tcp.map[0].type: 'torque' may be negative: take int32" in line


def test_the_unit_of_all_entries_may_not_be_a_drives() -> None:
    """The key that is to be changed is named."""
    (line,) = errors(mapped({}, map_unit=1))
    assert "modbus_tcp.map_unit: unit 1 is that of drive 'pump-1'" in line


@pytest.mark.parametrize(
    ("first", "second", "at"),
    [
        ({}, {"point": "pump-1.status"}, "0000H"),
        ({"type": "float32"}, {"point": "pump-1.status", "address": 1}, "0001H"),
        ({"address": 1}, {"point": "pump-1.status", "address": 0, "type": "int32"}, "0001H"),
        ({"type": "float32"}, {"point": "pump-1.status", "type": "int32", "unit": 247}, "0000H"),
    ],
)
def test_overlapping_entries_are_both_named(first: dict[str, Any], second: dict[str, Any], at: str) -> None:
    """Once a pair, with the first register that both take."""
    (line,) = errors(mapped(first, second))
    assert "modbus_tcp.map[1] (pump-1.status) and modbus_tcp.map[0] (pump-1.output_frequency) both take" in line
    assert f"both take {at} of unit 247" in line


@pytest.mark.hazard("H34")
def test_all_errors_of_a_map_are_told_at_once() -> None:
    """Also beside errors elsewhere; a drive that is wrong in itself is no unknown drive."""
    wrong = mapped({"point": "x.status"}, {"type": "int"}, {"unit": 2}, {"point": "pump-2.status", "address": 7})
    wrong["line"][0]["drive"][1]["number"] = "2"
    lines = errors(wrong)
    assert [sum(f"map[{i}]" in line for line in lines) for i in range(4)] == [1, 1, 0, 0]
    assert any("number" in line for line in lines)


@pytest.mark.parametrize("map_", ["x", {"a": 1}, [1], [[]]])
def test_what_is_no_list_of_tables_is_told_by_its_form_alone(map_: Any) -> None:
    """The check of facts passes over it."""
    wrong = table()
    wrong["modbus_tcp"]["map"] = map_
    assert all("modbus_tcp.map" in line for line in errors(wrong))
