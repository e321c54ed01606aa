from __future__ import annotations

import json
import os
import select
import threading
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.errors import GatewayError
from gateway.sim.control import REQUEST
from gateway.sim.faults import Kind
from gateway.sim.lateness import Lateness
from gateway.sim.runner import OpenLine, describe, opened
from gateway.sim.settings import SimulatedLineConfig, from_options
from tests.sim.rig import framed
from tests.soak import FACTOR

PATIENCE = 10.0  # seconds for what takes milliseconds


@pytest.fixture
def line() -> Iterator[OpenLine]:
    """Open a line of two drives that nobody runs: the test looks at it between requests."""
    config = SimulatedLineConfig.model_validate(
        {
            "drive": [
                {"number": 1, "name": "pump", "model": "vf-nc3", "running_at": 30, "block_read": [2, 1]},
                {"number": 2, "model": "vf-mb1"},
            ]
        }
    )
    with opened(config, None) as open_line:
        yield open_line


def result(line: OpenLine, **request: Any) -> Any:
    """Do a control request that must work."""
    answer = line.control.do(request)
    assert answer["ok"], answer
    json.dumps(answer)
    return answer["result"]


def refusal(line: OpenLine, **request: Any) -> str:
    """Do a control request that must be refused; return why."""
    answer = line.control.do(request)
    assert not answer["ok"]
    return str(answer["error"])


def ask(line: OpenLine, body: str, number: int = 1) -> None:
    """Let a master ask a drive, half a second from now on the line's clock."""
    wire = line.loop.wire
    begin = max(drive.inverter.condition.time for drive in wire.drives) + 0.5
    wire.feed(framed(body, number), begin)
    wire.due(begin + 0.4)


class TestState:
    def test_it_tells_what_a_drive_is_and_holds(self, line: OpenLine) -> None:
        """Frequency, registers and wear, as the drive has them."""
        state = result(line, do="state", drive=1)
        assert (state["number"], state["name"], state["model"]) == (1, "pump", "vf-nc3")
        assert (state["form"], state["protocol"]) == ("VFnC3-2007P", "modbus-rtu")
        assert (state["frequency"], state["is_running"], state["is_deaf"]) == (30.0, True, False)
        assert state["registers"]["panel_frequency"] == 3000
        assert state["selectors"] == {"read": ["output_frequency", "status", "", "", ""], "write": ["", ""]}
        assert (state["eeprom_writes"], state["forced"], state["alarm"]) == ({}, {}, 0)

    def test_without_a_drive_it_tells_of_all(self, line: OpenLine) -> None:
        """In the order of the file, so that doubled numbers can be told apart."""
        result(line, do="renumber", drive=2, number=1)
        assert [state["model"] for state in result(line, do="state")] == ["vf-nc3", "vf-mb1"]

    def test_it_counts_what_reached_the_drive(self, line: OpenLine) -> None:
        """Frames heard are everybody's, messages acknowledged its own, writes to the EEPROM by number."""
        for body, number in [("03 FD00 0001", 1), ("06 0880 0007", 2), ("06 0880 0008", 2), ("03 FD00 0001", 9)]:
            ask(line, body, number)
        first, second = result(line, do="state")
        assert (first["frames_heard"], second["frames_heard"]) == (4, 4)
        assert (first["messages_acknowledged"], second["messages_acknowledged"]) == (1, 2)
        assert first["acknowledged_at"] < second["acknowledged_at"]
        assert (first["eeprom_writes"], second["eeprom_writes"]) == ({}, {"0880": 2})

    def test_it_tells_how_near_the_time_out_was(self, line: OpenLine) -> None:
        """F803 = 1.0 s, and half a second between messages: 0.5 s were left, and are now less again."""
        assert result(line, do="state", drive=1)["timeout"]["least_margin"] is None
        result(line, do="set", drive=1, register="communication_timeout", value=10)
        ask(line, "03 FD00 0001")
        ask(line, "03 FD00 0001")
        timeout = result(line, do="state", drive=1)["timeout"]
        assert (timeout["period"], timeout["is_timed_out"]) == (1.0, False)
        assert timeout["least_margin"] == pytest.approx(0.5, abs=0.05)
        assert timeout["left"] == pytest.approx(1.0, abs=0.05)

    @pytest.mark.parametrize(
        ("settings", "text"),
        [
            ({}, None),
            ({"standard_monitor": 18}, "dAtA"),
            ({"standard_monitor": 18, "led_text_1_digit_2": 0xB0, "led_text_1_digit_4": 3}, "d0.t "),
            ({"standard_monitor": 18, "led_selection": 2}, "0000"),
            ({"standard_monitor": 18, "led_selection": 0, "led_number": 1234, "led_decimal_point": 2}, "12.34"),
            ({"standard_monitor": 18, "led_selection": 0, "led_number": 7, "led_unit_0": 1}, "   7 Hz"),
        ],
    )
    def test_it_shows_the_panel_s_text(self, line: OpenLine, settings: dict[str, int], text: str | None) -> None:
        """What the host wrote there, while F710 = 18 has it shown (E6581657 7.3.1)."""
        for register, value in settings.items():
            result(line, do="set", drive=1, register=register, value=value)
        assert result(line, do="state", drive=1)["panel"] == text


