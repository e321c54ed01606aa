"""One gateway process on 1 to 32 lines: what it takes of processor and memory, and what each line gets of its limit.

Every line is polled as fast as it allows, one five-word block after another, with MQTT to a real broker and the
servers on. The lines live in one lean process beside it (bench.remembered_lines), which needs a core of its own; its
lateness is printed, so that one can see when it, and not the gateway, is what holds the lines up.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.whole_gateway import BROKER, FIVE, NAME, PATIENCE, Ports, is_healthy, until
from tests.mosquitto import Mosquitto, free_port

LINES = (1, 4, 8, 16, 32)
BAUD = 19200
TICKS = os.sysconf("SC_CLK_TCK")  # of processor time in a second
KIB = 1024


@dataclass(frozen=True, slots=True)
class Row:
    """What was measured with so many lines: shares of one core and of each line's limit, memory in MiB."""

    lines: int
    drives: int
    processor: float
    memory: float
    rate: float
    share: float
    least_share: float
    violations: int
    late: float


class Lines:
    """The process with the lines."""

    def __init__(self, count: int, drives: int) -> None:
        command = [sys.executable, "-m", "bench.remembered_lines", str(count), str(drives), str(BAUD)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.ports: list[str] = self._told()

    def _told(self) -> list[str]:
        assert self._process.stdout is not None  # noqa: S101 - it was asked for
        told: list[str] = json.loads(self._process.stdout.readline())
        return told

    def counted(self) -> list[dict[str, float]]:
        """Return what each line has counted since the last call."""
        assert self._process.stdin is not None  # noqa: S101 - it was asked for
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self._told()  # type: ignore[return-value]  # the other kind of answer

    def close(self) -> None:
        """End it."""
        self._process.communicate(timeout=PATIENCE)


def _file(ports: list[str], drives: int, own: Ports) -> Iterator[str]:
    """Yield the gateway's configuration."""
    yield f'[gateway]\nname = "{NAME}"\n[mqtt]\nurl = "mqtt://127.0.0.1:{own.broker}"\npublish = ["state"]\n'
    yield f'[modbus_tcp]\nlisten = "127.0.0.1:{own.tcp}"\n[web]\nlisten = "127.0.0.1:{own.web}"\n'
    unit = 0
    for place, port in enumerate(ports):
        yield f'[[line]]\nname = "l{place}"\nport = "{port}"\nbaud = {BAUD}\nparity = "even"\n'
        for number in range(1, drives + 1):
            unit += 1
            yield f'[[line.drive]]\nname = "l{place}-d{number}"\nnumber = {number}\nmodel = "vf-nc3"\n'
            yield f"unit = {unit}\n" if unit < 247 else "unit = 0\n"
            yield f'poll = [{{ values = {FIVE}, every = "0s", max_age = "30s" }}]\n'


@contextlib.contextmanager
def gateway(ports: list[str], drives: int) -> Iterator[tuple[int, Ports]]:
    """Run the gateway on these ports; yield its process id and where it is reached."""
    with Mosquitto(*BROKER) as broker, tempfile.TemporaryDirectory() as folder:
        own = Ports(broker.port, free_port(), free_port())
        config = Path(folder) / "gateway.toml"
        config.write_text("".join(_file(ports, drives, own)))
        command = [sys.executable, "-m", "gateway", "run", str(config)]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as run:
            try:
                yield run.pid, own
            finally:
                run.terminate()
                run.wait(PATIENCE)


def processor_seconds(pid: int) -> float:
    """Return the processor time that a process has taken, in seconds (proc(5))."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def memory(pid: int) -> float:
    """Return the memory that a process has to itself and shares, in MiB (VmRSS)."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / KIB


def measure(count: int, drives: int, seconds: float) -> Row:
    """Measure a gateway on so many lines with so many drives each."""
    lines = Lines(count, drives)
    try:
        with gateway(lines.ports, drives) as (pid, own):
            until(lambda: is_healthy(own), f"{count * drives} drives to be read")
            lines.counted()
            begun, used = time.monotonic(), processor_seconds(pid)
            time.sleep(seconds)
            counted = lines.counted()
            elapsed = time.monotonic() - begun
            used = processor_seconds(pid) - used
            taken = memory(pid)
    finally:
        lines.close()
    shares = [line["busy"] / elapsed for line in counted]
    return Row(
        count,
        drives,
        used / elapsed,
        taken,
        sum(line["requests"] for line in counted) / elapsed,
        statistics.median(shares),
        min(shares),
        int(sum(line["violations"] for line in counted)),
        statistics.median(line["late_p99"] for line in counted),
    )


HEAD = (
    f"{'lines':>5} {'drives':>6}  {'of a core':>9} {'ms/exch.':>8} {'MiB':>6}  {'exch./s':>7}"
    f"  {'share of the limit':>18} {'least':>6}  {'gv':>4} {'late p99':>8}"
)


def row(of: Row) -> str:
    """Return a row as text."""
    each = of.processor / of.rate * 1e3 if of.rate else 0.0
    return (
        f"{of.lines:5} {of.lines * of.drives:6}  {of.processor:9.1%} {each:8.2f} {of.memory:6.0f}  {of.rate:7.0f}"
        f"  {of.share:18.1%} {of.least_share:6.1%}  {of.violations:4} {of.late * 1e3:8.2f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of a measurement")
    parser.add_argument("--drives", type=int, default=8, help="on each line")
    parser.add_argument("--lines", type=int, action="append", help="only so many lines (may be given again)")
    options = parser.parse_args()
    print(f"One gateway process, {BAUD} baud, every line polled as fast as it allows; gv: frames too soon;")
    print("late: the simulated lines' own lateness in ms")
    print(HEAD)
    for count in options.lines or LINES:
        print(row(measure(count, options.drives, options.seconds)), flush=True)


if __name__ == "__main__":
    main()
