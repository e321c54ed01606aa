"""The configuration: what is accepted, and that every error is named at once with its key and a remedy."""

from __future__ import annotations

import copy
import tomllib
from pathlib import Path
from typing import Any

import pytest

from gateway import config, site
from gateway.config import Secret
from gateway.errors import BadConfig

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "config").glob("*.toml"))

GOOD = """
[gateway]
name = "hall-3"
[mqtt]
url = "mqtt://127.0.0.1:1883"
base = "tosvert"
[modbus_tcp]
listen = "127.0.0.1:5020"
[web]
listen = "127.0.0.1:8080"
[[line]]
name = "a"
port = "/dev/ttyUSB0"
baud = 19200
parity = "even"
[[line.drive]]
name = "pump-1"
number = 1
model = "vf-nc3"
protocol = "modbus-rtu"
unit = 1
poll = [{ values = ["status", "output_frequency", "output_current"], every = "100ms" },
        { values = ["trip_code", "cumulative_operation_time"], every = "10s" }]
[[line.drive]]
name = "pump-2"
number = 2
model = "vf-mb1"
"""


def table() -> dict[str, Any]:
    """Return a fresh copy of a right configuration."""
    return copy.deepcopy(tomllib.loads(GOOD))


def build(wrong: dict[str, Any]) -> site.Site:
    """Build a site from a table."""
    return site.build(wrong, "gateway.toml", Path())


def errors(wrong: dict[str, Any]) -> list[str]:
    """Return the lines of what is wrong with a table."""
    with pytest.raises(BadConfig) as caught:
        build(wrong)
    return str(caught.value).splitlines()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_the_shipped_examples_are_right(path: Path) -> None:
    """Every example in config/ loads."""
    assert site.load(path).drives


def test_the_example_of_everything_names_every_key() -> None:
    """A key that is added is added there too."""
    shown = (ROOT / "config" / "everything.toml").read_text()
    for section in (
        config.GatewaySection, config.LogSection, config.MqttSection, config.SparkplugSection, config.TlsSection,
        config.ModbusTcpSection, config.WebSection, config.LineSection, config.DriveSection, config.PollSection,
        config.StoreSection, config.StoredWritesSection, config.FrequencySection, config.RightSection,
        config.TraceSection, config.FilterSection, config.MapSection, config.HomeAssistantSection,
        config.ModbusTlsSection, config.ModbusRtuSection, config.ReservedSection, config.TcpRightSection,
    ):
        for key in section.model_fields:
            assert any(form in shown for form in (f"{key} =", f"[{key}]", f".{key}]", f"[[{key}]]")), key


def test_a_right_configuration_becomes_lines_drives_groups_and_points() -> None:
    """Periods in seconds, registers from the catalogue, the model's profile where nothing is asked."""
    built = build(table())
    first, second = built.drives
    assert [group.period for group in first.groups] == [0.1, 10.0]
    asked = ["status", "output_frequency", "output_current", "trip_code", "cumulative_operation_time"]
    assert list(first.points) == asked
    assert first.points["status"].max_age == 1.0
    assert second.unit == 2
    assert set(second.points) >= {"status", "output_frequency", "alarm"}


def test_derived_values_stand_for_their_registers() -> None:
    """Asking for amperes reads the percentage and its base."""
    wanted = table()
    wanted["line"][0]["drive"][0]["poll"] = [{"values": ["output_current_amps"], "every": "1s"}]
    drive = build(wanted).drives[0]
    assert list(drive.points) == ["output_current"]
    assert [register.name for register in drive.bases] == ["rated_current"]


def wrong_at(*keys: Any, value: Any) -> dict[str, Any]:
    """Return a configuration with one value changed."""
    changed = table()
    node: Any = changed
    for key in keys[:-1]:
        node = node[key]
    node[keys[-1]] = value
    return changed


DRIVE = ("line", 0, "drive", 0)


