"""The commands as a user runs them, on simulated lines behind a pty."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig

pytestmark = pytest.mark.e2e

ROOT = Path(__file__).parents[2]
PATIENCE = 60.0  # seconds for a command that takes a few
DRIVES = [
    {"number": 0, "model": "vf-mb1", "protocol": "toshiba", "registers": {"frequency_points": 1}},
    {"number": 1, "model": "vf-mb1", "protocol": "toshiba", "registers": {"frequency_points": 1}},
    {
        "number": 22,
        "model": "vf-nc3",
        "protocol": "toshiba",
        "running_at": 30.0,
        "registers": {"standard_monitor": 18},
    },
    {"number": 3, "model": "vf-nc3", "running_at": 30.0},
    {"number": 4, "model": "vf-nc3"},
]
FILE = """
[gateway]
name = "g"
[[line]]
name = "a"
port = "{port}"
drive = [
  {{ name = "fan-0", number = 0, unit = 10, model = "vf-mb1", protocol = "toshiba-binary" }},
  {{ name = "fan-1", number = 1, model = "vf-mb1", protocol = "toshiba-ascii" }},
  {{ name = "mixer", number = 22, model = "vf-nc3", protocol = "toshiba-binary" }},
  {{ name = "pump-3", number = 3, model = "vf-nc3" }},
  {{ name = "pump-4", number = 4, model = "vf-nc3" }},
]
[[line.group]]
name = "fans"
drives = ["fan-0", "fan-1"]
"""


@pytest.fixture(scope="module")
def line() -> Iterator[SimulatedLine]:
    """One line for all."""
    with SimulatedLine(SimulatedLineConfig.model_validate({"drive": DRIVES})) as running:
        yield running


@pytest.fixture
def file(line: SimulatedLine, tmp_path: Path) -> str:
    """Return a configuration of the line."""
    path = tmp_path / "gateway.toml"
    path.write_text(FILE.format(port=line.port))
    return str(path)


def command(*arguments: str, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run a command, without a terminal."""
    return subprocess.run(
        [sys.executable, "-m", "gateway", *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        timeout=PATIENCE,
        **{"stdin": subprocess.DEVNULL, **more},
    )


def one(line: SimulatedLine, number: int, model: str, protocol: str) -> list[str]:
    """Return the options for one drive without a file."""
    return ["--port", line.port, "--number", str(number), "--model", model, "--protocol", protocol]


@pytest.mark.parametrize(("number", "protocol"), [(3, "modbus-rtu"), (22, "toshiba-ascii"), (22, "toshiba-binary")])
def test_read_prints_values_in_every_protocol(line: SimulatedLine, number: int, protocol: str) -> None:
    """By name, number and name on the panel; as JSON too."""
    options = one(line, number, "vf-nc3", protocol)
    done = command("read", *options, "output_frequency", "FC90", "F803")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [
        "output_frequency       FD00  0BB8H  3000  30.00 Hz",
        "trip_code              FC90  0000H  0     nerr: No error",
        "communication_timeout  0803  0000H  0     0.0 s",
    ]
    (found,) = json.loads(command("read", *options, "FD00", "--json").stdout)
    assert (found["value"], found["unit"], found["raw"]) == (30.0, "Hz", 3000)


def test_a_refused_read_is_1_and_a_silent_drive_69(line: SimulatedLine) -> None:
    """With the drive's reason, and without a traceback."""
    refused = command("read", *one(line, 3, "vf-nc3", "modbus-rtu"), "0123", "FD00")
    assert refused.returncode == 1
    assert "communication number not known" in refused.stdout
    assert "30.00 Hz" in refused.stdout
    silent = command("read", *one(line, 9, "vf-nc3", "modbus-rtu"), "FD00")
    assert (silent.returncode, silent.stderr) == (69, "tosvert-gateway: number 9: no answer\n")


def test_write_says_what_it_used_and_reads_back(file: str, line: SimulatedLine) -> None:
    """P to RAM by the TOSHIBA protocol."""
    done = command("write", "--config", file, "--drive", "mixer", "F803=1.5")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "writing communication_timeout (0803) = 1.5 s (000FH): P, RAM only: lost when the drive is reset",
        "  mixer: 0.0 s (0000H) -> 1.5 s (000FH): done",
    ]
    assert command("write", "--config", file, "--drive", "mixer", "F803=0").returncode == 0
    assert line.state(22)["number"] == 22


