from __future__ import annotations

import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusIOException

from gateway.errors import GatewayError
from gateway.sim.drive_section import SimulatedDriveSection
from gateway.sim.process import SimulatedLine
from gateway.sim.pty_port import PtyPort
from gateway.sim.settings import SimulatedLineConfig, from_options

pytestmark = pytest.mark.e2e

PATIENCE = 10.0  # seconds for what takes milliseconds


def two_drives(link: Path | None = None) -> SimulatedLineConfig:
    """Describe a running VF-nC3 with its block set, and a standing VF-MB1."""
    first = SimulatedDriveSection(number=1, model="vf-nc3", running_at=30.0, block_read=[1, 2, 3, 4, 5])
    second = SimulatedDriveSection(number=2, model="vf-mb1")
    return SimulatedLineConfig(drive=[first, second], link=str(link) if link else None)


@pytest.fixture(scope="module")
def line() -> Iterator[SimulatedLine]:
    """One line for the tests that leave it as they found it."""
    with SimulatedLine(two_drives()) as running:
        yield running


def keep_gap() -> None:
    """Let 3.5 characters pass at 19200 baud: what a master owes the line before its first request, too."""
    select.select([], [], [], 0.003)


@pytest.fixture
def master(line: SimulatedLine) -> Iterator[ModbusSerialClient]:
    """Open a foreign master on the port."""
    client = ModbusSerialClient(line.port, baudrate=19200, parity="N", stopbits=2, timeout=1, retries=0)
    assert client.connect()
    keep_gap()
    yield client
    client.close()  # type: ignore[no-untyped-call]


class TestTiming:
    def test_an_answer_never_comes_before_the_wire_could_bring_it(self, line: SimulatedLine) -> None:
        """By the line's own counts no exchange is shorter than its characters, gaps and processing time."""
        line.do({"do": "reset_stats"})
        descriptor = os.open(line.port, os.O_RDWR | os.O_NOCTTY)
        try:
            for _ in range(5):
                keep_gap()
                os.write(descriptor, bytes.fromhex("0103FD000001B5A6"))
                assert select.select([descriptor], [], [], PATIENCE)[0]
                assert os.read(descriptor, 64) == bytes.fromhex("010302 0BB8 BF06")
        finally:
            os.close(descriptor)
        counted = line.stats()
        assert counted["answers"] == 5
        assert counted["gap_violations"] == 0
        assert counted["busy"] == pytest.approx(5 * (8 * 11 / 19200 + 77 / 19200 + 0.005 + 7 * 12 / 19200))
        assert counted["busy"] <= counted["elapsed"] + 77 / 38400
        assert 0 < counted["lateness_p99"] <= counted["lateness_maximum"]