class TestDoings:
    def test_what_an_operator_does_at_a_drive_can_be_done(self, line: OpenLine) -> None:
        """Set, run, trip and power cycle act on the drive that is named."""
        result(line, do="set", drive=2, register="free_notes", value=5)
        result(line, do="run", drive=2, frequency=10, reverse=True)
        drive = line.loop.wire.drives[1].inverter
        assert (drive.memory.word("free_notes"), drive.operation.target) == (5, -10.0)
        result(line, do="trip", drive=2, code=13)
        assert [state["trip_code"] for state in result(line, do="state")] == [0, 13]
        result(line, do="power_cycle", drive=2, seconds=3.0)
        assert result(line, do="state", drive=2)["trip_code"] == 0
        assert drive.deaf_until == pytest.approx(drive.condition.time + 4.0, abs=1.0)

    def test_a_power_cut_without_a_drive_is_everybody_s(self, line: OpenLine) -> None:
        """Both start up."""
        result(line, do="power_cycle")
        assert [state["is_deaf"] for state in result(line, do="state")] == [True, True]

    def test_a_drive_goes_by_the_number_it_has_now_or_by_its_name(self, line: OpenLine) -> None:
        """Renumbered at the panel, it goes by its new number; a name stays."""
        result(line, do="renumber", drive="pump", number=7)
        assert result(line, do="state", drive=7)["name"] == "pump"
        assert result(line, do="state", drive="pump")["number"] == 7
        assert refusal(line, do="state", drive=1) == "no drive 1; on the line: 7, 2, pump"

    def test_a_register_can_be_forced_and_let_go(self, line: OpenLine) -> None:
        """It reads that word whatever is true."""
        result(line, do="force", drive=1, register="output_frequency", value=77)
        assert result(line, do="state", drive=1)["forced"] == {"FD00": 77}
        result(line, do="force", drive=1, register="output_frequency")
        assert result(line, do="state", drive=1)["forced"] == {}

    @pytest.mark.parametrize("text", ["communication_timeout", "F803", "0803", "0x0803", "0803H"])
    def test_a_register_goes_by_its_number_too(self, line: OpenLine, text: str) -> None:
        """As the commands take it; the journal has it as it was given."""
        result(line, do="set", drive=1, register=text, value=20)
        result(line, do="force", drive=1, register=text, value=77)
        state = result(line, do="state", drive=1)
        assert (state["timeout"]["period"], state["registers"]["communication_timeout"]) == (2.0, 20)
        assert state["forced"] == {"0803": 77}
        assert result(line, do="log", count=1)[0]["note"] == f"force drive=1 register={text} value=77"

    def test_faults_are_begun_and_ended(self, line: OpenLine) -> None:
        """A fault of a drive, one of the line, a cut wire; clearing says how many there were."""
        drives, faults = line.loop.wire.drives, line.loop.wire.faults
        result(line, do="fault", drive=1, kind="late", value=0.2, count=3)
        result(line, do="fault", kind="echo")
        result(line, do="cut", drive=2)
        late, echo, cut = faults.all
        assert (late.drive, late.value, late.count) == (drives[0], 0.2, 3)
        assert (echo.drive, cut.drive, cut.kind) == (None, drives[1], Kind.CUT)
        assert result(line, do="clear_faults", kind="echo") == 1
        assert result(line, do="clear_faults", drive="pump") == 1
        result(line, do="cut", drive=2, on=False)
        assert result(line, do="clear_faults") == 0

    @pytest.mark.parametrize(("doing", "kind"), [("cut", Kind.CUT), ("silence", Kind.DROP)])
    def test_what_is_switched_on_twice_is_on_once(self, line: OpenLine, doing: str, kind: Kind) -> None:
        """And switched off once it is off; the line's and a drive's are apart."""
        faults = line.loop.wire.faults
        for drive in (None, None, 1, 1):
            result(line, do=doing, drive=drive)
        assert [fault.kind for fault in faults.all] == [kind, kind]
        result(line, do=doing, on=False)
        assert [fault.drive for fault in faults.all] == [line.loop.wire.drives[0]]

    def test_babble_and_plugging_are_for_the_line(self, line: OpenLine) -> None:
        """Noise is under way until the adapter is pulled out; plugged in again it has a port."""
        result(line, do="babble", bytes=3)
        assert line.loop.wire.next_event() is not None
        result(line, do="unplug")
        assert line.loop.wire.next_event() is None
        assert line.loop.port.descriptor is None
        assert result(line, do="plug") == line.loop.port.name
        assert Path(line.loop.port.name).exists()

    def test_a_link_that_is_taken_keeps_the_adapter_out(self, tmp_path: Path) -> None:
        """A file stands there by now; once it is gone, the adapter can be plugged in."""
        link = tmp_path / "line"
        config = from_options(["1:vf-nc3"]).model_copy(update={"link": str(link)})
        with opened(config, None) as line:
            result(line, do="unplug")
            link.write_text("mine")
            assert refusal(line, do="plug") == f"link: {link} exists and is no link"
            assert line.loop.port.descriptor is None
            link.unlink()
            assert result(line, do="plug") == str(link.readlink())

    def test_a_capture_that_cannot_be_written_is_refused(self, line: OpenLine, tmp_path: Path) -> None:
        """The reason is the system's."""
        assert "No such file" in refusal(line, do="capture", file=str(tmp_path / "none" / "line.pcap"))