def test_a_group_is_written_to_by_one_frame(file: str) -> None:
    """ASCII and binary drives alike; each is told of."""
    done = command("write", "--config", file, "--group", "fans", "free_notes=7")
    assert done.returncode == 0, done.stderr
    assert "  to 0* (toshiba-ascii): fan-0, fan-1; fan-0 answers" in done.stdout.splitlines()
    assert [line.split(":")[0].strip() for line in done.stdout.splitlines()[2:]] == ["fan-0", "fan-1"]
    everyone = command("write", "--config", file, "--everyone", "free_notes=8")
    assert everyone.returncode == 78
    assert "free_notes (0880) is a stored parameter, and modbus-rtu can write it" in everyone.stderr
    assert everyone.stderr.rstrip().endswith("(--stored)")


def test_what_may_start_a_motor_needs_yes_where_there_is_no_terminal(file: str) -> None:
    """It says so, and sends nothing."""
    asked = command("write", "--config", file, "--drive", "pump-4", "frequency_command=10", "command=run")
    assert asked.returncode == 78
    assert "frequency_command (FA01), command (FA00): a motor may start, or change its speed, and" in asked.stderr
    assert asked.stderr.rstrip().endswith("There is no terminal to ask at: give --yes")
    agreed = command("write", "--config", file, "--drive", "pump-4", "frequency_command=10", "--yes")
    assert agreed.returncode == 0
    assert "0.00 Hz (0000H) -> 10.00 Hz (03E8H): done" in agreed.stdout


@pytest.mark.parametrize(("answer", "code", "word"), [(b"n\n", 1, 0), (b"y\n", 0, 0x0100)])
def test_a_terminal_is_asked(file: str, answer: bytes, code: int, word: int) -> None:
    """No is no; a stop is never asked about."""
    master, slave = pty.openpty()
    try:
        os.write(master, answer)
        done = command("write", "--config", file, "--drive", "pump-4", "command=jog", stdin=slave)
    finally:
        os.close(slave)
        os.close(master)
    assert done.returncode == code, done.stderr
    assert "and nobody watches it afterwards. Go on? [y/N]" in done.stderr
    assert ("done" in done.stdout) is (word != 0)
    (found,) = json.loads(command("read", "--config", file, "--drive", "pump-4", "FA00", "--json").stdout)
    assert found["raw"] == word
    stopped = command("write", "--config", file, "--drive", "pump-4", "command=none", "frequency_command=0")
    assert stopped.returncode == 0, stopped.stderr


def test_display_keys_and_proportional(file: str, line: SimulatedLine) -> None:
    """The panel's text by one frame, its keys by name, a share of each drive's own range."""
    shown = command("display", "--config", file, "--drive", "mixer", "60.0", "--unit", "hz")
    assert shown.returncode == 0, shown.stderr
    assert shown.stdout.splitlines() == [
        "mixer: done: all digits in one frame (X, block_mode (FA80) = 1 meanwhile), RAM only",
        "  shown before: 'dAtA'",
    ]
    number = command("display", "--config", file, "--drive", "mixer", "--value", "12.3")
    assert number.stdout.startswith("mixer: done: one by one, led_selection (FA65) last")
    keys = command("keys", "--config", file, "--drive", "mixer")
    assert keys.stdout.splitlines()[0] == "key_state            FC00  8000H  32768  keys_normal"
    share = command("proportional", "--config", file, "--group", "fans", "50", "--yes")
    assert share.returncode == 0, share.stderr
    assert share.stdout.splitlines() == [
        "50 % to number 0 (toshiba-binary): fan-0: S, RAM only; nobody answers",
        "50 % to number 1 (toshiba-binary): fan-1: S, RAM only; nobody answers",
        "  fan-0: 0.00 Hz -> 30.00 Hz (expected 30.00 Hz): done",
        "  fan-1: 0.00 Hz -> 30.00 Hz (expected 30.00 Hz): done",
    ]


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("times", [1, 3])
def test_display_gives_the_block_back_when_a_signal_ends_it(
    file: str, line: SimulatedLine, by: signal.Signals, times: int
) -> None:
    """Once or again and again, it makes no difference; the exit code is the signal's."""
    arguments = [sys.executable, "-m", "gateway", "display", "--config", file, "--drive", "mixer", "AbCd"]
    with subprocess.Popen(arguments, cwd=ROOT, text=True, stderr=subprocess.PIPE, stdout=subprocess.PIPE) as running:
        while line.state(22)["registers"]["block_mode"] == 0:
            assert running.poll() is None, "it ended before FA80 was seen at 1"
        for _ in range(times):
            running.send_signal(by)
        _, said = running.communicate(timeout=PATIENCE)
    assert line.state(22)["registers"]["block_mode"] == 0
    assert running.returncode == 128 + by
    assert f"broken off by {by.name}" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("shown", [("HI",), ("--value", "1")])
