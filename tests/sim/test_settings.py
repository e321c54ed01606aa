from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from gateway.errors import BadConfig
from gateway.sim.settings import SimulatedLineConfig, build, from_options, install, load, notes
from gateway.sim.state import state
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
    table = tomllib.loads(EVERYTHING) | {"catalogue": []}
    table["drive"][0] |= {"registers": {}, "name": "pump"}
    table["event"] = [
        {"at": ["1s", "2s"], "every": "300ms", "do": "babble", "bytes": [1, 8]},
        {"after_exchanges": 3, "do": "set", "drive": "pump", "register": "free_notes", "value": 1},
        {"at": "1s", "do": "fault", "drive": 1, "kind": "late", "value": [0.1, 0.2], "until": "5s"},
    ]
    config = SimulatedLineConfig.model_validate(table)
    assert SimulatedLineConfig.model_validate_json(config.model_dump_json(by_alias=True)) == config


ONE = "[[drive]]\nnumber = 1\nmodel = 'vf-nc3'\n"
EVENT = "[[event]]\ndo = 'babble'\n"


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
        (ONE + "name = '5th'", r"drive\[0\].name: String should match"),
        (ONE + "name = 'x'\n" + ONE + "name = 'x'", "the name of one drive only: x"),
        (ONE + "protocol = 'profibus'", r"drive\[0\].protocol: Input should be 'modbus-rtu' or 'toshiba'"),
        (ONE + "[[drive.fault]]\nkind = 'echo'", r"drive\[0\]: fault\[0\]: echo is a fault of the line"),
        (ONE + "[[fault]]\nkind = 'cut'\nvalue = 1", r"fault\[0\]: cut takes no value"),
        (ONE + "[[fault]]\nkind = 'flip'\nvalue = 1.5", r"fault\[0\]: the value of flip counts bits"),
        (
            ONE + "[[fault]]\nkind = 'flip'\nvalue = [1, 2, 3]",
            r"fault\[0\].value: a number from 0 to 65535 is wanted",
        ),
        (ONE + "[[fault]]\nkind = 'cut'\nafter = '2s'\nuntil = '1s'", r"fault\[0\]: until is to be later"),
        (ONE + EVENT, r"event\[0\]: it does not say when: at = "),
        (ONE + EVENT + "at = 5", r"event\[0\].at: a duration in quotes is wanted"),
        (ONE + EVENT + "at = ['1s']", r"event\[0\].at: a duration is wanted, or two between which one is drawn"),
        (ONE + EVENT + "at = ['2s', '1s']", r"event\[0\].at: of two durations the shorter one stands first"),
        (ONE + EVENT + "every = '1s'\nevery_exchanges = 5", r"event\[0\]: every and every_exchanges exclude"),
        (ONE + EVENT + "every = '0s'", r"event\[0\]: every is to be \"1ms\" or longer"),
        (ONE + EVENT + "at = '1s'\ntimes = 3", r"event\[0\]: times belongs to every or every_exchanges"),
        (ONE + EVENT + "at = '1s'\nnumber = 3", r"event\[0\].number: unknown key"),
        (ONE + "[[event]]\nat = '1s'", r"event\[0\].do: missing"),
        (ONE + "[[event]]\nat = '1s'\ndo = 'dance'", r"event\[0\].do: no such doing 'dance'; known: trip, alarm, "),
        (ONE + "[[event]]\nat = '1s'\ndo = 'stats'", r"event\[0\].do: no such doing 'stats'"),
        (ONE + "[[event]]\nat = '1s'\ndo = 'trip'\ndrive = 1\ncode = 300", r"event\[0\].code: Input should be less"),
        (ONE + "[[event]]\nat = '1s'\ndo = 'trip'\ndrive = 9\ncode = 3", r"event\[0\].drive: no drive 9; .*: 1$"),
        ("event = 3\n" + ONE, "event: Input should be a valid list"),
        ("event = [3]\n" + ONE, r"event\[0\]: Input should be a valid"),
    ],
)
def test_a_wrong_file_is_refused_with_key_and_reason(tmp_path: Path, text: str, reason: str) -> None:
    """The message names the file, the key and what would be right."""
    path = tmp_path / "line.toml"
    path.write_text(text)
    with pytest.raises(BadConfig, match=reason) as caught:
        load(path)
    assert str(path) in str(caught.value)