class TestQuestions:
    def test_counts_can_begin_anew(self, line: OpenLine) -> None:
        """After a reset all are 0."""
        line.loop.wire.statistics.gap_violations = 3
        line.loop.lateness.add(0.5)
        result(line, do="fault", drive=1, kind="drop")
        refusal(line, do="trip", drive=9, code=1)
        ask(line, "03 FD00 0001")
        counted = result(line, do="stats")
        assert (counted["done"], counted["failed"], counted["faults"]) == (1, 1, {"drop": 1})
        result(line, do="reset_stats")
        counted = result(line, do="stats")
        assert (counted["gap_violations"], counted["lateness_maximum"], counted["drives"]) == (0, 0.0, {})
        assert (counted["done"], counted["failed"], counted["faults"]) == (0, 0, {})

    def test_the_log_has_frames_and_what_was_done(self, line: OpenLine) -> None:
        """Requests, answers as they were given, what the master heard, and events, in their order."""
        result(line, do="fault", drive=1, kind="truncate", value=2)
        ask(line, "03 FD00 0001")
        event, request, answer, heard = result(line, do="log")
        assert (event["way"], event["note"]) == ("event", "fault kind=truncate value=2 drive=1")
        assert (request["way"], request["data"]) == ("request", "01 03 FD 00 00 01 B5 A6")
        assert (answer["way"], answer["drive"], answer["data"]) == ("answer", 1, "01 03 02 0B B8 BF 06")
        assert (heard["way"], heard["data"], heard["note"]) == ("heard", "01 03", "truncate")
        assert event["end"] <= request["begin"] < request["end"] < answer["begin"] == heard["begin"] < heard["end"]
        assert [entry["way"] for entry in result(line, do="log", count=2)] == ["answer", "heard"]

    def test_the_log_shows_text_as_text(self, line: OpenLine) -> None:
        """An ASCII frame can be read."""
        line.loop.wire.feed(b"(RFD00)\r", line.control.line.opened + 0.5)
        line.loop.wire.due(line.control.line.opened + 1)
        (request,) = result(line, do="log")
        assert request["text"] == "(RFD00)"


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        ({"do": "dance"}, "do: no such doing 'dance'; known: trip, "),
        ({}, "do: missing: say what is to be done"),
        ({"do": "trip", "drive": 1}, "code: Field required"),
        ({"do": "trip", "drive": 1, "code": "13"}, "code: Input should be a valid integer"),
        ({"do": "trip", "drive": 1.5, "code": 13}, "drive: a drive's number (0 to 247) is wanted, or the name"),
        ({"do": "trip", "drive": 1, "code": 13, "when": "now"}, "when: unknown key"),
        ({"do": "state", "drive": "fan"}, "no drive fan; on the line: 1, 2, pump"),
        (
            {"do": "set", "drive": 1, "register": "colour", "value": 1},
            "vf-nc3 has no register 'colour'; see: ",
        ),
        (
            {"do": "force", "drive": 1, "register": "trip_kode"},
            "vf-nc3 has no register 'trip_kode'; did you mean",
        ),
        (
            {"do": "force", "drive": 1, "register": "0xFA02"},
            "vf-nc3 has no register '0xFA02'; the nearest is frequency_command (FA01)",
        ),
        ({"do": "set", "drive": 1, "register": "F874", "value": 1}, "vf-nc3 has no register 'F874'; the nearest is "),
        ({"do": "force", "drive": 1, "register": "a b"}, "register: String should match pattern"),
        ({"do": "force", "drive": 1, "register": 64_000}, "register: Input should be a valid string"),
        ({"do": "set", "drive": 1, "register": "led_selection", "value": 3}, "led_selection takes 0 to 2 (given: 3)"),
        ({"do": "fault", "kind": "gremlin"}, "kind: Input should be 'cut', "),
        ({"do": "fault", "kind": "drop", "value": 1}, "drop takes no value"),
        ({"do": "fault", "kind": "echo", "drive": 1}, "echo is a fault of the line: it takes no drive"),
        ({"do": "fault", "kind": "flip", "value": 1.5}, "the value of flip counts bits: a whole number"),
        ({"do": "fault", "kind": "late", "value": [2, 1]}, "value: of two numbers the smaller one stands first"),
        ({"do": "babble", "bytes": -1}, "bytes: a number from 0 to 65535 is wanted, or two"),
        ({"do": "babble", "bytes": 0.5}, "bytes counts bytes"),
        ({"do": "babble", "bytes": 65_536}, "bytes: a number from 0 to 65535 is wanted"),
        ({"do": "fault", "kind": "late", "value": float("inf")}, "value: a number from 0 to 65535 is wanted"),
        ({"do": "fault", "kind": "late", "value": float("nan")}, "value: a number from 0 to 65535 is wanted"),
        ({"do": "power_cycle", "seconds": float("inf")}, "seconds: Input should be a finite number"),
        ({"do": "log", "count": 0}, "count: Input should be greater than or equal to 1"),
    ],
)
def test_a_wrong_request_is_refused_with_its_reason(line: OpenLine, request_: dict[str, Any], reason: str) -> None:
    """The key that is wrong, and what would be right."""
    assert refusal(line, **request_).startswith(reason)


