"""The frames of a running gateway: by tshark, as text, after a fault, and with somebody who does not read."""

from __future__ import annotations

import csv
import json
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig
from tests.mosquitto import program
from tests.processes import gateway, until

pytestmark = pytest.mark.e2e

LIMIT = 60.0  # seconds after which a program is given up
DRIVES = [
    {"number": 1, "model": "vf-nc3", "block_read": [1, 2, 3, 4, 5], "running_at": 50.0},
    {"number": 2, "model": "vf-nc3"},
    {"number": 3, "model": "vf-mb1", "protocol": "toshiba"},
]
FILE = """
[gateway]
name = "hall-3"
[trace]
pause = "100ms"
[[line]]
name = "a"
port = "{port}"
"""
DRIVE = """
[[line.drive]]
name = "d{number}"
number = {number}
model = "{model}"
protocol = "{protocol}"
poll = [{{ values = ["status", "output_frequency"], every = "50ms" }}]
"""
FIELDS = ["frame.protocols", "exported_pdu.exported_pdu", "mbrtu.crc16.status", "_ws.malformed", "_ws.col.Info"]


@dataclass
class Plant:
    """A simulated line, and the gateway as a process on it."""

    folder: Path
    line: SimulatedLine
    process: subprocess.Popen[str]

    def trace(self, *options: str) -> subprocess.CompletedProcess[str]:
        """Run the command."""
        return subprocess.run(
            [sys.executable, "-m", "gateway", "trace", str(self.folder / "gateway.toml"), *options],
            capture_output=True, text=True, check=False, timeout=LIMIT, cwd=self.folder,
        )  # fmt: skip

    @property
    def files(self) -> list[Path]:
        """Return the captures that were written after faults."""
        return sorted((self.folder / "traces").glob("*.pcapng"))


@contextmanager
def running(folder: Path, *options: str) -> Iterator[Plant]:
    """Start both, and wait until every drive is online."""
    link, config, log = folder / "line", folder / "gateway.toml", folder / "log"
    text = FILE.format(port=link)
    for drive in DRIVES:
        protocol = "toshiba-ascii" if "protocol" in drive else "modbus-rtu"
        text += DRIVE.format(number=drive["number"], model=drive["model"], protocol=protocol)
    config.write_text(text)
    simulated = SimulatedLineConfig.model_validate({"drive": DRIVES, "link": str(link)})
    with SimulatedLine(simulated) as line, gateway(config, log, *options) as process:
        until(lambda: all(f"d{drive['number']} is online" in log.read_text() for drive in DRIVES), "the drives")
        heard = line.state(2)["messages_acknowledged"]
        until(lambda: line.state(2)["messages_acknowledged"] > heard + 20, "some polls")
        yield Plant(folder, line, process)