def test_display_writes_to_nobody_where_one_cannot_be_written_to(
    file: str, line: SimulatedLine, shown: tuple[str, ...]
) -> None:
    """The line is mixed: MODBUS-RTU would wear the EEPROM."""
    before = [line.state(number)["registers"] for number in (0, 1, 22)]
    done = command("display", "--config", file, "--everyone", *shown)
    assert (done.returncode, done.stdout) == (78, "")
    assert done.stderr.rstrip().endswith("(--stored)")
    for number, registers in zip((0, 1, 22), before, strict=True):
        now = line.state(number)["registers"]
        assert {key: value for key, value in now.items() if "led" in key} == {
            key: value for key, value in registers.items() if "led" in key
        }


def test_scan_prints_a_configuration_that_check_accepts(line: SimulatedLine, tmp_path: Path) -> None:
    """Written to a file as it comes."""
    done = command("scan", line.port, "--numbers", "0-4,22")
    assert done.returncode == 0, done.stderr
    assert "a pseudo-terminal has no parity" in done.stderr
    for said in (
        "number 0, toshiba-binary: vf-mb1",
        "number 22, toshiba-binary: vf-nc3",
        "number 3, modbus-rtu: vf-nc3",
    ):
        assert said in done.stderr
    path = tmp_path / "found.toml"
    path.write_text(done.stdout)
    checked = command("check", str(path))
    assert checked.returncode == 0, checked.stderr
    assert "drive drive-22: number 22, vf-nc3, toshiba-binary" in checked.stdout
    assert checked.stdout.rstrip().endswith("no errors")


def test_a_wrong_model_is_warned_of_and_not_written_to(line: SimulatedLine) -> None:
    """In TOSHIBA too, where nothing has a name; --any-model writes all the same."""
    wrong = one(line, 22, "vf-mb1", "toshiba-binary")
    said = "number 22: identity mismatch: vf-mb1 is configured, vf-nc3 answers: its series code (FB07) is 208"
    for shown in (command("read", *wrong, "FD00"), command("keys", *wrong)):
        assert shown.returncode == 0
        assert said in shown.stderr
    assert "30.00 Hz" in command("read", *wrong, "FD00").stdout
    refused = command("write", *wrong, "F803=0")
    assert (refused.returncode, refused.stdout) == (78, "")
    assert said in refused.stderr
    written = command("write", *wrong, "F803=0", "--any-model")
    assert written.returncode == 0
    assert said in written.stderr


def test_a_silent_drive_of_a_group_does_not_hold_up_the_others(file: str, line: SimulatedLine) -> None:
    """It is told of in its own line; the exit code is 1."""
    line.do({"do": "fault", "kind": "cut", "drive": 0})
    try:
        done = command("read", "--config", file, "--group", "fans", "FD00")
        shown = command("display", "--config", file, "--group", "fans", "--value", "1")
    finally:
        line.do({"do": "clear_faults"})
    assert done.returncode == 1
    assert "number 0: no answer" in done.stdout.splitlines()[0]
    assert done.stdout.splitlines()[1].startswith("fan-1  output_frequency  FD00")
    assert shown.returncode == 1
    assert "fan-0: not done: nothing was written\n  number 0: no answer\nfan-1: done: one by one" in shown.stdout


