"""A wrong catalogue file is refused, with file, key and reason."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gateway.drives.catalogue import load
from gateway.errors import BadConfig
from tests.drives.files import REGISTER, WHOLE_MODEL, written

EXTEND = 'extend = "vf-nc3"\n'
DERIVED = '[[derived]]\nname = "a"\nof = "torque"\nbase = "torque"\nunit = "A"\nsource = "x"'


def refusal(folder: Path, text: str) -> list[str]:
    """Return what is said of a wrong file, line by line, each without the file's name that it begins with."""
    path = written(folder, text)
    with pytest.raises(BadConfig) as caught:
        load([path])
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    return [line.removeprefix(f"{path}: ") for line in lines]


@pytest.mark.hazard("H34")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        # of the file
        ("", 'model, extend: give one of them: [model] (a whole model) or extend = "model-name"'),
        (EXTEND + WHOLE_MODEL, 'model, extend: give one of them: [model] (a whole model) or extend = "model-name"'),
        ('extend = "vf-none"', "extend: no model 'vf-none'; known: vf-as3, vf-mb1, vf-nc3"),
        ('extend = "VF nC3"', "extend: a name of a-z, 0-9 and -, a letter first, is wanted (given: 'VF nC3')"),
        (
            WHOLE_MODEL.replace('"vf-x"', '"vf-nc3"'),
            "model.name: 'vf-nc3' exists already; to add to it: extend = 'vf-nc3'",
        ),
        ("registers = []\n" + EXTEND, "registers: no such key"),
        (EXTEND + "register = 3", "register: Input should be a valid list (given: 3)"),
        (EXTEND + "[times]\nprocessing = 1.0", "times.source: is missing"),
        (
            EXTEND + '[times]\nprocessing = -1.0\nsource = "x"',
            "times.processing: Input should be greater than 0 (given: -1.0)",
        ),
        # of one entry's form
        (EXTEND + REGISTER + "colour = 1", "register 'extra': colour: no such key"),
        (EXTEND + REGISTER.replace('source = "somewhere"', ""), "register 'extra': source: is missing"),
        (EXTEND + REGISTER.replace("0x0777", "0x10000"), "register 'extra': address: Input should be less than"),
        (EXTEND + REGISTER.replace("0x0777", '"0777"'), "register 'extra': address: Input should be a valid int"),
        (EXTEND + REGISTER.replace('"parameter"', '"knob"'), "register 'extra': kind: Input should be 'command', "),
        (
            EXTEND + REGISTER.replace('"extra"', '"Extra Value"'),
            "register 'Extra Value': name: a name of a-z, 0-9 and _, a letter first, is wanted",
        ),
        (EXTEND + REGISTER.replace('name = "extra"', ""), "register 1: name: is missing"),
        (
            EXTEND + REGISTER + 'scale = "1/100"',
            "register 'extra': scale: a positive number in quotes, as \"0.01\", is wanted (given: '1/100')",
        ),
        (EXTEND + REGISTER + "scale = 0.01", "register 'extra': scale: Input should be a valid string (given: 0.01)"),
        (EXTEND + REGISTER + "signed = 1", "register 'extra': signed: Input should be a valid boolean (given: 1)"),
        (EXTEND + REGISTER + 'access = "w"', "register 'extra': access: Input should be 'r' or 'rw' (given: 'w')"),
        (EXTEND + REGISTER + 'storage = "disk"', "register 'extra': storage: Input should be 'ram', 'eeprom' or"),
        (EXTEND + REGISTER + "range = [1, 2, 3]", "register 'extra': range: Tuple should have at most 2 items"),
        (EXTEND + REGISTER + 'range = ["1", 2]', "register 'extra': range.0: Input should be a valid integer"),
        (
            EXTEND + REGISTER + 'bits = { 16 = "x" }',
            "register 'extra': bits.16: a bit from 0 to 15 is wanted (given: '16')",
        ),
        (
            EXTEND + REGISTER + 'values = { 0x10 = "x" }',
            "register 'extra': values.0x10: a decimal number is wanted (given: '0x10')",
        ),
        (
            EXTEND + "[capacities]\n70000 = 'x'",
            "capacities.70000: a code of one word is wanted: at most 65535 (given: '70000')",
        ),
        # of one entry's sense
        (EXTEND + REGISTER + 'scale = "0.0"', "register 'extra': scale: must not be 0"),
        (
            EXTEND + REGISTER + "range = [5, 4]",
            "register 'extra': range: two raw values from 0 to 65535, the lower one first (given: [5, 4])",
        ),
        (
            EXTEND + REGISTER + "range = [-1, 4]",
            "register 'extra': range: two raw values from 0 to 65535, the lower one first (given: [-1, 4])",
        ),
        (
            EXTEND + REGISTER + "signed = true\nrange = [0, 40000]",
            "register 'extra': range: two raw values from -32768 to 32767, the lower one first (given: [0, 40000])",
        ),
        (
            EXTEND + REGISTER + "range = [2, 4]\ninitial = 1",
            "register 'extra': initial: 1 is outside 2 to 4",
        ),
        (
            EXTEND + REGISTER + 'range = [0, 1]\nvalues = { 2 = "x" }',
            "register 'extra': values.2: is outside 0 to 1",
        ),
        (
            EXTEND + REGISTER + 'access = "rw"',
            'register \'extra\': storage: a writable register needs "ram" or "eeprom"',
        ),
        (
            EXTEND + REGISTER + 'storage = "eeprom"',
            "register 'extra': storage: a read-only register stores nothing: leave it out",
        ),
        (
            EXTEND + REGISTER + 'takes_effect = "after reset"',
            "register 'extra': takes_effect: a read-only register is not written: leave it out",
        ),
        (
            EXTEND + REGISTER + "writable_while_running = false",
            "register 'extra': writable_while_running: a read-only register is not written: leave it out",
        ),
        (
            EXTEND + REGISTER + 'access = "rw"\nstorage = "ram"\nheld = 0xFE99',
            "register 'extra': held: a drive holds what it monitors, not what is written to it",
        ),
        (
            EXTEND + REGISTER + 'bits = { 0 = "x", 1 = "x" }',
            "register 'extra': bits: two bits have the same name",
        ),
        (
            EXTEND + REGISTER + 'bits = { 0 = "x" }\nvalues = { 0 = "x" }',
            "register 'extra': bits, values, enumeration: give one of them",
        ),
        (EXTEND + REGISTER + 'unit = "V"\nbits = { 0 = "x" }', "register 'extra': unit: bits and codes have none"),
        (
            EXTEND + REGISTER + 'enumeration = "colours"',
            "register 'extra': enumeration: no table [enumeration.colours]",
        ),
        # of entries against each other
        (
            EXTEND + REGISTER + REGISTER.replace("0x0777", "0x0778"),
            "register 'extra': name: it stands twice in this file",
        ),
        (
            EXTEND + REGISTER.replace('"extra"', '"status"'),
            "register 'status': name: it exists already; replaces = true puts this entry in its place",
        ),
        (
            EXTEND + REGISTER + "replaces = true",
            "register 'extra': replaces: there is no such register to replace",
        ),
        (EXTEND + REGISTER.replace("0x0777", "0xFD01"), "register 'extra': address: FD01H is 'status' already"),
        (
            EXTEND + REGISTER + "held = 0xFE01",
            "register 'trip_extra': address: FE01H is 'trip_status' already",
        ),
        (EXTEND + REGISTER + 'maximum_from = "fh"', "register 'extra': maximum_from: no register 'fh'"),
        (EXTEND + REGISTER + 'minimum_from = "ll"', "register 'extra': minimum_from: no register 'll'"),
        (EXTEND + '[read_selectors]\n10 = "nothing"', "read_selectors.10: no register 'nothing'"),
        (EXTEND + '[write_selectors]\n6 = "nothing"', "write_selectors.6: no register 'nothing'"),
        (
            EXTEND + '[enumeration.trip_code]\n24 = { text = "x" }',
            "enumeration.trip_code.24: the code exists already",
        ),
        (EXTEND + '[[profile]]\nvalues = ["nothing"]\nevery = "1s"', "profile '1s': values: no register 'nothing'"),
        (EXTEND + '[[profile]]\nvalues = []\nevery = "1s"', "profile 1: values: List should have at least 1 item"),
        (
            EXTEND + '[[profile]]\nvalues = ["status"]\nevery = "soon"',
            'profile 1: every: a duration, as "200ms" or "5min", is wanted (given: \'soon\')',
        ),
        (EXTEND + '[cautions]\nnever = [7]', "cautions.source: is missing"),
        (EXTEND + '[cautions]\nkeys = ["nothing"]\nsource = "x"', "cautions: keys: no register 'nothing'"),
        (EXTEND + '[cautions]\nmay_start = ["x"]\nsource = "x"', "cautions: may_start: no register 'x'"),
        (EXTEND + '[cautions]\nunanswered = { x = "y" }\nsource = "x"', "cautions: unanswered: no register 'x'"),
        (
            EXTEND + '[cautions]\nunanswered = { command = "y" }\nsource = "x"',
            "cautions: unanswered.command: the register has no bit 'y'",
        ),
        (
            EXTEND + '[[connector]]\nname = "rs485"\nparameters = {}\nsource = "x"',
            "connector 'rs485': the name exists already",
        ),
        (
            EXTEND + '[[connector]]\nname = "b"\nparameters = { number = "nothing" }\nsource = "x"',
            "connector 'b': parameters.number: no register 'nothing'",
        ),
        (
            EXTEND + '[[connector]]\nname = "b"\nparameters = { speed = "status" }\nsource = "x"',
            "connector 'b': parameters.speed: Input should be 'baud_rate', 'parity'",
        ),
        (
            EXTEND + '[[connector]]\nname = "b"\nparameters = {}\nblock_read = ["block_read_1"]\nsource = "x"',
            "connector 'b': block_read: 1 selectors for a block of 5 words",
        ),
        (
            EXTEND + DERIVED.replace('of = "torque"', 'of = "nothing"'),
            "derived 'a': of: no register 'nothing'",
        ),
        (
            EXTEND + DERIVED.replace('"a"', '"status"'),
            "derived 'status': a register has this name",
        ),
        (
            EXTEND + DERIVED.replace('"a"', '"output_current_amps"'),
            "derived 'output_current_amps': the name exists already",
        ),
    ],
)
def test_a_wrong_entry_is_refused_with_file_key_and_reason(tmp_path: Path, text: str, said: str) -> None:
    """One thing is wrong, and it is said, with the place where it stands."""
    assert any(line.startswith(said) for line in refusal(tmp_path, text)), refusal(tmp_path, text)


