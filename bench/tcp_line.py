"""What a full MODBUS-TCP load does to the line that is polled meanwhile, and a client that never reads to others."""

from __future__ import annotations

import contextlib
import os
import statistics
import struct
import time
from collections.abc import Iterator
from typing import Any

from bench import whole_gateway
from bench.tcp_generator import GENERATOR_CORE, SERVER_CORE, Load, loading, pin, put_on, serving, stuck_client, told
from gateway.sim.process import SimulatedLine

BAUD, DRIVES = 38400, 8
CONNECTIONS = 32
TWO = Load("2 registers", 1, 0xFD00, 2)
SECONDS = 3.0  # of each half of a round
SETTLE = 0.5  # seconds between the beginning of a load and counting
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


def _compare_shares(line: SimulatedLine, port: int, rounds: int) -> None:
    without, with_, rates, slowest = [], [], [], []
    for _ in range(rounds):
        without.append(_counted(line))
        with loading(port, TWO, CONNECTIONS, SETTLE + SECONDS + SETTLE) as generator:
            time.sleep(SETTLE)
            with_.append(_counted(line))
            answers, elapsed, _, _, p99 = told(generator)
        rates.append(answers / elapsed)
        slowest.append(p99)
    before, after = (statistics.median(each["share"] for each in some) for some in (without, with_))
    late = statistics.median(each["lateness_p99"] for each in with_)
    print(
        f"A line at {BAUD} baud with {DRIVES} drives: {before:.1%} of its limit without clients, {after:.1%} beside "
        f"{CONNECTIONS} connections at full speed ({after - before:+.1%}); gap violations "
        f"{sum(each['gap_violations'] for each in (*without, *with_))}\n"
        f"meanwhile {statistics.median(rates):,.0f} requests/s, p99 {statistics.median(slowest) * 1e3:.2f} ms; "
        f"the simulated line itself was late by {late * 1e6:.0f} microseconds (p99)"
    )


def _counted(line: SimulatedLine) -> dict[str, Any]:
    line.do({"do": "reset_stats"})
    begun = time.monotonic()
    time.sleep(SECONDS)
    counted = line.stats()
    return {**counted, "share": counted["busy"] / (time.monotonic() - begun)}
