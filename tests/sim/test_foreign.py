"""What programs that know nothing of this project make of the simulated line."""

from __future__ import annotations

import csv
import json
import select
import subprocess
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import ModbusSerialClient
from pymodbus.exceptions import ModbusIOException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationResponse

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig

pytestmark = pytest.mark.e2e

PATIENCE = 30.0  # seconds for what takes milliseconds
READ, EXCHANGE = 0x03, 0x17
TURNAROUND = 0.02  # seconds behind a broadcast
SILENCE = 0.1  # seconds that a master waits where no answer is to come
BLOCK = {"block_read": [1, 2, 3, 4, 5], "block_write": [1, 3]}
DRIVES = [
    {"number": 1, "model": "vf-nc3", "running_at": 30.0, "stable_bits": True, **BLOCK},
    *({"number": number, "model": "vf-mb1", **BLOCK} for number in (2, 3, 4)),
    {"number": 40, "model": "vf-nc3"},
    {"number": 5, "model": "vf-nc3", "protocol": "toshiba", "running_at": 20.0},
]


@pytest.fixture(scope="class")
def line() -> Iterator[SimulatedLine]:
    """Run a line of both protocols for the tests of a class: each that changes a drive has its own."""
    with SimulatedLine(SimulatedLineConfig.model_validate({"drive": DRIVES})) as running:
        yield running


def keep_gap() -> None:
    """Let 3.5 characters pass at 19200 baud: these masters do not."""
    select.select([], [], [], 0.003)


class PyModbus:
    """pymodbus as a master that keeps the gap."""

    def __init__(self, port: str) -> None:
        self._client = ModbusSerialClient(port, baudrate=19200, parity="N", stopbits=2, timeout=5, retries=0)
        assert self._client.connect()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        """Return one of its functions."""
        keep_gap()
        function: Callable[..., Any] = getattr(self._client, name)
        return function

    def hears_nothing(self, name: str, *arguments: Any, **keywords: Any) -> bool:
        """Call a function, and say whether there was no answer."""
        self._client.comm_params.timeout_connect = SILENCE
        try:
            getattr(self, name)(*arguments, **keywords)
        except ModbusIOException:
            return True
        finally:
            self._client.comm_params.timeout_connect = 5
        return False

    def close(self) -> None:
        """Close the port."""
        self._client.close()  # type: ignore[no-untyped-call]


@pytest.fixture
def master(line: SimulatedLine) -> Iterator[PyModbus]:
    """Open pymodbus on the port."""
    client = PyModbus(line.port)
    yield client
    client.close()


