"""Requests per second and answer times of MODBUS-TCP servers, for 5 and 100 registers at 1 to 100 connections.

The load is put on by a program in C (bench/tcp_generator.c): one request outstanding on each connection, every answer
verified. Whether it is the bottleneck is measured, not assumed: the same loads are put on a bare server in C that
looks at nothing, and the processor time of generator and server is shown; a generator below 100 % waited for its
server. Server and generator have a core each. On a machine that has other work, the server's processor time per
request is the figure that still holds. Behind the table: what a client that never reads does to the others, and what
the load does to a line.
"""

from __future__ import annotations

import argparse
import contextlib
import statistics
from collections.abc import Mapping, Sequence

from bench.native import NotBuilt, built
from bench.tcp_generator import GENERATOR_CORE, SERVER_CORE, Load, Result, Server, put_on, serving
from bench.tcp_line import beside_a_line, beside_a_stuck_client

SECONDS = 0.7
RUNS = 3
LINE_ROUNDS = 4
CONNECTIONS = (1, 16, 100)
WITHIN = 32  # connections, as many as a gateway serves by default
NAMES = ("gateway", "libmodbus", "pymodbus", "pyModbusTCP", "bare uvloop", "bare C")
LOADS = (Load("5 registers", 1, 0xFD00, 5), Load("100 registers", 1, 0xFD00, 100))
COMPACT_MAP = Load("100 of the compact map", 255, 0, 100)

Found = Mapping[str, Result]


def median(results: Sequence[Result]) -> Result:
    """Return the median of each figure."""
    fields = ("rate", "p50", "p99", "generator", "server")
    return Result(*(statistics.median(getattr(result, field) for result in results) for field in fields))


def measured(servers: Sequence[Server], load: Load, connections: int, seconds: float, runs: int) -> Found:
    """Put one load on each server in turn, several times; print the medians and return them."""
    results: dict[str, list[Result]] = {server.name: [] for server in servers}
    for _ in range(runs):
        for server in servers:
            results[server.name].append(put_on(server, load, connections, seconds))
    medians = {name: median(some) for name, some in results.items()}
    for name, result in medians.items():
        print(
            f"{load.title:24} {connections:4}  {name:12} {result.rate:9,.0f} {result.p50 * 1e3:8.3f} "
            f"{result.p99 * 1e3:8.3f} {result.generator:8.0%} {result.server:8.0%} {result.cost * 1e6:8.1f}",
            flush=True,
        )
    return medians


def compared(found: Found) -> str:
    """Say how this gateway stands beside the others, by requests a second and by processor time per request."""
    own = found["gateway"]
    others = [name for name in found if name != "gateway"]
    rates = ", ".join(f"{own.rate / found[name].rate:.2f} x {name}" for name in others)
    costs = ", ".join(f"{found[name].cost / own.cost:.2f} x" for name in others)
    return f"{rates}; by processor time {costs}"


def is_no_bottleneck(tables: Sequence[Found]) -> str:
    """Say how it is known that the figures are the servers' and not the generator's."""
    reached = min(found["bare C"].rate for found in tables)
    fastest = max(result.rate for found in tables for name, result in found.items() if not name.startswith("bare"))
    most = max(result.generator for found in tables for name, result in found.items() if not name.startswith("bare"))
    return (
        f"The generator: {reached:,.0f} requests/s at the least from a bare server in C, {fastest:,.0f} at the most "
        f"from any other; it used {most:.0%} of its core at the most beside them"
    )


def compare(names: Sequence[str], seconds: float, runs: int) -> None:
    """Print the table, and how this gateway stands beside the others."""
    print(f"{'request':24} conn  {'server':12}     req/s   p50 ms   p99 ms  gen cpu  srv cpu   us/req")
    tables: dict[tuple[str, int], Found] = {}
    with contextlib.ExitStack() as stack:
        servers = [stack.enter_context(serving(name)) for name in names]
        for load in LOADS:
            for connections in CONNECTIONS:
                tables[load.title, connections] = measured(servers, load, connections, seconds, runs)
            measured(servers[:1], load, WITHIN, seconds, runs)
        measured(servers[:1], COMPACT_MAP, WITHIN, seconds, runs)
    print("\nThis gateway, against each of the others:")
    for (title, connections), found in tables.items():
        print(f"{title}, {connections} connections: {compared(found)}")
    print(is_no_bottleneck([found for (_, connections), found in tables.items() if connections > 1]))


def available() -> list[str]:
    """Return the servers that can be had; without a compiler there is no load at all."""
    names = []
    try:
        built("tcp_generator")
    except NotBuilt as reason:
        raise SystemExit(str(reason)) from None
    for name in NAMES:
        try:
            with serving(name):
                names.append(name)
        except NotBuilt as reason:
            print(f"{name} is left out: {reason} (apt-get install libmodbus-dev)")
    return names


def main() -> None:
    """Measure all of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of a run")
    parser.add_argument("--runs", type=int, default=RUNS, help="runs of which the median is shown")
    parser.add_argument("--rounds", type=int, default=LINE_ROUNDS, help="rounds beside a line; 0: none")
    options = parser.parse_args()
    print(f"MODBUS-TCP over loopback, medians of {options.runs} runs of {options.seconds:g} s")
    where = f"servers on core {SERVER_CORE}, generator on core {GENERATOR_CORE}"
    print(where if SERVER_CORE != GENERATOR_CORE else "one core for server and generator: the rates are too low")
    compare(available(), options.seconds, options.runs)
    beside_a_stuck_client(LOADS[0], options.seconds, options.runs)
    if options.rounds:
        beside_a_line(options.rounds)


if __name__ == "__main__":
    main()
