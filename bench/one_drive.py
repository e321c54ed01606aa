"""One VF-nC3 on a wire-timed line in a process of its own, the gateway's side of it, and how results are told."""

from __future__ import annotations

import argparse
import contextlib
import json
import statistics
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from gateway.bus.exchange import Exchanger
from gateway.bus.serial_line import open_line
from gateway.clock import SystemClock
from gateway.drives import catalogue
from gateway.metrics import LineStats
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Request
from gateway.protocol.timing import LineTiming
from gateway.sim.settings import SimulatedLineConfig
from gateway.site import SERIAL_MARGIN, Line

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Result = TypeVar("Result", bound="DataclassInstance")

MODEL = catalogue.load()["vf-nc3"]
NUMBER = 1
PROCESSING = 0.005  # seconds, of the simulated drive
BAUDS = (19200, 38400)
VALUES = ("status", "output_frequency", "output_current", "output_voltage", "alarm")
SELECTED_TO_READ = [1, 2, 3, 4, 5]  # F875 to F879: VALUES
SELECTED_TO_WRITE = [1, 3]  # F870 and F871: command, frequency command


def simulated(baud: int, protocol: str) -> SimulatedLineConfig:
    """Return the line; `protocol` is what its drive is set to by F829."""
    drive = {
        "number": NUMBER,
        "model": MODEL.name,
        "protocol": "modbus-rtu" if protocol == "modbus-rtu" else "toshiba",
        "block_read": SELECTED_TO_READ,
        "block_write": SELECTED_TO_WRITE,
        "running_at": 30.0,
    }
    return SimulatedLineConfig.model_validate({"baud": baud, "processing_time": f"{PROCESSING}s", "drive": [drive]})


@contextlib.asynccontextmanager
async def exchanging(port: str, baud: int) -> AsyncIterator[Exchanger]:
    """Open the port as the gateway does, and hand out its exchanger."""
    line = Line("bench", port, baud, "even", SERIAL_MARGIN, 1.0, 1.0, 1.0, ())
    clock = SystemClock()
    opened = await open_line(line, clock)
    try:
        yield Exchanger(opened, line.timing, SERIAL_MARGIN, clock, LineStats())
    finally:
        opened.close()


def least_time(baud: int, codec: Codec, requests: Iterable[Request]) -> float:
    """Return the seconds that the wire and the drive need for some exchanges, whoever the master is."""
    timing = LineTiming(baud)
    sizes = [(len(codec.encode(request)), codec.answer_size(request)) for request in requests]
    return sum(timing.exchange(request, answer, PROCESSING) for request, answer in sizes)


@dataclass(frozen=True, slots=True)
class Table(Generic[Result]):
    """A benchmark of one drive: how it is measured and shown.

    `measured` takes a list that gets each simulated line's lateness, the seconds of a run and the number of runs.
    """

    title: str
    head: str
    seconds: float
    measured: Callable[[list[float], float, int], Iterator[Result]]
    row: Callable[[Result], str]
    ratios: Callable[[list[Result]], Iterator[str]]


def main(description: str | None, table: Table[Result]) -> None:
    """Measure, and print the table, or the same as JSON."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--seconds", type=float, default=table.seconds, help="length of a run")
    parser.add_argument("--runs", type=int, default=3, help="runs of which the median is shown")
    parser.add_argument("--json", action="store_true", help="print the results for programs")
    options = parser.parse_args()
    late: list[float] = []
    results = []
    if not options.json:
        print(f"{table.title}, medians of {options.runs} runs of {options.seconds:g} s; gv: gap violations")
        print(table.head)
    for result in table.measured(late, options.seconds, options.runs):
        results.append(result)
        if not options.json:
            print(table.row(result), flush=True)
    lateness = statistics.median(late)
    if options.json:
        print(json.dumps({"results": [asdict(result) for result in results], "lateness_p99": lateness}, indent=1))
    else:
        print(*table.ratios(results), sep="\n")
        print(f"the simulated line's own lateness, 99th percentile: {lateness * 1e6:.0f} microseconds")