class TestPyModbus:
    def test_it_reads_one_word_and_blocks(self, master: PyModbus) -> None:
        """03H in its three forms."""
        assert master.read_holding_registers(0xFD00, count=1, device_id=1).registers == [3000]
        status, frequency, current, voltage, alarm = master.read_holding_registers(
            0x1875, count=5, device_id=1
        ).registers
        assert (status & 0x7FFF, frequency, alarm) == (0x6400, 3000, 0)
        assert 3000 < current < 5000
        assert 5000 < voltage < 5500
        direct = master.read_holding_registers(0x0130, count=5, device_id=1).registers
        assert [word == 0x8000 for word in direct] == [False, True, False, True, True]

    def test_it_writes_one_word_in_two_ways(self, master: PyModbus) -> None:
        """06H, and 10H with one word."""
        for write, word in ((master.write_register, 1234), (master.write_registers, [4321])):
            keep_gap()
            assert not write(0xFA01, word, device_id=2).isError()
            expected = word if isinstance(word, list) else [word]
            assert master.read_holding_registers(0xFA01, count=1, device_id=2).registers == expected

    def test_it_writes_the_block(self, master: PyModbus, line: SimulatedLine) -> None:
        """10H at 1870H starts the motor, without a write to the EEPROM."""
        assert not master.write_registers(0x1870, [0xC400, 2500], device_id=4).isError()
        assert master.read_holding_registers(0xFA01, count=1, device_id=4).registers == [2500]
        state = line.state(4)
        assert (state["is_running"], state["eeprom_writes"]) == (True, {})

    def test_it_writes_and_reads_in_one_exchange(self, master: PyModbus) -> None:
        """17H reads as it stood before what it writes."""
        block = {"read_address": 0x1875, "read_count": 2, "write_address": 0x1870, "device_id": 3}
        answer = master.readwrite_registers(values=[0xC400, 2500], **block)
        assert answer.registers[1] == 0
        assert master.read_holding_registers(0xFA01, count=1, device_id=3).registers == [2500]

    @pytest.mark.parametrize("code", [1, 2, 3])
    def test_it_identifies_drives(self, master: PyModbus, code: int) -> None:
        """2BH, MEI type 0EH, by each read code that the client has for streams."""
        for number, form in ((1, b"VFnC3"), (2, b"VFMB1")):
            answer = master.read_device_information(read_code=code, object_id=0, device_id=number)
            assert isinstance(answer, ReadDeviceInformationResponse)
            assert (answer.information[0], answer.information[2]) == (b"TOSHIBA", b"0100")
            assert answer.information[1].startswith(form)

    def test_identification_by_an_unknown_code_is_an_error(self, master: PyModbus) -> None:
        """Read code 4 is the standard's and not the drives'."""
        answer = master.read_device_information(read_code=4, object_id=0, device_id=1)
        assert answer.exception_code == 3

    @pytest.mark.parametrize(
        ("code", "function", "arguments"),
        [
            (2, "read_holding_registers", {"address": 0x0131, "count": 1}),
            (2, "write_register", {"address": 0xFD00, "value": 1}),
            (3, "read_holding_registers", {"address": 0xFD00, "count": 2}),
            (3, "read_holding_registers", {"address": 0x1875, "count": 6}),
            (3, "read_holding_registers", {"address": 0x1876, "count": 2}),
            (3, "write_register", {"address": 0xFA01, "value": 60000}),
            (3, "write_registers", {"address": 0x1870, "values": [1, 2, 3]}),
            (4, "write_registers", {"address": 0x1870, "values": [0xC400, 6000], "device_id": 40}),
        ],
    )
    def test_it_hears_the_drive_s_errors(
        self, master: PyModbus, code: int, function: str, arguments: dict[str, Any]
    ) -> None:
        """As the standard's exceptions."""
        answer = getattr(master, function)(**({"device_id": 1} | arguments))
        assert answer.exception_code == code

    @pytest.mark.parametrize(
        ("function", "arguments"),
        [
            ("read_coils", {"address": 0}),
            ("read_discrete_inputs", {"address": 0}),
            ("read_input_registers", {"address": 0xFD00}),
            ("write_coil", {"address": 0, "value": True}),
            ("write_coils", {"address": 0, "values": [True]}),
            ("read_exception_status", {}),
            ("diag_query_data", {"msg": b"ab"}),
            ("diag_get_comm_event_counter", {}),
            ("diag_get_comm_event_log", {}),
            ("report_device_id", {}),
            ("mask_write_register", {"address": 0xFA01}),
            ("read_fifo_queue", {"address": 0xFA01}),
        ],
    )
    def test_functions_that_the_drives_do_not_have_are_error_1(
        self, master: PyModbus, function: str, arguments: dict[str, Any]
    ) -> None:
        """All the others that the client has."""
        assert getattr(master, function)(device_id=1, **arguments).exception_code == 1

    def test_a_broadcast_is_obeyed_by_all_and_answered_by_none(self, master: PyModbus, line: SimulatedLine) -> None:
        """Number 0."""
        line.do({"do": "reset_stats"})
        master.write_register(0xFA01, 777, device_id=0, no_response_expected=True)
        select.select([], [], [], TURNAROUND)
        for number in (1, 2, 40):
            assert master.read_holding_registers(0xFA01, count=1, device_id=number).registers == [777]
        assert line.stats()["answers"] == 3

    def test_nobody_answers_under_another_number_or_in_another_protocol(self, master: PyModbus) -> None:
        """Number 9 is nobody's, number 5 speaks TOSHIBA."""
        assert master.hears_nothing("read_holding_registers", 0xFD00, count=1, device_id=9)
        assert master.hears_nothing("read_holding_registers", 0xFD00, count=1, device_id=5)


Done = subprocess.CompletedProcess[str]