@pytest.mark.hazard("H34")
@pytest.mark.parametrize(
    ("keys", "value", "said"),
    [
        ((*DRIVE, "nubmer"), 1, "line[0].drive[0].nubmer (a) (pump-1): unknown key; did you mean 'number'?"),
        (("gateway", "colour"), 1, "gateway.colour: unknown key; known: catalogue"),
        (("line", 0, "baud"), 115200, "line[0].baud (a): Input should be 9600, 19200 or 38400"),
        (("line", 0, "parity"), "mark", "'even', 'odd' or 'none'"),
        (("line", 0, "port"), "ttyUSB0", 'give the whole path: "/dev/ttyUSB0"'),
        (("line", 0, "port"), "telnet://x:1", '"socket://10.0.0.7:4001", "rfc2217://10.0.0.7:4001"'),
        (("line", 0, "port"), "rfc2217://10.0.0.7", 'an address and a port are wanted: "rfc2217://10.0.0.7:4001"'),
        (("line", 0, "probe_at_most"), "500ms", "probe_at_most 0.5 s is shorter than probe_every: give 1 s or more"),
        (("line", 0, "rs485"), "yes", "'auto', 'kernel', 'rts' or 'off'"),
        (("line", 0, "local_echo"), True, "'auto', 'on' or 'off'"),
        (("line", 0, "rts_on_send"), False, 'line[0] (a): rts_on_send: only with rs485 = "kernel" or "rts"'),
        (("line", 0, "port"), "socket://10.0.0.7", "an address and a port are wanted"),
        ((*DRIVE, "number"), 0, "line[0].drive[0] (pump-1).number: modbus-rtu has the numbers 1 to 247"),
        ((*DRIVE, "number"), -1, "line[0].drive[0].number (a) (pump-1)"),
        (("line", 0, "group"), [{"name": "g", "drives": ["pump-9"]}], "no drive 'pump-9' on this line; known: pump"),
        (("line", 0, "group"), [{"name": "g", "drives": ["pump-1", "pump-1"]}], "named more than once"),
        (("line", 0, "group"), [{"name": "g", "drives": ["pump-1"]}] * 2, "group name 'g' is taken by"),
        (("line", 0, "group"), [{"name": "g", "drives": [{"name": "pump-1"}]}], "drives[0]"),
        ((*DRIVE, "number"), 2, "MODBUS-RTU number on line a 2 is taken by"),
        ((*DRIVE, "number"), "1", "valid integer"),
        ((*DRIVE, "unit"), 255, "less than or equal to 247"),
        ((*DRIVE, "unit"), 2, "is taken by"),
        ((*DRIVE, "name"), "pump-2", "drive name 'pump-2' is taken by line[0].drive[0]"),
        ((*DRIVE, "name"), "pump/1", "line[0].drive[0].name"),
        ((*DRIVE, "model"), "vf-nc9", "no model 'vf-nc9'; known: vf-as3, vf-mb1, vf-nc3"),
        ((*DRIVE, "protocol"), "modbus-ascii", "modbus-rtu"),
        ((*DRIVE, "poll"), [{"values": ["output_freqency"], "every": "1s"}], "did you mean 'output_frequency'?"),
        ((*DRIVE, "poll"), [{"values": ["status"], "every": 5}], '"100ms", "2s", "5min" or "1h"'),
        ((*DRIVE, "poll"), [{"values": [], "every": "1s"}], "at least 1 item"),
        ((*DRIVE, "deadband"), {"speed": 1.0}, "deadband: vf-nc3 has no value 'speed'"),
        ((*DRIVE, "deadband"), {"output_current": -1.0}, "greater than or equal to 0"),
        (("mqtt", "deadband"), {"output_frequenzy": 1.0}, "did you mean 'output_frequency'?"),
        (("line", 0, "port"), "/dev/\0", "NUL"),
        (("mqtt", "url"), "127.0.0.1", "mqtt://host:1883"),
        (("mqtt", "url"), "mqtt://me:secret@host:1883", "user and password do not belong into the URL"),
        (("mqtt", "password"), "geheim", "mqtt.password"),
        (("mqtt", "password"), {"env": "A"}, "password without user"),
        (("mqtt", "tls"), {"ca": "x"}, "not mqtts://"),
        (("mqtt", "base"), "a/#", "mqtt.base"),
        (("modbus_tcp", "listen"), "5020", "127.0.0.1:5020"),
        (("modbus_tcp", "listen"), "off", "nobody is served"),
        (("modbus_tcp", "allow"), ["10.0.0.1/8"], '"10.0.0.0/8" is meant?'),
        (("modbus_tcp", "allow"), ["::ffff:10.0.0.0/104"], 'by their IPv4 address: "10.0.0.0/8"'),
        (("modbus_tcp", "allow"), ["plc-1"], "an address or a network is wanted"),
        (("modbus_tcp", "allow"), [], "at least 1 item"),
        (("modbus_tcp", "reserved"), [{"addresses": ["::1"], "places": 33}], "33 places are kept"),
        (("modbus_tcp", "tls"), {"ca": "x"}, "modbus_tcp.tls.certificate: is missing"),
        (("modbus_tcp", "right"), [{"role": "viewer"}], "a role is told by certificates only"),
        (("modbus_tcp", "right"), [{"units": [256]}], "modbus_tcp.right[0].units[0]: 0 to 255 are possible"),
        (("modbus_tcp", "right"), [{"registers": [[2, 1]]}], "a number or [first, last] is wanted"),
        (("modbus_tcp", "right"), [{"registers": ["FA00"]}], "a number or [first, last] is wanted"),
        (("modbus_tcp", "right"), [{"functions": ["reed"]}], 'a function is wanted: "read", "write", 3, 4'),
        (("modbus_tcp", "right"), [{"functions": [5]}], "a function is wanted"),
        (("line",), [], "line"),
        (("gateway", "catalogue"), ["nowhere.toml"], "nowhere.toml: cannot be read"),
    ],
)
def test_a_wrong_value_is_named_with_its_key_and_what_would_be_right(
    keys: tuple[Any, ...], value: Any, said: str
) -> None:
    """One line says it, and it begins with the file."""
    lines = errors(wrong_at(*keys, value=value))
    assert any(said in line for line in lines), lines
    assert all(line.startswith("gateway.toml: ") for line in lines)


