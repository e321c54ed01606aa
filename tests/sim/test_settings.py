from __future__ import annotations

from pathlib import Path

import pytest

from gateway.errors import BadConfig
from gateway.sim.settings import SimulatedLineConfig, build, from_options, load, notes
from gateway.sim.wire import Delivery

EVERYTHING = """\
baud = 38400
parity = "none"
seed = 7
processing_time = "3ms"
eeprom_time = "20ms"
delivery = "character"
link = "/tmp/line"
catalogue = ["own.toml"]

[[drive]]
number = 1
model = "vf-nc3"
capacity = "VFnC3-2015P"
running_at = 25
block_read = [1, 2, 3]
block_write = [1, 3]
registers = { acceleration_time_1 = 50, own_note = 9 }
processing_time = "12ms"
direct_blocks = true
load = 0.3
maximum_frequency = 60
preset_frequencies = [5.0, 10.0]
version = 108

[[drive.fault]]
kind = "drop"
probability = 0.1

[[fault]]
kind = "echo"
"""

OWN = """\
extend = "vf-nc3"

[[register]]
name = "own_note"
address = 0x0990
kind = "parameter"
access = "rw"
storage = "eeprom"
source = "a test"
"""


def test_a_file_with_everything_makes_the_line_that_it_says(tmp_path: Path) -> None:
    """Each key arrives where it acts."""
    (tmp_path / "line.toml").write_text(EVERYTHING)
    (tmp_path / "own.toml").write_text(OWN)
    config = load(tmp_path / "line.toml")
    drive = build(config).drives[0]
    options = drive.inverter.options
    assert config.delivery is Delivery.CHARACTER
    assert drive.hears(38400, "none")
    assert drive.inverter.condition.motor.frequency == 25.0
    assert [drive.inverter.memory.word_in_force(f"block_read_{place}") for place in range(1, 6)] == [1, 2, 3, 0, 0]
    assert [drive.inverter.memory.word_in_force(f"block_write_{place}") for place in (1, 2)] == [1, 3]
    assert drive.registers.read(0x0990) == 9
    assert drive.registers.read(0x0009) == 50
    assert drive.registers.identity() == ("VFnC3-2015P", "0108")
    assert (options.processing, options.eeprom, options.load) == (0.012, 0.020, 0.3)
    assert (options.limits.maximum, options.limits.presets) == (60.0, (5.0, 10.0))
    assert options.accepts_direct_blocks


def test_a_configuration_survives_being_handed_to_another_process() -> None:
    """As JSON and back it is the same."""
    config = from_options(["1:vf-nc3", "5:vf-mb1"], baud=9600)
    assert SimulatedLineConfig.model_validate_json(config.model_dump_json()) == config


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "drive: Field required"),
        ("baud = 1200\n[[drive]]\nnumber = 1\nmodel = 'vf-nc3'", "baud: Input should be 9600, 19200 or 38400"),
        ("[[drive]]\nnumber = 248\nmodel = 'vf-nc3'", r"drive\[0\].number: Input should be less than or"),
        ("[[drive]]\nnumber = 1\nmodel = 'vf-nc3'\ncolour = 1", r"drive\[0\].colour: unknown key"),
        ("processing_time = 5\n[[drive]]\nnumber = 1\nmodel = 'vf-nc3'", "processing_time: a duration in quotes"),
        ("[[drive]]\nnumber = 1\nmodel = 'vf-nc3'\n[[drive.fault]]\nkind = 'gremlin'", r"drive\[0\].fault\[0\].kind"),
        ("number", "not TOML"),
    ],
)
def test_a_wrong_file_is_refused_with_key_and_reason(tmp_path: Path, text: str, reason: str) -> None:
    """The message names the file, the key and what would be right."""
    path = tmp_path / "line.toml"
    path.write_text(text)
    with pytest.raises(BadConfig, match=reason) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_a_file_that_is_not_there_is_said_so(tmp_path: Path) -> None:
    """No traceback for a wrong name."""
    with pytest.raises(BadConfig, match="cannot be read"):
        load(tmp_path / "nothing.toml")


@pytest.mark.parametrize(
    ("drive", "reason"),
    [
        ({"model": "vf-zz9"}, "no model 'vf-zz9'; known: vf-as3, vf-mb1, vf-nc3"),
        ({"capacity": "VFnC3-9999P"}, "no capacity 'VFnC3-9999P'; known: 0: VFnC3-2001P"),
        ({"block_read": [10]}, "no such selection: block_read_1 = 10"),
        ({"registers": {"colour": 1}}, "vf-nc3 has no register colour"),
        ({"model": "vf-as3", "block_read": [1]}, "vf-as3 has 0 selectors for block_read"),
    ],
)
def test_what_the_catalogue_does_not_have_is_refused(drive: dict[str, object], reason: str) -> None:
    """All drives are looked at, and each wrong one is named by its place."""
    config = SimulatedLineConfig.model_validate(
        {"drive": [{"number": 1, "model": "vf-nc3"}, {"number": 2, "model": "vf-nc3", **drive}]}
    )
    with pytest.raises(BadConfig, match=reason) as caught:
        build(config)
    assert str(caught.value).startswith("drive[1]: ")


@pytest.mark.parametrize("option", ["vf-nc3", "one:vf-nc3", ":vf-nc3"])
def test_a_wrong_option_is_refused_with_its_form(option: str) -> None:
    """--drive takes NUMBER:MODEL."""
    with pytest.raises(BadConfig, match="give NUMBER:MODEL"):
        from_options([option])


def test_a_wrong_baud_rate_is_refused() -> None:
    """The drives know three."""
    with pytest.raises(BadConfig, match="9600, 19200, 38400"):
        from_options(["1:vf-nc3"], baud=115200)


@pytest.mark.parametrize(
    ("drives", "note"),
    [
        (["1:vf-nc3", "2:vf-nc3", "1:vf-mb1"], "1 is the number of more than one drive: their answers collide"),
        (["0:vf-nc3"], "drive 0 speaks MODBUS-RTU, where 0 is for all: it obeys, and answers nothing"),
        (["100:vf-mb1:toshiba"], "drive 100 speaks TOSHIBA, where numbers end at 99 (ASCII) and 63 (binary)"),
    ],
)
def test_what_is_seldom_meant_is_noted(drives: list[str], note: str) -> None:
    """It can be simulated, and is worth a word."""
    assert list(notes(from_options(drives))) == [note]


def test_what_is_usual_is_not_noted() -> None:
    """Number 0 and 99 are usual with TOSHIBA, 247 is with MODBUS-RTU."""
    assert list(notes(from_options(["0:vf-nc3:toshiba", "99:vf-mb1:toshiba", "247:vf-nc3"]))) == []
