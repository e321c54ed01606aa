"""What a full MODBUS-TCP load does to the line that is polled meanwhile, and a client that never reads to others."""

from __future__ import annotations

import contextlib
import os
import statistics
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from bench import whole_gateway
from bench.line_journal import exchanges
from bench.tcp_generator import GENERATOR_CORE, SERVER_CORE, Load, loading, pin, put_on, serving, stuck_client, told
from gateway.protocol.timing import LineTiming
from gateway.sim.process import SimulatedLine

BAUD, DRIVES = 38400, 8
CONNECTIONS = 32
TWO = Load("2 registers", 1, 0xFD00, 2)
SECONDS = 3.0  # of each half of a round
SETTLE = 0.5  # seconds between the beginning of a load and counting
ENTRIES = 2  # of the line's journal, for each exchange: request and answer
ASKED = struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0xFD00, 100)


def beside_a_stuck_client(load: Load, seconds: float, runs: int) -> None:
    """Print the 99th percentile of 16 clients, alone and beside one that asks all the time and never reads."""
    alone, beside = [], []
    with serving("gateway") as server:
        for _ in range(runs):
            alone.append(put_on(server, load, 16, seconds).p99)
            with stuck_client(server.port, ASKED):
                time.sleep(SETTLE)
                beside.append(put_on(server, load, 16, seconds).p99)
    without, with_ = statistics.median(alone), statistics.median(beside)
    print(
        f"A client that never reads: p99 of 16 others {without * 1e3:.3f} ms without it, "
        f"{with_ * 1e3:.3f} ms beside it ({with_ / without - 1:+.0%})"
    )


@contextlib.contextmanager
def ahead_of_others() -> Iterator[bool]:
    """Let what is started in this block be real-time, so that its timing is nobody else's; False: not permitted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def beside_a_line(rounds: int) -> None:
    """Print a line's share of its limit, with and without a load of 32 connections on the gateway that polls it."""
    line = SimulatedLine(whole_gateway.simulated(BAUD, DRIVES, running_at=30.0))
    cores = os.sched_getaffinity(0)
    with contextlib.ExitStack() as stack:
        pin(0, GENERATOR_CORE)
        with ahead_of_others() as is_ahead:
            stack.enter_context(line)
        pin(0, SERVER_CORE)
        ports = stack.enter_context(whole_gateway.running(line.port, BAUD, DRIVES, whole_gateway.More()))
        os.sched_setaffinity(0, cores)
        whole_gateway.until(lambda: whole_gateway.is_healthy(ports), "every drive to be read")
        _compare_shares(line, ports.tcp, rounds)
    if not is_ahead:
        print("(the simulated line could not be made a real-time process: it shares its core with the generator)")


@dataclass(frozen=True, slots=True)
class Window:
    """What a line did in some seconds: its share of the limit, and how long after the gap each request came."""

    share: float
    late: Sequence[float]
    cycle: float
    gap_violations: int
    own_lateness: float


def _compare_shares(line: SimulatedLine, port: int, rounds: int) -> None:
    without, beside, rates, slowest = [], [], [], []
    for _ in range(rounds):
        without.append(_counted(line))
        with loading(port, TWO, CONNECTIONS, SETTLE + SECONDS + SETTLE) as generator:
            time.sleep(SETTLE)
            beside.append(_counted(line))
            answers, elapsed, _, _, p99 = told(generator)
        rates.append(answers / elapsed)
        slowest.append(p99)
    print(told_apart(without, beside))
    print(f"meanwhile {statistics.median(rates):,.0f} requests/s, p99 {statistics.median(slowest) * 1e3:.2f} ms")


def told_apart(without: Sequence[Window], beside: Sequence[Window]) -> str:
    """Say what the load did to the line: by its share, and by the median request, which other work does not blur."""
    before, after = (statistics.median(each.share for each in some) for some in (without, beside))
    late, later = (statistics.median([each for one in some for each in one.late]) for some in (without, beside))
    cycle = statistics.median(each.cycle for each in (*without, *beside))
    return (
        f"A line at {BAUD} baud with {DRIVES} drives: {before:.1%} of its limit without clients, {after:.1%} beside "
        f"{CONNECTIONS} connections at full speed ({100 * (after - before):+.1f} points)\n"
        f"its median request came {late * 1e6:.0f} microseconds after the gap without them, {later * 1e6:.0f} beside "
        f"them: {(later - late) / cycle:+.1%} of an exchange of {cycle * 1e3:.1f} ms; gap violations "
        f"{sum(each.gap_violations for each in (*without, *beside))}; the simulated line itself was late by "
        f"{max(each.own_lateness for each in beside) * 1e6:.0f} microseconds (p99)"
    )


def _counted(line: SimulatedLine) -> Window:
    line.do({"do": "reset_stats"})
    begun = time.monotonic()
    time.sleep(SECONDS)
    counted = line.stats()
    elapsed = time.monotonic() - begun
    made = exchanges(line.log(ENTRIES * counted["answers"]))
    gap = LineTiming(BAUD).gap
    late = [later.begin - earlier.end - gap for earlier, later in pairwise(made) if earlier.answer]
    cycle = statistics.median(later.begin - earlier.begin for earlier, later in pairwise(made))
    return Window(counted["busy"] / elapsed, late, cycle, counted["gap_violations"], counted["lateness_p99"])
