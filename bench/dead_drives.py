"""What silent drives cost those that answer: eight drives on a line, of which 0 to 7 are dead, at two loads.

Once every drive is polled as fast as the line allows, once at three rates that it carries; what each living drive
keeps of its polls is held against what it gets while all eight live.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass

from bench.whole_gateway import FIVE, More, on_simulated_line, simulated
from gateway.sim.process import SimulatedLine

BAUD = 19200
DRIVES = 8
FAST = f'{{ values = {FIVE}, every = "0s" }}'
THREE_RATES = ", ".join(
    (
        f'{{ values = {FIVE}, every = "500ms" }}',
        '{ values = ["trip_code"], every = "2s" }',
        '{ values = ["cumulative_operation_time"], every = "10s" }',
    )
)
LOADS = {"as fast as possible": FAST, "500 ms, 2 s, 10 s": THREE_RATES}
SETTLED = 12.0  # seconds from the death of drives until they are probed as seldom as they will be


@dataclass(frozen=True, slots=True)
class Row:
    """Answers a second of the line and of each living drive, and the share of the line that requests took."""

    load: str
    dead: int
    rate: float
    each: float
    share: float
    violations: int


def measure(load: str, line: SimulatedLine, dead: int, seconds: float) -> Row:
    """Measure with so many dead drives, which die here."""
    for number in range(DRIVES - dead + 1, DRIVES + 1):
        line.do({"do": "cut", "drive": number})
    if dead:
        time.sleep(SETTLED)
    line.do({"do": "reset_stats"})
    begun = time.monotonic()
    time.sleep(seconds)
    counted = line.stats()
    elapsed = time.monotonic() - begun
    rate = counted["answers"] / elapsed
    return Row(load, dead, rate, rate / (DRIVES - dead), counted["busy"] / elapsed, counted["gap_violations"])


def measured(dead: list[int], seconds: float) -> Iterator[Row]:
    """Yield a row for each load and number of dead drives; each has a line of its own."""
    for load, polls in LOADS.items():
        for count in dead:
            with on_simulated_line(simulated(BAUD, DRIVES), More(polls=polls)) as (line, _):
                yield measure(load, line, count, seconds)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of a measurement")
    parser.add_argument("--dead", type=int, action="append", help="only so many of 8 (may be given again)")
    options = parser.parse_args()
    print(f"{DRIVES} drives at {BAUD} baud; gv: gap violations")
    print(f"{'polls':20} {'dead':>4}  {'answers/s':>9} {'of each':>8} {'kept':>6}  {'line used':>9}  gv")
    alone: dict[str, float] = {}
    for row in measured(options.dead or list(range(DRIVES)), options.seconds):
        alone.setdefault(row.load, row.each)
        kept = row.each / alone[row.load]
        print(
            f"{row.load:20} {row.dead:4}  {row.rate:9.1f} {row.each:8.2f} {kept:6.0%}  {row.share:9.1%}"
            f"  {row.violations}",
            flush=True,
        )


if __name__ == "__main__":
    main()