class TestMbpoll:
    """The command line of libmodbus."""

    def poll(self, line: SimulatedLine, *arguments: str, write: Sequence[str] = ()) -> Done:
        """Run it once, with addresses as they are on the wire."""
        keep_gap()
        settings = ["-m", "rtu", "-b", "19200", "-P", "none", "-s", "2", "-0", "-q", "-1", "-o", "2"]
        return subprocess.run(
            ["mbpoll", *settings, *arguments, line.port, *write],
            capture_output=True, text=True, timeout=PATIENCE, check=False,
        )  # fmt: skip

    def words(self, line: SimulatedLine, *arguments: str) -> list[int]:
        """Read, and return the words."""
        done = self.poll(line, "-t", "4:hex", *arguments)
        assert done.returncode == 0, done.stderr
        return [int(row.split()[-1], 16) for row in done.stdout.splitlines() if row.startswith("[")]

    def test_it_reads_one_word_and_the_block(self, line: SimulatedLine) -> None:
        """03H."""
        assert self.words(line, "-a", "1", "-r", str(0xFD00)) == [3000]
        assert self.words(line, "-a", "1", "-r", str(0x1875), "-c", "5")[:2] == [0x6400, 3000]

    def test_it_writes_one_word_and_the_block(self, line: SimulatedLine) -> None:
        """06H, and 10H at 1870H."""
        assert self.poll(line, "-a", "2", "-t", "4", "-r", str(0xFA01), write=["4321"]).returncode == 0
        assert self.words(line, "-a", "2", "-r", str(0xFA01)) == [4321]
        written = self.poll(line, "-a", "2", "-t", "4", "-r", str(0x1870), write=["0xC400", "2500"])
        assert written.returncode == 0, written.stderr
        assert self.words(line, "-a", "2", "-r", str(0xFA01)) == [2500]

    def test_it_polls_several_drives_without_a_gap(self, line: SimulatedLine) -> None:
        """The second request follows the first answer at once; where no drive can hear it then, the line says why."""
        line.do({"do": "reset_stats"})
        done = self.poll(line, "-a", "1,2", "-t", "4", "-r", str(0xFD00), "-o", "0.2")
        counted = line.stats()
        assert counted["answers"] == done.stdout.count(f"[{0xFD00}]")
        assert counted["lost"] == 2 - counted["answers"] == counted["gap_violations"] + counted["collisions"]

    def test_it_says_what_a_drive_refuses(self, line: SimulatedLine) -> None:
        """In the words of the standard."""
        for arguments, words in [
            (["-t", "4", "-r", str(0x0131)], "Illegal data address"),
            (["-t", "4", "-r", str(0xFD00), "-c", "2"], "Illegal data value"),
            (["-t", "3", "-r", str(0xFD00)], "Illegal function"),
        ]:
            done = self.poll(line, "-a", "1", *arguments)
            assert words in done.stderr, done.stderr


FIELDS = [
    *["frame.number", "frame.protocols", "mbrtu.unit_id", "modbus.func_code", "modbus.exception_code"],
    *["modbus.reference_num", "modbus.word_cnt", "modbus.regval_uint16", "modbus.data", "modbus.object_str_value"],
    *["mbrtu.crc16.status", "modbus.request_frame", "_ws.malformed", "_ws.col.Info"],
]