DRIVE = st.one_of(st.integers(0, 7), st.sampled_from(["pump", "fan", "old", "nobody"]))
WORD = st.integers(0, 0xFFFF)
REGISTERS = (
    "number protocol baud_rate block_read_1 block_mode led_selection led_number standard_monitor free_notes none"
)
COMMANDS = "communication_timeout panel_frequency frequency_command command output_frequency trip_code master_slave"
NUMBERS = "F802 F803 FA00 0xFA01 FD00H 0803 ACC FA02 F87Z"
REGISTER = st.sampled_from([*REGISTERS.split(), *COMMANDS.split(), *NUMBERS.split()])
AMOUNT = st.one_of(st.integers(0, 300), st.lists(st.integers(0, 300), min_size=2, max_size=2).map(sorted))
KEYS: dict[str, st.SearchStrategy[Any]] = {
    "drive": DRIVE,
    "code": st.integers(1, 255),
    "value": st.one_of(WORD, AMOUNT),
    "frequency": st.floats(0, 500),
    "reverse": st.booleans(),
    "register": REGISTER,
    "number": st.integers(0, 247),
    "seconds": st.floats(0, 2),
    "on": st.booleans(),
    "kind": st.sampled_from([kind.value for kind in Kind]),
    "probability": st.floats(0, 1),
    "count": st.integers(1, 50),
    "after": st.sampled_from(["0s", "1s"]),
    "until": st.sampled_from(["2s", "1min"]),
    "bytes": AMOUNT,
}
LASTING = ("unplug", "plug", "capture")  # of a port and a disk


@st.composite
def requests(draw: st.DrawFn) -> dict[str, Any]:
    """Draw a request with its keys, some of those that may be left out, and values that may be right."""
    schemas = REQUEST.json_schema(by_alias=True)
    mapping = schemas["discriminator"]["mapping"]
    do = draw(st.sampled_from([name for name in mapping if name not in LASTING]))
    schema = schemas["$defs"][mapping[do].rsplit("/", 1)[1]]
    keys = [key for key in schema["properties"] if key != "do"]
    chosen = [key for key in keys if key in schema.get("required", []) or draw(st.booleans())]
    return {"do": do} | {key: draw(KEYS[key]) for key in chosen}


