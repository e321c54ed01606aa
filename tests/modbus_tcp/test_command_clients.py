"""Foreign MODBUS-TCP clients command simulated drives through a whole gateway: a pty line and its daemon."""

from __future__ import annotations

import socket
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from gateway.modbus_tcp.gateway_unit import UNIT
from gateway.modbus_tcp.mirror_map import LINES_AT, Place
from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig
from tests.modbus_tcp.plant import CODES, mirror
from tests.modbus_tcp.rig import answers, request
from tests.mosquitto import free_port
from tests.processes import LIMIT, gateway, until

pytestmark = pytest.mark.e2e

COMMAND, FREQUENCY = 0xFA00, 0xFA01
RUN, STOP = 0xC400, 0x8000
CONFIG = """
[gateway]
name = "hall-3"
[modbus_tcp]
listen = "127.0.0.1:{tcp}"
[[line]]
name = "a"
port = "{port}"
"""
DRIVE = """
[[line.drive]]
name = "pump-{number}"
number = {number}
model = "vf-nc3"
control = "leased"
sources = ["modbus-tcp"]
lease = "10s"
communication_timeout = "12s"
timeout_action = "stop"
frequency = {{ min = 0.0, max = 60.0 }}
poll = [{{ values = ["status", "output_frequency"], every = "100ms" }}]
"""


@dataclass
class Plant:
    """A simulated line and the gateway as a process."""

    line: SimulatedLine
    tcp: int
    process: subprocess.Popen[str]

    def client(self) -> ModbusTcpClient:
        """Make a pymodbus client."""
        return ModbusTcpClient("127.0.0.1", port=self.tcp, timeout=5)

    def mbpoll(self, *arguments: str) -> tuple[int, str]:
        """Run mbpoll once; return its exit code and all that it prints."""
        done = subprocess.run(
            ["mbpoll", "-m", "tcp", "-p", str(self.tcp), "-0", "-1", "-o", "2", "-t", "4:hex", *arguments],
            capture_output=True, text=True, check=False, timeout=LIMIT,
        )  # fmt: skip
        return done.returncode, done.stdout + done.stderr

    def is_running(self, drive: int = 1) -> bool:
        """Say whether a drive has its run command."""
        return bool(self.line.state(drive)["registers"]["command"] & 0x0400)

    def is_well(self, drive: int) -> bool:
        """Say whether a drive is not tripped."""
        return bool(self.line.state(drive)["trip_code"] == 0)

    def is_ready(self) -> bool:
        """Say whether both drives are online and set up."""
        try:
            with self.client() as client:
                links = client.read_holding_registers(0, count=32, device_id=UNIT).registers
            return bool(links[0] == links[16] == 0 and links[2] < 1000)
        except Exception:  # not listening yet
            return False


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    """Start everything, once; each test leaves the drives stopped and without an owner."""
    folder: Path = tmp_path_factory.mktemp("commands")
    link = folder / "line"
    drives = [{"number": number, "model": "vf-nc3", "block_read": [1, 2, 3, 4, 5]} for number in (1, 2)]
    config = SimulatedLineConfig.model_validate({"drive": drives, "link": str(link)})
    tcp, file, log = free_port(), folder / "gateway.toml", folder / "log"
    file.write_text(CONFIG.format(tcp=tcp, port=link) + DRIVE.format(number=1) + DRIVE.format(number=2))
    with SimulatedLine(config) as line, gateway(file, log) as process:
        made = Plant(line, tcp, process)
        until(made.is_ready, "drives that answer")
        yield made
        assert process.poll() is None, log.read_text()
        assert "Traceback" not in log.read_text()
        assert line.stats()["gap_violations"] == 0


@pytest.fixture(autouse=True)
def at_rest(plant: Plant) -> Iterator[None]:
    """Stop and release afterwards."""
    yield
    with plant.client() as client:
        for index in range(2):
            client.write_register(mirror(Place.COMMAND, index), CODES["stop"], device_id=UNIT)
            client.write_register(mirror(Place.COMMAND, index), CODES["release"], device_id=UNIT)


def is_written(client: ModbusTcpClient, address: int, word: int) -> bool:
    """Write a register of unit 255; say whether that was done."""
    return not client.write_register(address, word, device_id=UNIT).isError()


def permitted(plant: Plant) -> None:
    """Take and arm the first drive."""
    with plant.client() as client:
        for word in ("take", "arm"):
            until(partial(is_written, client, mirror(Place.COMMAND), CODES[word]), word)


def test_pymodbus_writes_one_several_and_reads_and_writes(plant: Plant) -> None:
    """06H, 10H and 17H on the drive's own unit; what comes back is what the drive holds."""
    permitted(plant)
    with plant.client() as client:
        assert not client.write_registers(COMMAND, [RUN, 3000], device_id=1).isError()
        assert plant.is_running()
        assert client.read_holding_registers(COMMAND, count=2, device_id=1).registers == [RUN, 3000]
        both = client.readwrite_registers(
            read_address=FREQUENCY, read_count=1, write_address=FREQUENCY, values=[4000], device_id=1
        )
        assert both.registers == [4000]
        assert not client.write_register(COMMAND, STOP, device_id=1).isError()
        assert not plant.is_running()


