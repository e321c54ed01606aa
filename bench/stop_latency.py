"""From a stop to its frame on the line, and to its verified result: with all drives alive, and with 7 of 8 dead.

A stop goes ahead of everything, but it cannot break into an exchange that is in flight (SAFETY.md H29). The longest
one is the time-out of a dead drive. The share shows it: how long the stop waited, of the longest time from one
request on the line to the next. Dead drives are tried as much as the configuration permits: half of the line's time.
"""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from bench import line_journal
from bench.controllers import COMMAND, CONTROLLERS, WRITE_SINGLE, Asked, Controller, MqttController, by_mqtt
from bench.figures import SPREAD, milliseconds, percentile, spread
from bench.line_journal import Wait
from bench.whole_gateway import CONTROLLED, More, on_simulated_line, simulated, until
from gateway.sim.process import SimulatedLine

BAUD = 19200
DRIVES = 8
DEAD = (0, 7)
STOPS = 60
QUICK = 6
BUSY_WITH_DEAD = 'silent_share = 0.5\nprobe_every = "100ms"\nprobe_at_most = "100ms"\n'
PAUSE = 0.1  # seconds at most between run and stop, by chance: longer than any exchange
BEFORE = 0.5  # seconds: what was in flight when the first stop was sent began then at the earliest


@dataclass(frozen=True, slots=True)
class Row:
    """The stops of one way with so many dead drives; times in seconds, `longest` from a request to the next."""

    way: str
    dead: int
    waits: list[Wait]
    round_trips: list[float]
    failed: int
    longest: float
    lateness: float

    @property
    def shares(self) -> list[float]:
        """Return what part of the longest exchange each stop waited for."""
        return [wait.whole / self.longest for wait in self.waits]


@dataclass(frozen=True, slots=True)
class Sides:
    """Who sets drives in motion, and who stops them."""

    setter: MqttController
    stopper: Controller


def stopped(by: Sides, alive: Sequence[int], count: int) -> list[tuple[int, Asked]]:
    """Set drives in motion and stop them at moments that the line knows nothing of."""
    chance = random.Random(count)  # noqa: S311 - the same moments in each run
    found = []
    for _ in range(count):
        number = chance.choice(alive)
        running = by.setter.order(number, "run")
        if not running.is_done:
            raise SystemExit(f"drive {number} does not run: {running.result}")
        time.sleep(chance.uniform(0, PAUSE))
        found.append((number, by.stopper.stop(number)))
    return found


def measure(way: str, line: SimulatedLine, by: Sides, alive: Sequence[int], dead: int, count: int) -> Row:
    """Measure one way of stopping, on a line that runs."""
    line.do({"do": "reset_stats"})
    stops = stopped(by, alive, count)
    lateness = line.stats()["lateness_p99"]
    exchanges = line_journal.read(line, since=stops[0][1].sent - BEFORE)
    done = [(number, one) for number, one in stops if one.is_done]
    waits = [line_journal.wait(one.sent, one.known, frame(number), exchanges, 0.0) for number, one in done]
    return Row(
        way,
        dead,
        waits=[wait for wait in waits if wait is not None],
        round_trips=[one.told - one.sent for _, one in done],
        failed=count - len(done) + waits.count(None),
        longest=line_journal.longest(exchanges),
        lateness=lateness,
    )


def frame(number: int) -> bytes:
    """Return what a frame that writes a drive's command begins with."""
    return bytes((number, WRITE_SINGLE)) + COMMAND.to_bytes(2, "big")


def measured(dead_numbers: Sequence[int], drives: int, count: int) -> Iterator[Row]:
    """Yield a row for each way of stopping, with each number of dead drives, the last ones."""
    more = More(of_drive=CONTROLLED, of_line=BUSY_WITH_DEAD)
    for dead in dead_numbers:
        with on_simulated_line(simulated(BAUD, drives), more) as (line, ports), by_mqtt(ports) as setter:
            for number in range(1, drives + 1):
                until(lambda: setter.order(number, "arm").is_done, f"drive {number} to be armed")  # noqa: B023 - at once
            alive = range(1, drives - dead + 1)
            kill(line, setter, range(alive.stop, drives + 1))
            for way, connected in CONTROLLERS.items():
                with connected(ports) as stopper:
                    yield measure(way, line, Sides(setter, stopper), alive, dead, count)


def kill(line: SimulatedLine, setter: MqttController, numbers: Sequence[int]) -> None:
    """Cut the wires to drives, and wait until the gateway has given them up."""
    for number in numbers:
        line.do({"do": "cut", "drive": number})
    for number in numbers:
        until(lambda: "offline" in setter.order(number, "run").result, f"drive {number} to be missed")  # noqa: B023 - at once


HEAD = (
    f"{'':22} {'':4} {'':4}  {'to the frame on the line':^31}  {'longest':>8}  {'share of it':^13}"
    f"  {'to the verified result':^31}  {'line':>5}\n"
    f"{'stop by':22} {'dead':>4} {'n':>4}  {SPREAD}  {'exchange':>8}  {'p50':>6} {'worst':>6}  {SPREAD}"
    f"  {'late':>5} failed"
)


def row(found: Row) -> str:
    """Return a row of the table."""
    return (
        f"{found.way:22} {found.dead:4} {len(found.waits):4}  {spread([wait.whole for wait in found.waits])}"
        f"  {milliseconds(found.longest):>8}  {percentile(found.shares, 0.5):6.0%} {max(found.shares):6.0%}"
        f"  {spread(found.round_trips)}  {milliseconds(found.lateness):>5} {found.failed:6}"
    )


def verdict(rows: Sequence[Row]) -> str:
    """Say how near the waits came to the longest exchange."""
    share = max(max(found.shares) for found in rows)
    slipped_in = sum(len(wait.slipped_in) for found in rows for wait in found.waits)
    return (
        f"the longest wait of a stop: {share:.0%} of the longest exchange; "
        f"requests that still began after a stop was sent: {slipped_in}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} stops a row in place of {STOPS}")
    options = parser.parse_args()
    print(f"Stops of one of {DRIVES} drives at {BAUD} baud while the line is fully loaded; times in ms")
    print(HEAD)
    rows = []
    for found in measured(DEAD, DRIVES, QUICK if options.quick else STOPS):
        rows.append(found)
        print(row(found), flush=True)
    print(verdict(rows))


if __name__ == "__main__":
    main()