@pytest.mark.unmeasured
@given(st.lists(requests(), min_size=1, max_size=15), st.randoms(use_true_random=False))
@settings(max_examples=50 * FACTOR)
def test_no_request_is_fatal(asked: list[dict[str, Any]], rng: Random) -> None:
    """Whatever is done to drives of every model and protocol, the line goes on and answers every request."""
    table = {
        "drive": [
            {"number": 1, "name": "pump", "model": "vf-nc3", "running_at": 30},
            {"number": 2, "name": "fan", "model": "vf-mb1", "protocol": "toshiba"},
            {"number": 3, "name": "old", "model": "vf-as3"},
        ]
    }
    frames = [framed("03 1875 0005"), framed("06 FA00 C400", 3), b"(02RFD01)\r", b"(**PFA011770)\r", b"/X\5\5", b"("]
    with opened(SimulatedLineConfig.model_validate(table), None) as line:
        wire, now = line.loop.wire, line.control.line.opened
        for request in asked:
            answer = json.loads(line.control.do_line(json.dumps(request).encode()))
            assert answer["ok"] or answer["error"], request
            now += rng.uniform(0.0, 0.3)
            wire.feed(rng.choice(frames), now)
            wire.due(now + 0.1)
        assert line.control.do({"do": "state"})["ok"]


@pytest.mark.parametrize("text", [b"", b"{", b"[]", b'"stats"', b'{"do": "set", "drive": 1}', b'{"do": "run"}'])
def test_no_line_is_fatal(line: OpenLine, text: bytes) -> None:
    """Whatever comes is answered by one line that says what was wrong."""
    answer = json.loads(line.control.do_line(text))
    assert not answer["ok"]
    assert answer["error"]


def test_the_loop_moves_bytes_until_it_is_stopped(line: OpenLine) -> None:
    """A request is answered over the port, the lateness of it measured, and stop ends the loop."""
    loop = line.loop
    thread = threading.Thread(target=loop.run)
    thread.start()
    try:
        port = os.open(loop.port.name, os.O_RDWR | os.O_NOCTTY)
        os.write(port, framed("03 FD00 0001"))
        assert select.select([port], [], [], PATIENCE)[0]
        assert os.read(port, 64) == framed("03 02 0BB8")
        os.close(port)
    finally:
        loop.stop()
        thread.join(PATIENCE)
    assert not thread.is_alive()
    assert loop.lateness.maximum > 0


def test_a_control_socket_in_use_is_not_taken_over(tmp_path: Path) -> None:
    """A second line on the same socket says so; one left behind by a killed line is replaced."""
    config, path = from_options(["1:vf-nc3"]), tmp_path / "control"
    with opened(config, path):
        with pytest.raises(GatewayError, match="another simulated line"), opened(config, path):
            pass
        assert path.is_socket()
    assert not path.exists()


def test_what_is_in_the_way_of_a_line_is_named(tmp_path: Path) -> None:
    """The link or the control socket, and why."""
    link, control = tmp_path / "none" / "line", tmp_path / "none" / "control"
    config = from_options(["1:vf-nc3"])
    linked = config.model_copy(update={"link": str(link)})
    with pytest.raises(GatewayError, match=f"link {link}: No such file or directory"), opened(linked, None):
        pass
    with pytest.raises(GatewayError, match=f"control {control}: No such file or directory"), opened(config, control):
        pass


def test_a_line_is_described_to_its_user() -> None:
    """Port, speed, drives, and a note where numbers are doubled."""
    table = {
        "baud": 9600,
        "checks_baud": True,
        "drive": [
            {"number": 3, "name": "pump", "model": "vf-nc3", "running_at": 20},
            {"number": 3, "model": "vf-mb1", "protocol": "toshiba"},
        ],
        "event": [{"at": "5s", "do": "trip", "drive": "pump", "code": 13}],
    }
    config = SimulatedLineConfig.model_validate(table)
    assert list(describe(config, "/dev/pts/9", Path("/run/c"))) == [
        "port /dev/pts/9",
        "line 9600 8E1, answers after 5 ms, and the master's baud rate is checked",
        "drive 3 (pump) vf-nc3 modbus-rtu, running at 20 Hz",
        "drive 3 vf-mb1 toshiba",
        "scenario of 1 event",
        "note: 3 is the number of more than one drive: their answers collide",
        "control /run/c",
    ]


def test_the_percentile_of_lateness_is_what_that_share_stayed_below() -> None:
    """99 of 100 deliveries were on time to a millisecond."""
    late = Lateness()
    assert late.percentile(0.99) == 0.0
    for place in range(100):
        late.add(place / 1000)
    assert late.percentile(0.5) == 0.050
    assert (late.percentile(0.99), late.maximum) == (0.099, 0.099)