def test_all_that_is_wrong_is_said_at_once(tmp_path: Path) -> None:
    """A line for each key."""
    (tmp_path / "line.toml").write_text(ONE + "colour = 1\n[[fault]]\nkind = 'x'\n" + EVENT + "at = 1")
    with pytest.raises(BadConfig) as caught:
        load(tmp_path / "line.toml")
    assert [line.split(": ")[1] for line in str(caught.value).splitlines()] == [
        "drive[0].colour",
        "fault[0].kind",
        "event[0].at",
    ]


def test_an_event_may_name_a_drive_by_a_number_that_it_will_have(tmp_path: Path) -> None:
    """Another event gives it."""
    renumber = "[[event]]\nat = '1s'\ndo = 'renumber'\ndrive = 1\nnumber = 9\n"
    trip = "[[event]]\nat = '2s'\ndo = 'trip'\ndrive = 9\ncode = 1\n"
    (tmp_path / "line.toml").write_text(ONE + renumber + trip)
    assert len(load(tmp_path / "line.toml").event) == 2


@pytest.mark.parametrize("do", ["set", "force"])
def test_an_event_names_a_register_that_its_drive_has(do: str) -> None:
    """Found when the line is made, not when the event comes."""
    event = {"at": "1h", "do": do, "drive": 1, "register": "colour", "value": 1}
    config = SimulatedLineConfig.model_validate({"drive": [{"number": 1, "model": "vf-nc3"}], "event": [event]})
    with pytest.raises(BadConfig, match=r"event\[0\].register: vf-nc3 has no register 'colour'; see: tosvert"):
        build(config)


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
        (
            {"registers": {"led_selection": 3, "number": 300}},
            r"registers: led_selection takes 0 to 2 \(given: 3\); number",
        ),
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


@pytest.mark.parametrize(
    "option", ["vf-nc3", "one:vf-nc3", ":vf-nc3", "1:", "1:vf-nc3:", "1:vf-nc3:toshiba:x", "²:x"]
)
def test_a_wrong_option_is_refused_with_its_form(option: str) -> None:
    """--drive takes NUMBER:MODEL, and a protocol behind it."""
    with pytest.raises(BadConfig, match=r"give NUMBER:MODEL\[:PROTOCOL\]"):
        from_options([option])


def test_options_may_name_a_protocol() -> None:
    """Drives of both protocols on one line, and number 0."""
    config = from_options(["1:vf-nc3", "0:vf-mb1:toshiba", "2:vf-nc3:modbus-rtu"])
    assert [drive.protocol for drive in build(config).drives] == [1, 0, 1]  # F829
    with pytest.raises(
        BadConfig, match="--drive 1:vf-nc3:profibus: no protocol 'profibus'; known: modbus-rtu, toshiba"
    ):
        from_options(["1:vf-nc3:profibus"])


@pytest.mark.parametrize(("of_line", "of_drive", "spoken"), [
    (None, None, "modbus-rtu"),
    ("toshiba", None, "toshiba"),
    ("toshiba", "modbus-rtu", "modbus-rtu"),
    (None, "toshiba", "toshiba"),
])  # fmt: skip
@pytest.mark.parametrize("model", ["vf-nc3", "vf-mb1", "vf-as3"])
def test_a_drive_speaks_its_own_protocol_or_the_line_s(
    of_line: str | None, of_drive: str | None, spoken: str, model: str
) -> None:
    """Each model, whether it has a parameter for it or not."""
    section = {"number": 5, "model": model} | ({"protocol": of_drive} if of_drive else {})
    table = {"drive": [section]} | ({"protocol": of_line} if of_line else {})
    station = install(SimulatedLineConfig.model_validate(table), 0.0)
    assert state(station.drive(5, 0.0), None, 0.0)["protocol"] == spoken


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