def dissected(capture: Path, *options: str) -> list[dict[str, str]]:
    """Let Wireshark's dissector take a capture apart; a row for each frame."""
    done = subprocess.run(
        [
            *[program("tshark"), "-r", str(capture), "-o", "mbrtu.crc_verification:TRUE", *options],
            *["-T", "fields", "-E", "header=y", "-E", "separator=,", "-E", "quote=d"],
            *[word for field in FIELDS for word in ("-e", field)],
        ],
        capture_output=True, text=True, timeout=LIMIT, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return list(csv.DictReader(done.stdout.splitlines()))


def carried(line: SimulatedLine) -> list[dict[str, Any]]:
    """Return the frames that the simulated line itself has in its log."""
    return [entry for entry in line.log(10_000) if entry["way"] in ("request", "heard")]


def test_a_capture_of_everything_is_what_was_on_the_wire_and_tshark_finds_nothing_malformed(tmp_path: Path) -> None:
    """Byte for byte as the line's own log has it; every Modbus frame with a right CRC, queries and responses."""
    capture = tmp_path / "all.pcapng"
    with running(tmp_path, "--trace", str(capture)) as plant:
        plant.process.send_signal(signal.SIGTERM)
        assert plant.process.wait(LIMIT) == 0
        wire = [entry["data"].replace(" ", "").lower() for entry in carried(plant.line)]
    assert len(wire) > 100
    for options in ((), ("-o", "mbrtu.udp.port:502", "-o", "mbrtu.tcp.port:502")):
        rows = dissected(capture, *options)
        assert [row["exported_pdu.exported_pdu"] for row in rows] == wire[: len(rows)]
        assert len(wire) - len(rows) in (0, 1)  # an answer may have been on its way when the gateway ended
        assert {row["_ws.malformed"] for row in rows} == {""}
        modbus = [row for row in rows if "mbrtu" in row["frame.protocols"]]
        assert {row["mbrtu.crc16.status"] for row in modbus} == {"1"}
        said = [row["_ws.col.Info"].split(":")[0].strip() for row in modbus]
    assert set(said) == {"Query", "Response"}
    assert said.count("Query") == sum(not data.startswith("28") for data in wire[: len(rows) : 2])
    assert len(modbus) < len(rows)  # the TOSHIBA drive's are bytes


def test_the_ring_as_text_and_as_a_capture(tmp_path: Path) -> None:
    """Without touching the line: the same frames either way, each request with its gap of 3.5 characters at least."""
    with running(tmp_path) as plant:
        text = plant.trace()
        assert (text.returncode, text.stderr) == (0, "")
        lines = text.stdout.splitlines()
        written = plant.trace("-o", "ring.pcapng")
        assert re.fullmatch(r"\d+ frames in ring\.pcapng\n", written.stderr)
        assert plant.line.stats()["gap_violations"] == 0
    assert any("d1 read" in line for line in lines)
    assert any("<- (03RFD00" in line for line in lines)
    gaps = [float(found) for line in lines for found in re.findall(r"gap ([\d.]+) ms", line)]
    assert len(gaps) > 20
    assert min(gaps) >= 2.0  # 3.5 characters of 11 bits at 19200 baud, rounded
    rows = dissected(tmp_path / "ring.pcapng")
    assert len(rows) >= len(lines)
    assert {row["_ws.malformed"] for row in rows} == {""}


def test_following_shows_frames_as_they_come_until_ctrl_c(tmp_path: Path) -> None:
    """In the order of time; the end is no error."""
    with running(tmp_path) as plant:
        command = [sys.executable, "-m", "gateway", "trace", str(tmp_path / "gateway.toml"), "--follow"]
        follower = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert follower.stdout is not None
        lines = [follower.stdout.readline() for _ in range(40)]
        follower.send_signal(signal.SIGINT)
        _, errors = follower.communicate(timeout=LIMIT)
        assert (follower.returncode, errors) == (0, "")
        times = [line.split()[0] for line in lines]
        assert times == sorted(times)
        assert {line.split()[2] for line in lines} == {"->", "<-"}
        assert plant.process.poll() is None


def test_those_who_do_not_read_harm_nobody(tmp_path: Path) -> None:
    """Four that never read: another one misses nothing, and the line keeps its pace."""
    with running(tmp_path) as plant, ExitStack() as stack:
        for _ in range(4):
            idle = stack.enter_context(socket.socket(socket.AF_UNIX))
            idle.connect(str(tmp_path / "trace-hall-3.sock"))
            idle.sendall(json.dumps({"do": "follow"}).encode() + b"\n")
        before = plant.line.stats()
        done = plant.trace("--seconds", "4", "-o", "live.pcapng")
        after = plant.line.stats()
        assert done.returncode == 0
        assert "missing" not in done.stderr
        assert after["gap_violations"] == 0
        requests = after["requests"] - before["requests"]
    assert requests > 100
    assert len(dissected(tmp_path / "live.pcapng")) > 100


def test_a_fault_leaves_a_capture_of_what_was_before_and_after(tmp_path: Path) -> None:
    """A drive that falls silent; then a port that is pulled out. Both open in Wireshark."""
    with running(tmp_path) as plant:
        plant.line.do({"do": "fault", "kind": "cut", "drive": 2})
        until(lambda: len(plant.files) == 1, "a capture")
        comments = subprocess.run(
            [program("tshark"), "-r", str(plant.files[0]), "-T", "fields", "-e", "frame.comment"],
            capture_output=True, text=True, timeout=LIMIT, check=True,
        ).stdout.splitlines()  # fmt: skip
        assert any("d2" in comment and comment.endswith(": answered") for comment in comments)
        assert any("d2" in comment and "no reply" in comment for comment in comments)
        log = tmp_path / "log"
        plant.line.do({"do": "unplug"})
        until(lambda: "d1: line down" in log.read_text(), "a second capture")
        assert {row["_ws.malformed"] for path in plant.files for row in dissected(path)} == {""}


def test_where_no_gateway_runs_the_command_says_so(tmp_path: Path) -> None:
    """With the place that it looked at; and a killed gateway's socket is told from none at all."""
    with running(tmp_path) as plant:
        plant.process.kill()
        plant.process.wait(LIMIT)
        done = plant.trace()
        assert done.returncode == 69
        assert "is it running" in done.stderr
        assert f"{tmp_path}/trace-hall-3.sock: nobody serves it" in done.stderr
        (tmp_path / "trace-hall-3.sock").unlink()
        assert f"{tmp_path}/trace-hall-3.sock: No such file" in plant.trace("--follow").stderr


def test_the_end_of_the_gateway_ends_who_follows(tmp_path: Path) -> None:
    """And that is said; the socket is gone."""
    with running(tmp_path) as plant:
        command = [sys.executable, "-m", "gateway", "trace", str(tmp_path / "gateway.toml"), "-f"]
        follower = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert follower.stdout is not None
        follower.stdout.readline()
        plant.process.send_signal(signal.SIGTERM)
        _, errors = follower.communicate(timeout=LIMIT)
        assert (follower.returncode, errors) == (69, "tosvert-gateway: the gateway has ended\n")
        assert plant.process.wait(LIMIT) == 0
        assert not (tmp_path / "trace-hall-3.sock").exists()
