"""How much of an RS485 line each master uses: time the wire and the drives were necessarily busy / time elapsed."""

from __future__ import annotations

import argparse
import contextlib
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from typing import Any

from bench import whole_gateway
from bench.masters import MASTERS, TIMED
from gateway.sim.process import SimulatedLine

GATEWAY = "tosvert-gateway"
WARM_UP = 2.5  # seconds, in which the gateway identifies its drives


@contextlib.contextmanager
def running(
    name: str, port: str, baud: int, drives: int, more: whole_gateway.More | None = None
) -> Iterator[None]:
    """Run a master, or the whole gateway with its broker and its servers, while the block lasts."""
    if name == GATEWAY:
        with whole_gateway.running(port, baud, drives, more or whole_gateway.More()):
            yield
        return
    command = [sys.executable, "-m", "bench.masters", name, port, str(baud), str(drives)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()
            process.wait(10)


def measure(name: str, baud: int, drives: int, seconds: float) -> dict[str, Any]:
    """Return what the line counted while one master ran, with `share` of the limit and `late`."""
    config = whole_gateway.simulated(baud, drives, running_at=30.0)
    with SimulatedLine(config) as line, running(name, line.port, baud, drives):
        time.sleep(WARM_UP)
        line.do({"do": "reset_stats"})
        begun = time.monotonic()
        time.sleep(seconds)
        counted = line.stats()
        elapsed = time.monotonic() - begun
    return {**counted, "share": counted["busy"] / elapsed, "rate": counted["answers"] / elapsed}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", action="append", help="measure only this master (may be given again)")
    options = parser.parse_args()
    print("Line utilisation: share of the limit (exchanges a second), median of runs; gv: gap violations, all runs")
    print(f"{'master':18}" + "".join(f"{baud} x{drives:<2}{'':14}" for baud in (19200, 38400) for drives in (1, 8)))
    late: list[float] = []
    for name in options.only or [*(name for name in MASTERS if name not in TIMED), GATEWAY]:
        cells = []
        for baud in (19200, 38400):
            for drives in (1, 8):
                runs = [measure(name, baud, drives, options.seconds) for _ in range(options.runs)]
                share = statistics.median(run["share"] for run in runs)
                rate = statistics.median(run["rate"] for run in runs)
                violations = sum(run["gap_violations"] for run in runs)
                late += [run["lateness_p99"] for run in runs]
                cells.append(f"{share:6.1%} ({rate:5.1f}) gv {violations:<4}")
        print(f"{name:18}" + "".join(cells), flush=True)
    print(f"the simulated line's own lateness, 99th percentile: {statistics.median(late) * 1e6:.0f} microseconds")


if __name__ == "__main__":
    main()