class TestControl:
    def test_a_drive_is_silent_until_it_is_let_speak(self, line: SimulatedLine, master: ModbusSerialClient) -> None:
        """The request silence takes one drive's answers and gives them back."""
        line.do({"do": "silence", "drive": 2, "on": True})
        master.comm_params.timeout_connect = 0.1
        with pytest.raises(ModbusIOException):
            master.read_holding_registers(0xFB05, count=1, device_id=2)
        assert master.read_holding_registers(0xFB05, count=1, device_id=1).registers == [4]
        line.do({"do": "silence", "drive": 2, "on": False})
        assert master.read_holding_registers(0xFB05, count=1, device_id=2).registers == [28]

    def test_set_force_and_alarm_show_on_the_wire(self, line: SimulatedLine, master: ModbusSerialClient) -> None:
        """What is done at the drive is read by the master."""
        line.do({"do": "set", "drive": 2, "register": "free_notes", "value": 77})
        line.do({"do": "force", "drive": 2, "register": "pid_feedback", "value": 5000})
        line.do({"do": "alarm", "drive": 2, "value": 1})
        assert master.read_holding_registers(0x0880, count=1, device_id=2).registers == [77]
        assert master.read_holding_registers(0xFD22, count=1, device_id=2).registers == [5000]
        assert master.read_holding_registers(0xFD01, count=1, device_id=2).registers[0] & 4
        line.do({"do": "force", "drive": 2, "register": "pid_feedback", "value": None})
        line.do({"do": "alarm", "drive": 2, "value": 0})
        assert line.state(2)["registers"]["free_notes"] == 77

    def test_a_fault_strikes_as_often_as_it_was_told(self, line: SimulatedLine, master: ModbusSerialClient) -> None:
        """One answer is lost, the next one comes."""
        line.do({"do": "fault", "drive": 1, "kind": "drop", "count": 1})
        master.comm_params.timeout_connect = 0.1
        with pytest.raises(ModbusIOException):
            master.read_holding_registers(0xFB05, count=1, device_id=1)
        assert master.read_holding_registers(0xFB05, count=1, device_id=1).registers == [4]

    @pytest.mark.parametrize(
        ("request_", "reason"),
        [
            ({"do": "dance"}, "no such doing"),
            ({"do": "state", "drive": 9}, "no drive 9"),
            ({"do": "renumber", "drive": 1}, "number: Field required"),
            ({"do": "set", "drive": 1, "register": "colour", "value": 1}, "colour"),
            ({"do": "fault", "kind": "gremlin"}, "kind"),
        ],
    )
    def test_a_wrong_request_is_refused_with_its_reason(
        self, line: SimulatedLine, request_: dict[str, object], reason: str
    ) -> None:
        """The line goes on, and says what was wrong."""
        with pytest.raises(GatewayError, match=reason):
            line.do(request_)

    def test_what_is_no_json_is_refused(self, line: SimulatedLine) -> None:
        """Junk on the control socket is answered, not fatal."""
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(PATIENCE)
            client.connect(str(line.control))
            client.sendall(b"hello\n[1]\n")
            answers = client.makefile("rb")
            assert not json.loads(answers.readline())["ok"]
            assert not json.loads(answers.readline())["ok"]
            answers.close()
        assert line.stats()


class SerialPort:
    """The port as a program opens it, at a baud rate."""

    def __init__(self, name: str, speed: int) -> None:
        self._descriptor = os.open(name, os.O_RDWR | os.O_NOCTTY)
        self.set_speed(speed)

    def set_speed(self, speed: int) -> None:
        """Set the rate as pyserial and libmodbus do."""
        settings = termios.tcgetattr(self._descriptor)
        settings[4] = settings[5] = speed
        termios.tcsetattr(self._descriptor, termios.TCSANOW, settings)

    def write(self, data: bytes) -> None:
        """Send, after the gap."""
        keep_gap()
        os.write(self._descriptor, data)

    def read(self, patience: float = PATIENCE) -> bytes:
        """Return what comes next; b"" for nothing."""
        return os.read(self._descriptor, 64) if select.select([self._descriptor], [], [], patience)[0] else b""

    def close(self) -> None:
        """Close it."""
        os.close(self._descriptor)


ASK, ANSWER = bytes.fromhex("0103FD000001B5A6"), bytes.fromhex("0103020BB8BF06")
SILENCE = 0.1  # seconds without an answer


class TestBaud:
    @pytest.mark.parametrize("baud", [9600, 19200, 38400])
    def test_a_master_at_another_rate_is_not_understood(self, baud: int) -> None:
        """Where the line checks it: of all rates one is answered, and the frames of the others are counted."""
        config = from_options(["1:vf-nc3"], baud=baud).model_copy(update={"checks_baud": True})
        with SimulatedLine(config) as line:
            port = SerialPort(line.port, termios.B1200)
            answered = []
            for rate, speed in [(9600, termios.B9600), (19200, termios.B19200), (38400, termios.B38400)]:
                port.set_speed(speed)
                port.write(ASK)
                if port.read(PATIENCE if rate == baud else SILENCE):
                    answered.append(rate)
            port.close()
            assert answered == [baud]
            counted = line.stats()
            assert (counted["wrong_baud"], counted["lost"], counted["answers"]) == (2, 2, 1)
            assert [entry.get("note") for entry in line.log() if entry["way"] == "request"].count(
                "wrong baud rate"
            ) == 2

    def test_what_comes_at_another_rate_is_noise(self) -> None:
        """An answer that is late arrives when the master has changed its rate: as many bytes, and each one wrong."""
        table = {
            "checks_baud": True,
            "drive": [{"number": 1, "model": "vf-nc3", "running_at": 30}],
            "fault": [{"kind": "late", "value": 0.3}],
        }
        with SimulatedLine(SimulatedLineConfig.model_validate(table)) as line:
            port = SerialPort(line.port, termios.B19200)
            port.write(ASK)
            assert port.read(SILENCE) == b""
            port.set_speed(termios.B9600)
            noise = port.read()
            port.close()
        assert len(noise) == len(ANSWER)
        assert all(heard != sent for heard, sent in zip(noise, ANSWER, strict=True))

    def test_otherwise_any_rate_will_do(self, line: SimulatedLine) -> None:
        """A program that sets none is at 38400."""
        port = SerialPort(line.port, termios.B1200)
        port.write(ASK)
        assert port.read() == ANSWER
        port.close()