@pytest.mark.hazard("H34")
def test_all_that_is_wrong_is_said_at_once(tmp_path: Path) -> None:
    """Two entries, three mistakes, three lines."""
    text = EXTEND + REGISTER + 'scale = "0"\nmaximum_from = "fh"' + REGISTER.replace("extra", "other")
    assert refusal(tmp_path, text) == [
        "register 'extra': scale: must not be 0",
        "register 'other': address: 0777H is 'extra' already",
        "register 'extra': maximum_from: no register 'fh'",
    ]


@pytest.mark.hazard("H34")
@pytest.mark.parametrize("text", ["= 3", 'extend = "a"\nextend = "b"', "a = "])
def test_what_is_not_toml_is_refused_with_its_place(tmp_path: Path, text: str) -> None:
    """The parser's own words say where in the file it is."""
    (line,) = refusal(tmp_path, text)
    assert re.match(r"not TOML: .* \(at (line \d+, column \d+|end of document)\)$", line)


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    """Missing, a folder, or not UTF-8."""
    latin = tmp_path / "latin.toml"
    latin.write_bytes(b'extend = "\xe9"')
    for path in (tmp_path / "missing.toml", tmp_path, latin):
        with pytest.raises(BadConfig, match=f"^{re.escape(str(path))}: cannot be read: "):
            load([path])