def test_scan_has_a_progress_bar_on_a_terminal(line: SimulatedLine) -> None:
    """What is found stands above it; standard output stays a configuration."""
    master, slave = pty.openpty()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "gateway", "scan", line.port, "--numbers", "3,4"],
            stdout=subprocess.PIPE,
            stderr=slave,
            text=True,
            check=False,
            cwd=ROOT,
            timeout=PATIENCE,
        )
        os.set_blocking(master, False)
        shown = os.read(master, 1 << 16).decode()
    finally:
        os.close(slave)
        os.close(master)
    assert done.returncode == 0
    assert "number 3, modbus-rtu: vf-nc3" in shown
    assert "19200 baud, even parity" in shown
    assert done.stdout.startswith("# Written by tosvert-gateway scan")


def test_scan_of_a_line_without_drives_gives_advice(line: SimulatedLine) -> None:
    """Exit code 1, nothing on standard output."""
    done = command("scan", line.port, "--numbers", "90-92", "--protocol", "modbus-rtu")
    assert (done.returncode, done.stdout) == (1, "")
    assert "no drive answers. Look at:" in done.stderr


def test_a_port_that_another_has_is_told_with_its_holder(line: SimulatedLine, file: str) -> None:
    """The gateway's own lock."""
    import fcntl

    port = os.open(line.port, os.O_RDWR | os.O_NOCTTY)
    try:
        fcntl.flock(port, fcntl.LOCK_EX | fcntl.LOCK_NB)
        for arguments in (("scan", line.port), ("read", "--config", file, "--drive", "mixer", "FD00")):
            done = command(*arguments)
            assert done.returncode == 69
            assert f"in use by process {os.getpid()}" in done.stderr
            assert "Traceback" not in done.stderr
    finally:
        os.close(port)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("read", "FD00"), "give --config FILE with --drive"),
        (("read", "--port", "/dev/x", "--number", "1", "--model", "vf-nc3", "no_such"), "vf-nc3 has no register 'no"),
        (("write", "--port", "/dev/x", "--number", "1", "--model", "vf-nc3", "F803"), "give NAME=VALUE"),
        (("write", "--port", "/dev/x", "--number", "1", "--model", "vf-nc3", "FA10=1"), "(--allow-keys)"),
        (("write", "--port", "/dev/x", "--number", "1", "--model", "vf-nc3", "FD00=1"), "is read-only"),
        (("display", "--port", "/dev/x", "--number", "1", "--model", "vf-nc3"), "give a TEXT, or --value NUMBER"),
        (("display", "--port", "/dev/x", "--number", "1", "--model", "vf-nc3", "W"), "cannot show 'W'"),
        (("proportional", "--port", "/dev/x", "--number", "1", "--model", "vf-mb1", "x"), "percent: a number is"),
        (("display", "--port", "/dev/x", "--number", "1", "--model", "vf-nc3", "--value", "-1"), "without sign"),
        (("display", "--port", "/dev/x", "--number", "1", "--model", "vf-nc3", "--value", "\u0661"), "without sign"),
        (("scan", "/dev/x", "--numbers", ""), "--numbers '': give numbers from 0 to 247"),
        (("scan", "/dev/x", "--numbers", "100", "--protocol", "toshiba"), "no protocol that is tried has these"),
        (("keys", "--port", "ttyUSB0", "--number", "1", "--model", "vf-mb1"), "--port: give the whole path"),
        (("scan", "ttyUSB0"), 'ttyUSB0: give the whole path: "/dev/ttyUSB0"'),
        (("scan", "/dev/x", "--baud", "1200"), "--baud 1200: give 9600, 19200, 38400"),
        (("scan", "/dev/x", "--wait-time", "1"), "--wait-time 1: a duration in quotes is wanted"),
    ],
)
def test_what_is_wrong_with_a_call_is_said_in_a_line(arguments: tuple[str, ...], said: str) -> None:
    """Exit code 78 before any port is opened."""
    done = command(*arguments)
    assert done.returncode == 78, done.stderr
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_a_port_that_is_not_there_is_69() -> None:
    """With what to look at."""
    done = command("read", "--port", "/dev/nowhere", "--number", "1", "--model", "vf-nc3", "FD00")
    assert done.returncode == 69
    assert "no such device" in done.stderr