class TestScenario:
    def test_a_scenario_runs_behind_the_port(self, tmp_path: Path) -> None:
        """After two exchanges the adapter is pulled out, and comes back; a drive goes on under another number."""
        link = tmp_path / "adapter"
        table = {
            "link": str(link),
            "drive": [{"number": 1, "name": "pump", "model": "vf-nc3", "running_at": 30}],
            "event": [
                {"after_exchanges": 2, "do": "renumber", "drive": "pump", "number": 7},
                {"after_exchanges": 2, "do": "unplug"},
                {"after_exchanges": 2, "at": "200ms", "do": "plug"},
            ],
        }
        with SimulatedLine(SimulatedLineConfig.model_validate(table)) as line:
            port = SerialPort(line.port, termios.B19200)
            for _ in range(2):
                port.write(ASK)
                assert port.read() == ANSWER
            port.close()
            done = [line.do({"do": "log", "count": 4})]
            while "plug" not in [entry.get("note") for entry in done[-1]][-1:]:
                done.append(line.do({"do": "log", "count": 4}))
            assert line.state("pump")["number"] == 7
            port = SerialPort(str(link), termios.B19200)
            port.write(bytes.fromhex("0703FD000001B5C0"))
            assert port.read()[:5] == bytes.fromhex("0703020BB8")
            port.close()


class TestUnplug:
    @pytest.mark.hazard("H14")
    def test_a_master_on_an_unplugged_port_sees_it_go(self, tmp_path: Path) -> None:
        """The open port ends as a real one does; the link is gone and comes back with the new port."""
        link = tmp_path / "adapter"
        with SimulatedLine(two_drives(link)) as line:
            assert line.port == str(link)
            descriptor = os.open(link, os.O_RDWR | os.O_NOCTTY)
            line.unplug()
            assert select.select([descriptor], [], [], PATIENCE)[0]
            with pytest.raises(OSError, match="Input/output error"):
                os.write(descriptor, b"\x01")
            assert not link.exists()
            os.close(descriptor)
            line.plug()
            client = ModbusSerialClient(str(link), baudrate=19200, parity="N", stopbits=2, timeout=1)
            assert client.connect()
            assert client.read_holding_registers(0xFD00, count=1, device_id=1).registers == [3000]
            client.close()  # type: ignore[no-untyped-call]
        assert not link.is_symlink()

    def test_answers_that_nobody_reads_do_no_harm(self) -> None:
        """Where no master reads, what does not fit the port's buffer is lost, and nothing blocks or fails."""
        port = PtyPort()
        try:
            for _ in range(100):
                port.write(bytes(1000))
            descriptor = os.open(port.name, os.O_RDWR | os.O_NOCTTY)
            assert len(os.read(descriptor, 100_000)) < 100_000
            os.close(descriptor)
        finally:
            port.unplug()


SIMULATE = [sys.executable, "-m", "gateway", "simulate"]
TRACED = """\
link = "{folder}/line"
trace = true
[[drive]]
number = 5
name = "pump"
model = "vf-nc3"
protocol = "toshiba"
running_at = 20
[[event]]
at = "1ms"
do = "alarm"
drive = "pump"
value = 1
"""


