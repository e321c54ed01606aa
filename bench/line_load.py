"""How much of an RS485 line each master uses: time the wire and the drives were necessarily busy / time elapsed."""

from __future__ import annotations

import argparse
import contextlib
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.masters import MASTERS
from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig
from tests.mosquitto import Mosquitto, free_port

GATEWAY = "tosvert-gateway"
WARM_UP = 2.5  # seconds, in which the gateway identifies its drives
FIVE = '["status", "output_frequency", "output_current", "output_voltage", "alarm"]'


def simulated(baud: int, drives: int) -> SimulatedLineConfig:
    """Return a line of VF-nC3 whose selectors are set, 5 ms in each drive."""
    entries = [
        {"number": number, "model": "vf-nc3", "block_read": [1, 2, 3, 4, 5], "running_at": 30.0}
        for number in range(1, drives + 1)
    ]
    return SimulatedLineConfig.model_validate({"baud": baud, "drive": entries})


@contextlib.contextmanager
def running(name: str, port: str, baud: int, drives: int) -> Iterator[None]:
    """Run a master, or the whole gateway with its broker and its servers, while the block lasts."""
    with contextlib.ExitStack() as stack:
        if name == GATEWAY:
            broker = stack.enter_context(Mosquitto())
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            config = folder / "gateway.toml"
            config.write_text("".join(gateway_file(port, baud, drives, broker.port)))
            command = [sys.executable, "-m", "gateway", "run", str(config)]
        else:
            command = [sys.executable, "-m", "bench.masters", name, port, str(baud), str(drives)]
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            yield
        finally:
            process.terminate()
            process.wait(10)


def gateway_file(port: str, baud: int, drives: int, broker: int) -> Iterator[str]:
    """Yield a configuration with everything switched on, polling as fast as the line allows."""
    yield f'[gateway]\nname = "bench"\n[mqtt]\nurl = "mqtt://127.0.0.1:{broker}"\n'
    yield f'[modbus_tcp]\nlisten = "127.0.0.1:{free_port()}"\n[web]\nlisten = "127.0.0.1:{free_port()}"\n'
    yield f'[[line]]\nname = "a"\nport = "{port}"\nbaud = {baud}\nparity = "even"\n'
    for number in range(1, drives + 1):
        yield f'[[line.drive]]\nname = "d{number}"\nnumber = {number}\nmodel = "vf-nc3"\n'
        yield f'poll = [{{ values = {FIVE}, every = "0s" }}]\n'


def measure(name: str, baud: int, drives: int, seconds: float) -> dict[str, Any]:
    """Return what the line counted while one master ran, with `share` of the limit and `late`."""
    with SimulatedLine(simulated(baud, drives)) as line, running(name, line.port, baud, drives):
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
    for name in options.only or [*MASTERS, GATEWAY]:
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
