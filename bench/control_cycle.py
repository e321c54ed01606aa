"""One control cycle of a drive, command and frequency given and five values read: in one frame, and in three.

Masters run in processes of their own; the line and its drive are simulated in another. A cycle that failed counts for
no rate and no cycle time; the line says how many frames were lost to whom.
"""

from __future__ import annotations

import contextlib
import json
import statistics
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from bench import one_drive
from bench.control_masters import FREQUENCIES, MASTERS
from bench.figures import milliseconds, percentile
from bench.one_drive import BAUDS, NUMBER
from gateway.protocol.registry import PROTOCOLS
from gateway.sim.process import SimulatedLine

WARM_UP = 0.2  # seconds


@dataclass(frozen=True, slots=True)
class Result:
    """One master: cycles a second (median of runs), cycle times in seconds and counts of all runs.

    The times are None where no cycle was good. `share` is of what bits, gaps and the drive's own time allow.
    """

    master: str
    baud: int
    rate: float
    share: float
    median: float | None
    p99: float | None
    failed: int
    gap_violations: int
    lost: int
    is_obeyed: bool


class Running:
    """A master in a process of its own."""

    def __init__(self, name: str, process: subprocess.Popen[str]) -> None:
        self._name = name
        self._process = process
        self._next()

    def cycles(self, seconds: float) -> dict[str, Any]:
        """Let it do cycles for some seconds, and return what it counted."""
        assert self._process.stdin is not None  # noqa: S101 - PIPE was asked for
        print(seconds, file=self._process.stdin, flush=True)
        counted: dict[str, Any] = json.loads(self._next())
        return counted

    def _next(self) -> str:
        assert self._process.stdout is not None  # noqa: S101 - PIPE was asked for
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"{self._name}: ended with {self._process.wait()}")
        return line


@contextlib.contextmanager
def running(name: str, port: str, baud: int) -> Iterator[Running]:
    """Run a master while the block lasts; closing its standard input ends it."""
    command = [sys.executable, "-m", "bench.control_masters", name, port, str(baud)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        yield Running(name, process)


def measure(line: SimulatedLine, name: str, baud: int, seconds: float, runs: int) -> Result:
    """Measure one master some times on a line that runs."""
    with running(name, line.port, baud) as master:
        master.cycles(WARM_UP)
        line.do({"do": "reset_stats"})
        counts = [master.cycles(seconds) for _ in range(runs)]
    counted, state = line.stats(), line.state(NUMBER)
    times = [time for count in counts for time in count["times"]]
    rate = statistics.median(len(count["times"]) / count["elapsed"] for count in counts)
    of = MASTERS[name]
    return Result(
        name,
        baud,
        rate=rate,
        share=rate * one_drive.least_time(baud, PROTOCOLS[of.protocol], of.requests(FREQUENCIES[0])),
        median=statistics.median(times) if times else None,
        p99=percentile(times, 0.99) if times else None,
        failed=sum(count["failed"] for count in counts),
        gap_violations=counted["gap_violations"],
        lost=counted["lost"],
        is_obeyed=state["is_running"] and state["registers"]["frequency_command"] in FREQUENCIES,
    )


def measured(late: list[float], seconds: float, runs: int) -> Iterator[Result]:
    """Yield the result of each master at each baud rate; add how late each simulated line was to `late`."""
    for baud in BAUDS:
        for name, master in MASTERS.items():
            with SimulatedLine(one_drive.simulated(baud, master.protocol)) as line:
                yield measure(line, name, baud, seconds, runs)
                late.append(line.stats()["lateness_p99"])


def row(result: Result) -> str:
    """Return a result as a line of the table."""
    return (
        f"{result.master:20} {result.baud:5} {result.rate:8.1f} {result.share:7.1%} {milliseconds(result.median):>9} "
        f"{milliseconds(result.p99):>7} {result.failed:6} {result.gap_violations:4} {result.lost:5}  "
        f"{'yes' if result.is_obeyed else 'no'}"
    )


def ratios(results: list[Result]) -> Iterator[str]:
    """Yield how this gateway's cycles stand beside pymodbus at its best, a line for each baud rate."""
    for baud in BAUDS:
        of_baud = [result for result in results if result.baud == baud]
        best = max((r for r in of_baud if r.master.startswith("pymodbus")), key=lambda r: r.rate)
        own = (r for r in of_baud if r.master.startswith("gateway"))
        times = ", ".join(f"{r.master.removeprefix('gateway, ')} {r.rate / best.rate:.2f} x" for r in own)
        yield f"cycles a second at {baud} baud, of the best pymodbus ({best.master}): {times}"


TABLE = one_drive.Table(
    title="Control cycles of one drive",
    head=f"{'master':21} baud cycles/s   share median ms  p99 ms failed   gv  lost  obeyed",
    seconds=1.5,
    measured=measured,
    row=row,
    ratios=ratios,
)

if __name__ == "__main__":
    one_drive.main(__doc__, TABLE)
