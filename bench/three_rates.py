"""Eight drives, each asked at three rates: how often and how evenly each rate is kept, beside masters in a loop.

For each rate: the answers that came of those that were asked for, and the times between two answers of one drive, by
the simulated line's own journal. A drive whose F803 is shorter than the longest of them trips.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from bench import line_journal
from bench.figures import percentile
from bench.line_journal import Exchange
from bench.line_load import GATEWAY, running
from bench.masters import BLOCK, RATES, SINGLES, TIMED
from bench.whole_gateway import FIVE, More, simulated
from gateway.sim.process import SimulatedLine

DRIVES = 8
BAUDS = (19200, 38400)
POLLS = ", ".join(
    (
        f'{{ values = {FIVE}, every = "{RATES[BLOCK]}s" }}',
        *(f'{{ values = ["{name}"], every = "{RATES[address]}s" }}' for name, address in SINGLES.items()),
    )
)
MASTERS = (GATEWAY, *TIMED)
SETTLED = 6.0  # seconds in which drives are identified and proven, and checks have begun


@dataclass(frozen=True, slots=True)
class Kept:
    """One rate: the period in seconds, the share of its answers that came, and the times between two of one drive."""

    period: float
    share: float
    median: float
    longest: float


def kept(found: Iterable[Exchange], seconds: float) -> Iterator[Kept]:
    """Yield how each rate was kept, by the exchanges of so many seconds."""
    times: dict[tuple[int, int], list[float]] = defaultdict(list)
    for exchange in found:
        if len(exchange.answer) > 5:
            times[exchange.request[0], int.from_bytes(exchange.request[2:4], "big")].append(exchange.end)
    for address, period in RATES.items():
        of_drives = [times[number, address] for number in range(1, DRIVES + 1)]
        between = [after - before for each in of_drives for before, after in pairwise(each)]
        share = sum(map(len, of_drives)) / (DRIVES * seconds / period)
        yield Kept(period, share, percentile(between, 0.5) if between else 0.0, max(between, default=0.0))


def measured(name: str, baud: int, seconds: float) -> Sequence[Kept]:
    """Measure one master on a line of its own."""
    with SimulatedLine(simulated(baud, DRIVES)) as line, running(name, line.port, baud, DRIVES, More(polls=POLLS)):
        time.sleep(SETTLED)
        begun = time.monotonic()
        time.sleep(seconds)
        found = line_journal.read(line, begun)
    return list(kept([each for each in found if each.begin < begun + seconds], seconds))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of a measurement")
    parser.add_argument("--only", action="append", help="measure only this master (may be given again)")
    options = parser.parse_args()
    print(f"{DRIVES} drives, a block and two single values each; ms between answers of one drive: median / longest")
    heads = "".join(f"  {f'every {period * 1000:.0f} ms':>26}" for period in RATES.values())
    print(f"{'master':22} {'baud':>5}{heads}")
    for name in options.only or MASTERS:
        for baud in BAUDS:
            cells = "".join(
                f"  {one.share:8.1%} {1000 * one.median:7.0f} / {1000 * one.longest:7.0f}"
                for one in measured(name, baud, options.seconds)
            )
            print(f"{name:22} {baud:5}{cells}", flush=True)


if __name__ == "__main__":
    main()