@pytest.mark.hazard("H34")
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ({"port": "socket://10.0.0.7:4001", "rs485": "rts"}, 'rs485 = "rts" is for serial devices'),
        ({"rs485": "kernel", "rts_delay_before": "1.5ms"}, "rts_delay_before: the kernel counts whole milliseconds"),
        ({"rs485": "rts", "rts_delay_after": "3ms"}, "rts_delay_after 3 ms cuts off answers, which begin 2.01 ms"),
        ({"rs485": "off", "rts_delay_after": "1ms", "rts_on_send": True}, "rts_on_send and rts_delay_after: only"),
    ],
)
def test_settings_of_rts_that_do_nothing_or_spoil_answers_are_refused(line: dict[str, Any], said: str) -> None:
    """What the operator asked for is done or refused, never passed over."""
    wrong = table()
    wrong["line"][0] |= line
    assert any(said in each for each in errors(wrong)), errors(wrong)


def test_two_lines_cannot_share_a_serial_server() -> None:
    """Whatever is spoken there: two masters on one line cannot work."""
    wrong = table()
    wrong["line"][0]["port"] = "socket://Server:4001"
    second = copy.deepcopy(wrong["line"][0]) | {"name": "b", "port": "rfc2217://server:4001"}
    second["drive"][0] |= {"name": "pump-2", "number": 2}
    wrong["line"] = [wrong["line"][0], second | {"drive": second["drive"][:1]}]
    with pytest.raises(BadConfig, match=r"line\[1\]\.port: line port 'server:4001' is taken by line\[0\]\.port"):
        build(wrong)


