"""From a controller's command to the first bit of its frame on a fully loaded line, and to its result.

The line polls every drive as fast as it can. A command cannot break into an exchange that is in flight: what counts
is the time beyond its end and the 3.5 characters behind it. Beside it stands the same time of the polls themselves,
from an answer to the next request: what gateway, machine and simulation take without any command. On a machine with
other work: `chrt -f 5 python -m bench.command_latency`.
"""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from bench import line_journal
from bench.controllers import CONTROLLERS, FREQUENCY, WRITE_SINGLE, Asked, Controller
from bench.figures import SPREAD, milliseconds, percentile, spread
from bench.line_journal import Wait
from bench.whole_gateway import CONTROLLED, More, on_simulated_line, simulated, until
from gateway.protocol.timing import LineTiming
from gateway.sim.process import SimulatedLine

BAUDS = (19200, 38400)
DRIVES = (1, 8)
COMMANDS = 300
QUICK = 30
HUNDREDTHS = range(1000, 5000)  # of a hertz: each command of a cell has another one, by which its frame is found
BEFORE = 0.2  # seconds: what was in flight when the first command was sent began then at the earliest
OTHER = HUNDREDTHS.stop  # the frequency to begin with
POLL = (8, 15, 0.005)  # characters of a poll's request and answer, seconds in the drive
AIM = 0.002  # seconds beyond the exchange in flight, for 99 of 100 commands


@dataclass(frozen=True, slots=True)
class Cell:
    """One way of commanding on one line; times in seconds. `polls` is what they took beyond the gap."""

    way: str
    baud: int
    drives: int
    waits: list[Wait]
    round_trips: list[float]
    failed: int
    polls: list[float]
    lateness: float
    gap_violations: int

    @property
    def beyond(self) -> list[float]:
        """Return what each command waited beyond the exchange in flight."""
        return [wait.beyond for wait in self.waits]

    @property
    def slipped_in(self) -> list[float]:
        """Return how long after a command was sent a poll still began, for each one that did."""
        return list(chain.from_iterable(wait.slipped_in for wait in self.waits))


def frame(number: int, hundredths: int) -> bytes:
    """Return what the frame that gives a drive its frequency begins with."""
    return bytes((number, WRITE_SINGLE)) + FREQUENCY.to_bytes(2, "big") + hundredths.to_bytes(2, "big")


def asked(controller: Controller, drives: int, baud: int, count: int) -> list[tuple[bytes, Asked]]:
    """Command drives at moments that the line knows nothing of; return each command with its frame's beginning."""
    chance = random.Random(baud + drives)  # noqa: S311 - the same moments in each run
    turn = LineTiming(baud).exchange(*POLL)
    found = []
    for hundredths in chance.sample(HUNDREDTHS, count):
        time.sleep(chance.uniform(0, turn))
        number = chance.randint(1, drives)
        found.append((frame(number, hundredths), controller.set_frequency(number, hundredths)))
    return found


def measure(way: str, line: SimulatedLine, controller: Controller, baud: int, drives: int, count: int) -> Cell:
    """Measure one way of commanding, on a line that runs."""
    for number in range(1, drives + 1):
        until(lambda: controller.set_frequency(number, OTHER).is_done, f"drive {number} to obey")  # noqa: B023 - at once
    line.do({"do": "reset_stats"})
    commands = asked(controller, drives, baud, count)
    counted, gap = line.stats(), LineTiming(baud).gap
    exchanges = line_journal.read(line, since=commands[0][1].sent - BEFORE)
    done = [(first, one) for first, one in commands if one.is_done]
    waits = [line_journal.wait(one.sent, one.known, first, exchanges, gap) for first, one in done]
    return Cell(
        way,
        baud,
        drives,
        waits=[wait for wait in waits if wait is not None],
        round_trips=[one.told - one.sent for _, one in done],
        failed=count - len(done) + waits.count(None),
        polls=[late for late, request in line_journal.late(exchanges, gap) if request[1] != WRITE_SINGLE],
        lateness=counted["lateness_p99"],
        gap_violations=counted["gap_violations"],
    )


def measured(bauds: Sequence[int], drives: Sequence[int], count: int) -> Iterator[Cell]:
    """Yield a cell for each way of commanding, number of drives and baud rate."""
    for baud in bauds:
        for on_line in drives:
            with on_simulated_line(simulated(baud, on_line), More(of_drive=CONTROLLED)) as (line, ports):
                for way, connected in CONTROLLERS.items():
                    with connected(ports) as controller:
                        yield measure(way, line, controller, baud, on_line, count)


HEAD = (
    f"{'':22} {'':5} {'':6} {'':4}  {'beyond the exchange':^31}  {'slipped in':>10}  {'to the result':^31}"
    f"  {'polls beyond':>15}  {'line':>5}\n"
    f"{'command by':22} {'baud':>5} {'drives':>6} {'n':>4}  {SPREAD}  {'n':>4} {'last':>5}  {SPREAD}"
    f"  {'p50':>7} {'p99':>7}  {'late':>5} failed  gv"
)


def row(cell: Cell) -> str:
    """Return a cell as a line of the table."""
    last = milliseconds(max(cell.slipped_in, default=None))
    polls = " ".join(f"{milliseconds(percentile(cell.polls, share)):>7}" for share in (0.5, 0.99))
    return (
        f"{cell.way:22} {cell.baud:5} {cell.drives:6} {len(cell.waits):4}  {spread(cell.beyond)}"
        f"  {len(cell.slipped_in):4} {last:>5}  {spread(cell.round_trips)}"
        f"  {polls}  {milliseconds(cell.lateness):>5} {cell.failed:6} {cell.gap_violations:3}"
    )


def verdict(cells: Sequence[Cell]) -> str:
    """Say in how many rows the aim is reached, and in how many the machine let the polls reach it."""
    reached, quiet = (sum(percentile(t, 0.99) <= AIM for t in each) for each in zip(*map(_times, cells), strict=True))
    return (
        f"99 of 100 commands on the line within {AIM * 1e3:g} ms beyond the exchange in flight: "
        f"{reached} of {len(cells)} rows; 99 of 100 polls within as much beyond the gap: {quiet}"
    )


def _times(cell: Cell) -> tuple[list[float], list[float]]:
    return cell.beyond, cell.polls


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} commands a row in place of {COMMANDS}")
    options = parser.parse_args()
    print("Commands on a fully loaded line; times in ms. slipped in: polls that began after a command was sent, and")
    print("how late; late: the simulated line's own lateness, p99; gv: gap violations")
    print(HEAD)
    cells = []
    for cell in measured(BAUDS, DRIVES, QUICK if options.quick else COMMANDS):
        cells.append(cell)
        print(row(cell), flush=True)
    print(verdict(cells))


if __name__ == "__main__":
    main()