def dissected(capture: Path, *options: str) -> list[dict[str, str]]:
    """Let Wireshark's dissector take a capture apart; a row for each frame."""
    prefer = ["mbrtu.udp.port:502", "mbrtu.tcp.port:502", "mbrtu.crc_verification:TRUE"]
    done = subprocess.run(
        [
            *["tshark", "-r", str(capture), "-T", "fields", "-E", "header=y", "-E", "separator=,", "-E", "quote=d"],
            *["-E", "aggregator=;"],
            *[word for preference in prefer for word in ("-o", preference)],
            *[word for field in FIELDS for word in ("-e", field)],
            *options,
        ],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return list(csv.DictReader(done.stdout.splitlines()))


def called(master: PyModbus) -> list[ModbusPDU]:
    """Use each function, good and refused."""
    block = {"read_address": 0x1875, "read_count": 5, "write_address": 0x1870}
    return [
        master.read_holding_registers(0xFD00, count=1, device_id=1),
        master.read_holding_registers(0x1875, count=5, device_id=1),
        master.read_holding_registers(0x1875, count=6, device_id=1),
        master.read_holding_registers(0x0130, count=3, device_id=2),
        master.read_holding_registers(0x0131, count=1, device_id=1),
        master.write_register(0xFA01, 1234, device_id=2),
        master.write_registers(0x1870, [0xC400, 2500], device_id=2),
        master.write_registers(0x1870, [0xC400, 2500], device_id=40),
        master.readwrite_registers(values=[0xC400, 2000], device_id=1, **block),
        master.read_device_information(read_code=1, object_id=0, device_id=1),
        master.read_device_information(read_code=4, object_id=0, device_id=1),
        master.read_coils(0, count=1, device_id=1),
    ]


class TestTshark:
    def test_it_finds_no_frame_malformed_and_each_field_as_it_was_sent(
        self, line: SimulatedLine, master: PyModbus, tmp_path: Path
    ) -> None:
        """Every function, good and refused: units, functions, exceptions, addresses and words; every CRC is right."""
        capture = tmp_path / "line.pcap"
        line.do({"do": "capture", "file": str(capture)})
        answers = called(master)
        line.do({"do": "capture"})
        rows = dissected(capture)
        requests, responses = rows[::2], rows[1::2]
        assert len(requests) == len(responses) == len(answers)
        assert {row["_ws.malformed"] for row in rows} == {""}
        assert {row["mbrtu.crc16.status"] for row in rows} == {"1"}
        assert {row["_ws.col.Info"].split(":")[0].strip() for row in requests} == {"Query"}
        assert {row["_ws.col.Info"].split(":")[0].strip() for row in responses} == {"Response"}
        for row, answer in zip(responses, answers, strict=True):
            assert int(row["mbrtu.unit_id"]) == answer.dev_id
            assert int(row["modbus.func_code"]) == answer.function_code & 0x7F
            exception = getattr(answer, "exception_code", None) if answer.isError() else None
            assert row["modbus.exception_code"] == ("" if exception is None else str(exception))
            words = answer.registers if exception is None else []
            if answer.function_code == READ:
                assert row["modbus.regval_uint16"] == ";".join(map(str, words))
            elif answer.function_code == EXCHANGE:
                assert row["modbus.data"] == "".join(f"{word:04x}" for word in words)
        assert (requests[1]["modbus.reference_num"], requests[1]["modbus.word_cnt"]) == (str(0x1875), "5")
        assert responses[5]["modbus.data"] == "04d2"
        assert responses[9]["modbus.object_str_value"] == "TOSHIBA;VFnC3-2007P;0100"

    def test_its_frames_are_those_of_the_log(self, line: SimulatedLine, master: PyModbus, tmp_path: Path) -> None:
        """Byte for byte, in their order."""
        capture = tmp_path / "line.pcap"
        line.do({"do": "capture", "file": str(capture)})
        answers = called(master)
        log = [entry["data"].replace(" ", "").lower() for entry in line.log() if entry["way"] in ("request", "heard")]
        line.do({"do": "capture"})
        done = subprocess.run(
            ["tshark", "-r", str(capture), "-T", "json", "-e", "udp.payload"],
            capture_output=True, text=True, timeout=PATIENCE, check=True,
        )  # fmt: skip
        payloads = [packet["_source"]["layers"]["udp.payload"][0] for packet in json.loads(done.stdout)]
        assert len(payloads) == 2 * len(answers)
        assert payloads == log[-len(payloads) :]

    @pytest.mark.parametrize(
        ("fault", "sign"),
        [
            ({"kind": "flip"}, lambda row: row["mbrtu.crc16.status"] == "0"),
            ({"kind": "truncate", "value": 3}, lambda row: "mbrtu" not in row["frame.protocols"]),
            ({"kind": "truncate", "value": 6}, lambda row: row["mbrtu.crc16.status"] == "0"),
        ],
    )
    def test_it_sees_what_a_fault_does(
        self,
        line: SimulatedLine,
        master: PyModbus,
        tmp_path: Path,
        fault: dict[str, Any],
        sign: Callable[[dict[str, str]], bool],
    ) -> None:
        """The judge is not blind: the frame that was hit, and no other, is wrong to it."""
        capture = tmp_path / "line.pcap"
        line.do({"do": "capture", "file": str(capture)})
        master.read_holding_registers(0xFD00, count=1, device_id=1)
        line.do({"do": "fault", "drive": 2, "count": 1, **fault})
        assert master.hears_nothing("read_holding_registers", 0xFD00, count=1, device_id=2)
        master.read_holding_registers(0xFD00, count=1, device_id=1)
        line.do({"do": "capture"})
        assert [sign(row) for row in dissected(capture)] == [False, False, False, True, False, False]

    def test_frames_of_toshiba_go_another_way(self, line: SimulatedLine, tmp_path: Path) -> None:
        """On a port of their own, so that they are not taken for MODBUS; number 40 begins as they do, and is."""
        capture = tmp_path / "line.pcap"
        line.do({"do": "capture", "file": str(capture)})
        with Path(line.port).open("r+b", buffering=0) as port:
            for request in (b"(RFD00)\r", bytes.fromhex("2F 52 FD 00 7E"), bytes.fromhex("28 03 FD 00 00 01 B2 5F")):
                keep_gap()
                port.write(request)
                assert select.select([port], [], [], PATIENCE)[0]
                port.read(64)
        line.do({"do": "capture"})
        rows = dissected(capture)
        assert {row["_ws.malformed"] for row in rows} == {""}
        assert ["mbrtu" in row["frame.protocols"] for row in rows] == [False] * 4 + [True] * 2
        assert {row["mbrtu.unit_id"] for row in rows[4:]} == {"40"}
