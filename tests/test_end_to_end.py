"""The main job with the real parts: a pty line, Mosquitto, and foreign clients on the other side."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import ModbusTcpClient

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig
from tests.mosquitto import Mosquitto, free_port
from tests.processes import LIMIT, gateway, until

pytestmark = pytest.mark.e2e

FIVE = [1, 2, 3, 4, 5]
DRIVES = [
    {"number": 1, "model": "vf-nc3", "block_read": FIVE, "running_at": 50.0},
    {"number": 2, "model": "vf-nc3", "running_at": 20.0},
    {"number": 3, "model": "vf-mb1", "block_read": FIVE, "running_at": 40.0},
]


@dataclass
class Plant:
    """A simulated line, a broker, and the gateway as a process between them."""

    line: SimulatedLine
    broker: Mosquitto
    config: Path
    tcp: int
    web: int
    process: subprocess.Popen[str]
    log: Path

    def health(self) -> tuple[int, dict[str, Any]]:
        """Return the status and the body of /healthz."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.web}/healthz", timeout=5) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as error:
            with error:
                return error.code, json.load(error)
        except OSError:
            return 0, {}

    def is_healthy(self) -> bool:
        """Say whether /healthz answers 200."""
        return self.health()[0] == 200

    def metrics(self) -> str:
        """Return the text of /metrics."""
        with urllib.request.urlopen(f"http://127.0.0.1:{self.web}/metrics", timeout=5) as answer:
            text: str = answer.read().decode()
        return text

    def retained(self, topic: str) -> str:
        """Return the retained message of a topic by mosquitto_sub; empty where there is none."""
        done = subprocess.run(
            ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(self.broker.port), "-t", topic, "-C", "1", "-W", "2",
             "-F", "%p"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return done.stdout.strip()

    def mbpoll(self, *arguments: str) -> str:
        """Run mbpoll once against the gateway and return all that it prints."""
        done = subprocess.run(
            ["mbpoll", "-m", "tcp", "-p", str(self.tcp), "-0", "-1", "-o", "2", *arguments, "127.0.0.1"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return done.stdout + done.stderr

    def words(self, unit: int, address: int, count: int) -> list[int] | int:
        """Read holding registers by pymodbus: the words, or the exception code."""
        with ModbusTcpClient("127.0.0.1", port=self.tcp, timeout=5) as client:
            answer = client.read_holding_registers(address, count=count, device_id=unit)
        return answer.exception_code if answer.isError() else list(answer.registers)


def write_config(folder: Path, port: str, broker: int, tcp: int, web: int, more: str = "") -> Path:
    """Write the gateway's file for the three drives; `more` are further keys of each."""
    path = folder / "gateway.toml"
    text = f"""
[gateway]
name = "hall-3"
[mqtt]
url = "mqtt://127.0.0.1:{broker}"
reconnect_at_most = "1s"
[modbus_tcp]
listen = "127.0.0.1:{tcp}"
[web]
listen = "127.0.0.1:{web}"
[[line]]
name = "a"
port = "{port}"
baud = 19200
parity = "even"
"""
    for number, (name, model) in enumerate((("pump-1", "vf-nc3"), ("pump-2", "vf-nc3"), ("fan-1", "vf-mb1")), 1):
        text += f"""
[[line.drive]]
name = "{name}"
number = {number}
model = "{model}"
{more}
poll = [{{ values = ["status", "output_frequency", "output_current", "output_voltage", "alarm"], every = "200ms" }},
        {{ values = ["trip_code", "cumulative_operation_time"], every = "2s" }}]
"""
    path.write_text(text)
    return path


@pytest.fixture
def plant(tmp_path: Path) -> Iterator[Plant]:
    """Start everything and wait until the gateway is healthy."""
    with running(tmp_path, DRIVES) as made:
        yield made


@contextlib.contextmanager
def running(folder: Path, drives: list[dict[str, Any]], more: str = "") -> Iterator[Plant]:
    """Start everything with these simulated drives; `more` are further keys of each in the gateway's file."""
    link = folder / "line"
    config = SimulatedLineConfig.model_validate({"drive": drives, "link": str(link)})
    with SimulatedLine(config) as line, Mosquitto() as broker:
        tcp, web = free_port(), free_port()
        file = write_config(folder, str(link), broker.port, tcp, web, more)
        log = folder / "log"
        with gateway(file, log) as process:
            made = Plant(line, broker, file, tcp, web, process, log)
            try:
                until(made.is_healthy, "a healthy gateway")
                yield made
            finally:
                if process.poll() not in (None, 0):
                    print(log.read_text())  # noqa: T201  (shown by pytest when a test fails)


def test_values_reach_mosquitto_sub_mbpoll_and_pymodbus(plant: Plant) -> None:
    """One number, three ways; zero gap violations on the line."""
    assert plant.retained("tosvert/hall-3/status") == "online"
    assert plant.retained("tosvert/hall-3/pump-1/availability") == "online"
    assert plant.retained("tosvert/hall-3/pump-1/output_frequency") == "50.00"
    state = json.loads(plant.retained("tosvert/hall-3/fan-1/state"))
    assert state["output_frequency"] == 40.0
    assert state["quality"] == "good"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", state["time"])

    assert "[64768]: \t5000" in plant.mbpoll("-a", "1", "-t", "4", "-r", "64768", "-c", "1")
    assert "[64768]: \t2000" in plant.mbpoll("-a", "2", "-t", "3", "-r", "64768", "-c", "1")

    words = plant.words(255, 0, 48)
    assert isinstance(words, list)
    for block, hundredths in zip((words[0:16], words[16:32], words[32:48]), (5000, 2000, 4000), strict=True):
        assert block[0] == 0
        assert block[1] == 0
        assert block[2] < 1000
        assert block[4] == hundredths
    assert plant.line.stats()["gap_violations"] == 0


@pytest.mark.parametrize("protocol", ["toshiba-ascii", "toshiba-binary"])
def test_drives_as_shipped_are_read_provisioned_and_tell_a_trip(tmp_path: Path, protocol: str) -> None:
    """F829 = 0, no selector set: values at once; binary asks for a reset and uses the block behind it."""
    shipped = [{"number": drive["number"], "model": drive["model"], "protocol": "toshiba"} for drive in DRIVES]
    with running(tmp_path, shipped, f'protocol = "{protocol}"\nprovision = true') as plant:
        wanted = "true" if protocol == "toshiba-binary" else "false"
        until(lambda: plant.retained("tosvert/hall-3/pump-1/reset_needed") == wanted, "word of the reset")
        plant.line.do({"do": "run", "drive": 1, "frequency": 30.0})
        until(lambda: plant.retained("tosvert/hall-3/pump-1/output_frequency") == "30.00", "the frequency")
        if protocol == "toshiba-binary":
            plant.line.do({"do": "power_cycle", "drive": 1})
            until(lambda: plant.retained("tosvert/hall-3/pump-1/reset_needed") == "false", "the reset to be seen")
            writes = plant.line.state(1)["eeprom_writes"]
            assert writes == {f"{address:04X}": 1 for address in range(0x0875, 0x087A)}
            assert 'tosvert_drive_eeprom_writes_total{drive="pump-1",line="a",number="0875"} 1.0' in plant.metrics()
        plant.line.do({"do": "trip", "drive": 1, "code": 1})
        until(lambda: plant.retained("tosvert/hall-3/pump-1/tripped") == "true", "the trip")
        until(lambda: plant.retained("tosvert/hall-3/pump-1/trip_code") == "1", "its code")
        assert plant.line.stats()["gap_violations"] == 0


@pytest.mark.hazard("H19")
@pytest.mark.hazard("H27")
def test_exceptions_say_what_is_wrong(plant: Plant) -> None:
    """02 not polled, 0AH unknown unit, 0BH a silent drive, 01 a write; and never an old number."""
    assert plant.words(1, 0xFD02, 1) == 2
    assert plant.words(77, 0xFD00, 1) == 0x0A
    with ModbusTcpClient("127.0.0.1", port=plant.tcp) as client:
        assert client.write_register(0xFA00, 0x8400, device_id=1).exception_code == 1
    plant.line.do({"do": "silence", "drive": 1})
    until(lambda: plant.words(1, 0xFD00, 1) == 0x0B, "exception 0BH")
    until(lambda: plant.retained("tosvert/hall-3/pump-1/availability") == "offline", "offline on MQTT")
    assert plant.retained("tosvert/hall-3/pump-1/output_frequency") == ""
    assert json.loads(plant.retained("tosvert/hall-3/pump-1/state"))["output_frequency"] is None
    status, body = plant.health()
    assert status == 503
    assert "pump-1" in json.dumps(body)
    assert plant.words(2, 0xFD00, 1) == [2000]
    plant.line.do({"do": "silence", "drive": 1, "on": False})
    until(lambda: plant.words(1, 0xFD00, 1) == [5000], "the drive's return")
    until(plant.is_healthy, "health")


@pytest.mark.hazard("H14")
def test_the_adapter_is_unplugged_and_plugged_again(plant: Plant) -> None:
    """0AH meanwhile; afterwards everything is read again."""
    plant.line.unplug()
    until(lambda: plant.words(1, 0xFD00, 1) == 0x0A, "exception 0AH")
    assert plant.health()[0] == 503
    plant.line.plug()
    until(lambda: plant.words(1, 0xFD00, 1) == [5000], "values after replugging")


@pytest.mark.hazard("H36")
def test_a_second_gateway_is_told_who_has_the_port(plant: Plant, tmp_path: Path) -> None:
    """It goes on trying, and disturbs nobody."""
    folder = tmp_path / "second"
    folder.mkdir()
    web = free_port()
    second = write_config(folder, str(tmp_path / "line"), plant.broker.port, free_port(), web)
    second.write_text(second.read_text().replace('"hall-3"', '"hall-4"'))
    with gateway(second, folder / "log") as process:
        until(lambda: "in use by" in (folder / "log").read_text(), "the second gateway's word")
        assert str(plant.process.pid) in (folder / "log").read_text()
        assert process.poll() is None
    assert plant.words(1, 0xFD00, 1) == [5000]


def test_a_port_in_use_is_reported_with_its_key_and_no_traceback(plant: Plant) -> None:
    """Exit code 69."""
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "run", str(plant.config)], capture_output=True, text=True, check=False,
        timeout=LIMIT,
    )  # fmt: skip
    assert done.returncode == 69
    assert "modbus_tcp.listen" in done.stderr
    assert "Traceback" not in done.stderr


def test_sigterm_ends_in_order(plant: Plant) -> None:
    """Exit code 0; offline on MQTT, no value left as if it were new."""
    plant.process.send_signal(signal.SIGTERM)
    assert plant.process.wait(LIMIT) == 0
    assert plant.retained("tosvert/hall-3/status") == "offline"
    assert plant.retained("tosvert/hall-3/pump-1/availability") == "offline"


def test_a_killed_gateway_is_offline_by_its_will(plant: Plant) -> None:
    """The broker says it for a process that had no time to."""
    plant.process.kill()
    until(lambda: plant.retained("tosvert/hall-3/status") == "offline", "the will")


def test_the_broker_restarts_and_everything_is_there_again(plant: Plant) -> None:
    """Values go on over MODBUS-TCP meanwhile; the whole state is published after the restart."""
    plant.broker.stop()
    assert plant.words(1, 0xFD00, 1) == [5000]
    plant.broker.start()
    until(lambda: plant.retained("tosvert/hall-3/pump-2/output_frequency") == "20.00", "the state after the restart")


def test_metrics_are_prometheus_text_and_count(plant: Plant) -> None:
    """Exchanges grow, the line is up."""
    text = plant.metrics()
    assert 'tosvert_line_up{line="a"} 1.0' in text
    found = re.search(r'^tosvert_line_exchanges_total\{line="a"\} (\S+)$', text, re.MULTILINE)
    assert found is not None
    assert float(found[1]) > 10


@pytest.mark.parametrize("loop", ["uvloop", "asyncio"])
def test_both_event_loops_serve(tmp_path: Path, loop: str) -> None:
    """--loop chooses; without a broker the rest works, and health does not depend on it."""
    link = tmp_path / "line"
    config = SimulatedLineConfig.model_validate({"drive": DRIVES, "link": str(link)})
    with SimulatedLine(config) as line, Mosquitto() as broker:
        broker.stop()
        tcp, web = free_port(), free_port()
        file = write_config(tmp_path, str(link), broker.port, tcp, web)
        with gateway(file, tmp_path / "log", "--loop", loop) as process:
            made = Plant(line, broker, file, tcp, web, process, tmp_path / "log")
            until(lambda: made.health()[0] and made.words(3, 0xFD00, 1) == [4000], "values")
            process.terminate()
            assert process.wait(LIMIT) == 0
        assert line.stats()["gap_violations"] == 0


def test_a_wrong_configuration_ends_with_78_and_every_error(tmp_path: Path) -> None:
    """No traceback, file and key in each line."""
    file = tmp_path / "gateway.toml"
    file.write_text('[gateway]\nname = "x"\ncolour = 1\n[[line]]\nname = "a"\nport = "ttyS0"\n[[line.drive]]\n')
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "check", str(file)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 78
    for key in ("gateway.colour", "line[0].port", "line[0].drive[0].name"):
        assert key in done.stderr
    assert "Traceback" not in done.stderr


def test_a_missing_device_is_waited_for(tmp_path: Path) -> None:
    """The gateway runs, says what is missing, and MODBUS-TCP answers 0AH."""
    tcp, web = free_port(), free_port()
    file = write_config(tmp_path, "/dev/serial/by-id/none", free_port(), tcp, web)
    log = tmp_path / "log"
    with gateway(file, log) as process:
        until(lambda: "no such device" in log.read_text(), "the reason")
        until(lambda: _answers(tcp, 0x0A), "exception 0AH")
        assert process.poll() is None


def _answers(tcp: int, code: int) -> bool:
    with contextlib.suppress(OSError), ModbusTcpClient("127.0.0.1", port=tcp, timeout=2) as client:
        answer = client.read_holding_registers(0xFD00, count=1, device_id=1)
        return bool(answer.exception_code == code)
    return False


def test_the_demonstration_runs_and_ends(tmp_path: Path) -> None:
    """The whole of it for a few seconds; its processes are gone afterwards."""
    pytest.importorskip("amqtt")
    ports = [free_port() for _ in range(3)]
    done = subprocess.run(
        [sys.executable, "-m", "gateway", "demo", "--mqtt-port", str(ports[0]), "--modbus-tcp-port", str(ports[1]),
         "--web-port", str(ports[2]), "--seconds", "12"],
        capture_output=True, text=True, check=False, timeout=60, env=os.environ | {"COLUMNS": "120"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "exchanges a second" in done.stdout
    assert "42.50" in done.stdout
    assert "Traceback" not in done.stderr