def client(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Ask a control socket by hand."""
    command = [sys.executable, "-m", "gateway.sim.client", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


class TestProgram:
    def test_simulate_ends_in_order_on_a_signal(self, tmp_path: Path) -> None:
        """SIGTERM removes link and socket, and the exit code says that nothing was wrong."""
        link, control = tmp_path / "line", tmp_path / "control"
        script = (
            "import sys; from pathlib import Path; from gateway.sim import runner, settings;"
            "config = settings.from_options(['1:vf-nc3', '2:vf-mb1']).model_copy(update={'link': sys.argv[1]});"
            "runner.simulate(config, control=Path(sys.argv[2]), announce=lambda line: print(line, flush=True))"
        )
        with subprocess.Popen(
            [sys.executable, "-c", script, str(link), str(control)], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            told = [process.stdout.readline().strip() for _ in range(5)]
            has_control = control.is_socket()
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE) == 0
        assert told[0].startswith(f"port {link} -> /dev/pts/")
        assert told[1] == "line 19200 8E1, answers after 5 ms"
        assert told[2:4] == ["drive 1 vf-nc3 modbus-rtu", "drive 2 vf-mb1 modbus-rtu"]
        assert has_control
        assert not link.is_symlink()
        assert not control.exists()

    def test_simulate_tells_frames_and_events_as_they_come(self, tmp_path: Path) -> None:
        """What a user reads while a scenario runs; the control can be asked from a shell."""
        (tmp_path / "line.toml").write_text(TRACED.format(folder=tmp_path))
        with subprocess.Popen(
            [*SIMULATE, str(tmp_path / "line.toml"), "--control", str(tmp_path / "control")],
            stdout=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout is not None
            told = [process.stdout.readline().rstrip() for _ in range(5)]
            shell = "printf '(RFD00)\\r' > line; timeout 0.3 cat line | tr '\\r' '\\n'"
            answer = subprocess.run(["sh", "-c", shell], cwd=tmp_path, capture_output=True, text=True, check=False)
            asked = client(tmp_path / "control", "state", "drive=5")
            wrong = client(tmp_path / "control", "trip", "drive=9", "code=13")
            process.send_signal(signal.SIGTERM)
            told += [line.rstrip() for line in process.stdout]
        assert answer.stdout == "(RFD0007D0)\n"
        assert json.loads(asked.stdout)["protocol"] == "toshiba"
        assert (wrong.returncode, "no drive 9; on the line: 5, pump" in wrong.stderr) == (1, True)
        lines = [re.sub(r"^ *\d+\.\d{4} ", "", line) for line in told[4:]]
        assert lines[0] == "control " + str(tmp_path / "control")
        assert "** alarm drive=pump value=1" in lines
        assert lines[lines.index("-> (RFD00)") + 1] == "<- 5: (RFD0007D0)"
        assert "** trip drive=9 code=13: no drive 9; on the line: 5, pump" in lines

    @pytest.mark.parametrize(
        ("arguments", "code", "reason"),
        [
            ([], 2, "usage: python -m gateway.sim.client SOCKET DO"),
            (["/nowhere", "stats"], 1, "/nowhere: No such file or directory"),
            (["{control}", "trip", "drive"], 1, "drive: give KEY=VALUE"),
            (["{control}", "dance"], 1, "no such doing 'dance'"),
        ],
    )
    def test_the_client_says_what_is_wrong(
        self, line: SimulatedLine, arguments: list[str], code: int, reason: str
    ) -> None:
        """In a line on its error output, with an exit code."""
        done = client(*(argument.format(control=line.control) for argument in arguments))
        assert (done.returncode, done.stdout) == (code, "")
        assert reason in done.stderr
        assert "Traceback" not in done.stderr

    def test_a_line_that_cannot_start_says_why(self) -> None:
        """The error of the process reaches the program that started it."""
        with pytest.raises(GatewayError, match="no model 'vf-zz9'"):
            SimulatedLine(from_options(["1:vf-zz9"])).start()

    def test_a_link_does_not_replace_a_file(self, tmp_path: Path) -> None:
        """A file in the link's place is left alone."""
        (tmp_path / "notes").write_text("mine")
        with pytest.raises(GatewayError, match="exists and is no link"):
            SimulatedLine(two_drives(tmp_path / "notes")).start()
        assert (tmp_path / "notes").read_text() == "mine"
        assert [entry.name for entry in tmp_path.iterdir()] == ["notes"]


class TestShell:
    """`printf` and `cat` on the port, after other programs had it."""

    RECIPE = "printf '(02PFA011770)\\r' > {port}; timeout 0.3 cat {port} | tr '\\r' '\\n'"

    def told(self, port: str) -> str:
        """Play the recipe of the manual."""
        command = ["sh", "-c", self.RECIPE.format(port=port)]
        return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=True).stdout

    def test_it_works_after_a_program_that_reads_without_waiting(self) -> None:
        """A pyserial port leaves VMIN = VTIME = 0, the end to `cat`; once it is closed, readers wait."""
        with SimulatedLine(from_options(["2:vf-mb1:toshiba"])) as line:
            for _ in range(3):
                serial.Serial(line.port, 9600, stopbits=serial.STOPBITS_TWO, timeout=1).close()
                assert self.told(line.port) == "(02PFA011770)\n"
            descriptor = os.open(line.port, os.O_RDWR | os.O_NOCTTY)
            assert termios.tcgetattr(descriptor)[4:6] == [termios.B9600, termios.B9600]
            os.close(descriptor)

    def test_it_works_after_a_program_that_reads_lines(self) -> None:
        """A frame of TOSHIBA ends with CR, which ends no line: `cat` would wait for ever."""
        with SimulatedLine(from_options(["2:vf-mb1:toshiba"])) as line:
            subprocess.run(["stty", "-F", line.port, "icanon"], check=True, timeout=PATIENCE)
            assert self.told(line.port) == "(02PFA011770)\n"

    def test_a_program_keeps_its_settings_while_it_has_the_port(self) -> None:
        """Frames change nothing: one that asks again and again without waiting is not made to wait."""
        with (
            SimulatedLine(from_options(["2:vf-mb1:toshiba"])) as line,
            serial.Serial(line.port, 19200, stopbits=serial.STOPBITS_TWO, timeout=PATIENCE) as port,
        ):
            port.write(b"(02RFA01)\r")
            assert port.read_until(b"\r") == b"(02RFA010000)\r"
            characters = termios.tcgetattr(port.fileno())[6]
            assert (characters[termios.VMIN], characters[termios.VTIME]) == (0, 0)

    def test_how_long_readers_wait_stays_as_it_was_set(self) -> None:
        """`stty min 0 time 2`: two tenths of a second, also after stty has closed the port."""
        port = PtyPort()
        try:
            subprocess.run(["stty", "-F", port.name, "min", "0", "time", "2"], check=True, timeout=PATIENCE)
            port.restore()
            descriptor = os.open(port.name, os.O_RDWR | os.O_NOCTTY)
            characters = termios.tcgetattr(descriptor)[6]
            os.close(descriptor)
            assert (characters[termios.VMIN], characters[termios.VTIME]) == (0, 2)
        finally:
            port.unplug()


