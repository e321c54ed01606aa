from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
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