def test_silent_drives_are_not_tried_more_often_than_asked() -> None:
    """The default of the longest interval gives way to a longer first one."""
    line = build(wrong_at("line", 0, "probe_every", value="20s")).lines[0]
    assert (line.probe_every, line.probe_at_most) == (20.0, 20.0)


def test_each_kind_of_port_has_its_own_margin() -> None:
    """A port on the board adds least, a network most; the time before the first bit comes on top."""
    margins = {}
    for port in ("/dev/ttyAMA0", "/dev/ttyS1", "/dev/ttyUSB0", "/dev/serial/by-id/x", "socket://h:1", "rfc2217://h:1"):
        margins[port] = build(wrong_at("line", 0, "port", value=port)).lines[0].margin
    assert list(margins.values()) == [0.02, 0.02, 0.05, 0.05, 0.25, 0.25]
    delayed = table()
    delayed["line"][0] |= {"rs485": "rts", "rts_delay_before": "1.5ms", "answer_margin": "10ms"}
    assert build(delayed).lines[0].margin == pytest.approx(0.0115)


@pytest.mark.hazard("H34")
def test_all_errors_are_named_at_once() -> None:
    """Form and fact together, in different tables."""
    wrong = wrong_at("line", 0, "baud", value=1200)
    wrong["web"]["listn"] = "x"
    wrong["line"][0]["drive"][1]["model"] = "vf-x"
    wrong["line"][0]["drive"][0]["poll"][0]["values"].append("stats")
    text = "\n".join(errors(wrong))
    for part in ("baud", "listn", "vf-x", "'stats'"):
        assert part in text


def test_the_error_does_not_print_a_secret() -> None:
    """A password in the wrong place is not repeated on the screen."""
    text = "\n".join(errors(wrong_at("mqtt", "password", value="geheim")))
    assert "geheim" not in text
    text = "\n".join(errors(wrong_at("mqtt", "url", value="mqtt://me:geheim@host:1883")))
    assert "geheim" not in text


def test_two_lines_may_share_numbers_when_units_differ() -> None:
    """The unit is what must be once only."""
    both = table()
    both["line"].append(copy.deepcopy(both["line"][0]) | {"name": "b", "port": "/dev/ttyUSB1"})
    for index, drive in enumerate(both["line"][1]["drive"]):
        drive |= {"name": f"fan-{index}", "unit": 20 + index}
    assert [drive.unit for drive in build(both).drives] == [1, 2, 20, 21]
    both["line"][1]["port"] = "/dev/ttyUSB0"
    assert any("line port" in line for line in errors(both))


def test_not_toml_and_no_file_are_said_with_the_place(tmp_path: Path) -> None:
    """Line and column of the syntax error; the name of the missing file."""
    broken = tmp_path / "gateway.toml"
    broken.write_text("[gateway\n")
    with pytest.raises(BadConfig, match=r"gateway\.toml: not TOML: .*line 1"):
        site.load(broken)
    with pytest.raises(BadConfig, match=r"none\.toml: cannot be read"):
        site.load(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("text", "seconds"), [("100ms", 0.1), ("2s", 2.0), ("1.5min", 90.0), ("1h", 3600.0), ("0s", 0)]
)
def test_durations(text: str, seconds: float) -> None:
    """Number and unit."""
    assert config.seconds(text) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "5", "-1s", "1 week", 5, "1s2s"])
def test_what_is_no_duration(text: object) -> None:
    """The form is said."""
    with pytest.raises(ValueError, match="100ms"):
        config.seconds(text)


def test_secrets_come_from_the_environment_or_a_file(tmp_path: Path) -> None:
    """And a missing one is said by name."""
    file = tmp_path / "password"
    file.write_text("geheim\n")
    assert Secret(file=str(file)).reveal({}) == "geheim"
    assert Secret(env="PW").reveal({"PW": "x"}) == "x"
    with pytest.raises(BadConfig, match="environment variable PW is not set"):
        Secret(env="PW").reveal({})
    with pytest.raises(BadConfig, match="secret file"):
        Secret(file=str(tmp_path / "none")).reveal({})