def test_pymodbus_is_told_why_not(plant: Plant) -> None:
    """06, 03, 02, 0AH; nothing moves."""
    with plant.client() as client:
        assert client.write_registers(COMMAND, [RUN, 3000], device_id=1).exception_code == 6
        permitted(plant)
        assert client.write_register(FREQUENCY, 6001, device_id=1).exception_code == 3
        assert client.write_register(0xFD00, 1, device_id=1).exception_code == 2
        assert client.write_register(0x0802, 2, device_id=1).exception_code == 2
        assert client.write_register(FREQUENCY, 1000, device_id=0x33).exception_code == 0x0A
        assert client.write_register(FREQUENCY, 1000, device_id=2).exception_code == 6
        assert client.write_coil(0, True, device_id=1).exception_code == 1
    assert not plant.is_running()


def test_mbpoll_takes_arms_runs_and_stops(plant: Plant) -> None:
    """As the manual shows: by hand, with hexadecimal words, 06H for one and 10H for two."""
    for word in ("take", "arm"):
        code, text = plant.mbpoll("-a", str(UNIT), "-r", str(mirror(Place.COMMAND)), "127.0.0.1", hex(CODES[word]))
        assert (code, "Written 1 references" in text) == (0, True), text
    code, text = plant.mbpoll("-a", "1", "-r", str(COMMAND), "127.0.0.1", "0xC400", "0x0BB8")
    assert (code, "Written 2 references" in text) == (0, True), text
    assert plant.is_running()
    code, text = plant.mbpoll("-a", "1", "-r", str(COMMAND), "-c", "2", "127.0.0.1")
    assert "0xC400" in text, text
    assert "0x0BB8" in text, text
    code, text = plant.mbpoll("-a", "1", "-r", str(FREQUENCY), "127.0.0.1", "0xFFFF")
    assert code == 1
    assert "Illegal data value" in text
    code, text = plant.mbpoll("-a", "1", "-r", str(COMMAND), "127.0.0.1", "0x8000")
    assert code == 0, text
    assert not plant.is_running()


def test_mbpoll_without_a_lease_is_told_that_it_is_busy(plant: Plant) -> None:
    """06."""
    code, text = plant.mbpoll("-a", "1", "-r", str(FREQUENCY), "127.0.0.1", "0x03E8")
    assert (code, "busy" in text) == (1, True), text


def test_a_plc_cycle_by_pymodbus(plant: Plant) -> None:
    """17H on the mirror: five outputs, eleven inputs, one request a cycle."""
    heartbeat = 0
    with plant.client() as client:

        def cycle(word: str, sequence: int) -> list[int]:
            nonlocal heartbeat
            heartbeat += 1
            told = client.readwrite_registers(
                read_address=mirror(Place.ECHO), read_count=11, write_address=mirror(Place.COMMAND),
                values=[CODES[word], heartbeat, 2500, 0, sequence], device_id=UNIT,
            )  # fmt: skip
            assert not told.isError(), told
            return list(told.registers)

        def is_done(word: str, sequence: int) -> bool:
            return cycle(word, sequence)[:3] == [sequence, 1, 0]

        for sequence, word in enumerate(("take", "arm", "run"), 1):
            until(partial(is_done, word, sequence), word)
        until(lambda: cycle("run", 3)[9] == 2500, "the frequency")
        until(lambda: is_done("stop", 4), "the stop")
    assert not plant.is_running()


def test_an_emergency_stop_of_the_line(plant: Plant) -> None:
    """One register; both drives trip, and are reset one by one."""
    with plant.client() as client:
        assert not client.write_register(LINES_AT, CODES["emergency_stop"], device_id=UNIT).isError()
        for index, drive in enumerate((1, 2)):
            assert not plant.is_well(drive)
            address = mirror(Place.COMMAND, index)
            until(partial(is_written, client, address, CODES["take"]), "taking")
            told = client.write_register(address, CODES["reset"], device_id=UNIT)
            assert not told.isError() or told.exception_code == 5
            until(partial(plant.is_well, drive), "the reset")


@pytest.mark.hazard("H26")
def test_a_heap_of_requests_in_one_segment_is_answered_in_order(plant: Plant) -> None:
    """Writes and reads behind each other, more than may be in flight, over a real socket."""
    permitted(plant)
    pdus = []
    for i in range(4):
        pdus += [struct.pack(">BHH", 6, FREQUENCY, 1000 + i), *[struct.pack(">BHH", 3, FREQUENCY, 1)] * 9]
    with socket.create_connection(("127.0.0.1", plant.tcp), timeout=LIMIT) as client:
        client.sendall(b"".join(request(i, 1, pdu) for i, pdu in enumerate(pdus)))
        client.shutdown(socket.SHUT_WR)
        stream = b""
        while data := client.recv(4096):
            stream += data
    told = answers(stream)
    assert [transaction for transaction, _, _ in told] == list(range(40))
    assert told[-1][2] == b"\x03\x02" + struct.pack(">H", 1003)