class TestLink:
    def test_a_link_of_a_living_line_is_not_taken(self, tmp_path: Path) -> None:
        """The second line says so, and the first one keeps its link, until it ends."""
        link = tmp_path / "line"
        with SimulatedLine(two_drives(link)):
            port = link.readlink()
            with pytest.raises(GatewayError, match=f"{link} is the link of another simulated line; end it"):
                SimulatedLine(two_drives(link)).start()
            assert link.readlink() == port
        assert not link.is_symlink()

    @pytest.mark.parametrize("target", ["/dev/pts/99999", "nowhere", "/dev/null"])
    def test_a_link_that_was_left_behind_is_taken(self, tmp_path: Path, target: str) -> None:
        """To a port that is gone, or to what is no line's."""
        link = tmp_path / "line"
        link.symlink_to(target)
        port = PtyPort(link)
        assert str(link.readlink()) == port.name
        port.unplug()
        assert not link.is_symlink()

    def test_a_link_that_points_elsewhere_by_now_stays(self, tmp_path: Path) -> None:
        """Somebody set it to another port: it is not this line's to remove."""
        link = tmp_path / "line"
        port = PtyPort(link)
        link.unlink()
        link.symlink_to("/dev/ttyUSB0")
        port.unplug()
        assert str(link.readlink()) == "/dev/ttyUSB0"

    def test_a_port_that_programs_open_and_lock_stays_the_line_s(self, tmp_path: Path) -> None:
        """An exclusive master comes and goes; neither is hindered, and the link stays refused."""
        link = tmp_path / "line"
        port = PtyPort(link)
        try:
            serial.Serial(str(link), 19200, stopbits=serial.STOPBITS_TWO, exclusive=True).close()
            with pytest.raises(FileExistsError, match="another simulated line"):
                PtyPort(link)
            assert str(link.readlink()) == port.name
        finally:
            port.unplug()
