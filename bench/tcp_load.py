"""Requests per second and answer times of MODBUS-TCP servers, for 5 and 100 registers at 1, 16 and 100 connections.

The generator is one process: plain sockets and epoll, one request outstanding on each connection, request bytes
made beforehand, answers counted when whole and checked by length, transaction and function. Whether it is the
bottleneck is measured, not assumed: the same loads are put on a bare uvloop protocol with a fixed answer, and the
processor time of generator and server is shown; a generator below 100 % waited for its server. On a machine that has
other work, the server's processor time per request is the figure that still holds.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import select
import socket
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SECONDS = 1.0
RUNS = 3
CONNECTIONS = (1, 16, 100)
HEADER = 9  # bytes of an answer in front of its words
TICKS = os.sysconf("SC_CLK_TCK")
REQUEST = struct.Struct(">HHHBBHH")
ANSWER_WITHIN = 2.0  # seconds


@dataclass(frozen=True, slots=True)
class Load:
    """What is asked: registers of one unit from one address."""

    title: str
    unit: int
    start: int
    count: int


LOADS = (Load("5 registers", 1, 0xFD00, 5), Load("100 registers", 1, 0xFD00, 100))
COMPACT_MAP = Load("100 registers of the compact map", 255, 0, 100)


@dataclass(frozen=True, slots=True)
class Result:
    """One run: requests per second, answer times in seconds, processor shares of generator and server."""

    rate: float
    p50: float
    p99: float
    generator: float
    server: float

    @property
    def cost(self) -> float:
        """Return the server's processor seconds per request."""
        return self.server / self.rate


@dataclass(frozen=True, slots=True)
class Server:
    """A server process under load."""

    name: str
    pid: int
    port: int

    def processor_time(self) -> float:
        """Return the seconds of processor time that it has used: fields 14 and 15 of proc_pid_stat(5)."""
        fields = Path(f"/proc/{self.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS


@contextlib.contextmanager
def serving(name: str) -> Iterator[Server]:
    """Run one of the servers in a process of its own; it ends when its standard input closes."""
    command = [sys.executable, "-m", "bench.tcp_servers", name]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None  # noqa: S101 - PIPE was asked for
        yield Server(name, process.pid, int(process.stdout.readline()))


def put_on(server: Server, load: Load, connections: int, seconds: float) -> Result:
    """Keep one request outstanding on each connection for some seconds."""
    requests = [REQUEST.pack(i, 0, 6, load.unit, 3, load.start, load.count) for i in range(connections)]
    sockets = [socket.create_connection(("127.0.0.1", server.port)) for _ in requests]
    for connection in sockets:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        generator, used = time.process_time(), server.processor_time()
        begun = time.perf_counter()
        times = _exchange({s.fileno(): r for s, r in zip(sockets, requests, strict=True)}, load.count, seconds)
        elapsed = time.perf_counter() - begun
        generator, used = time.process_time() - generator, server.processor_time() - used
    finally:
        for connection in sockets:
            connection.close()
    times.sort()
    rate = len(times) / elapsed
    p50, p99 = times[len(times) // 2], times[len(times) * 99 // 100]
    return Result(rate, p50, p99, generator / elapsed, used / elapsed)


def _exchange(requests: dict[int, bytes], count: int, seconds: float) -> list[float]:
    """Return the answer times of all requests answered; any answer that is not exact ends the benchmark."""
    size = HEADER + 2 * count
    poll = select.epoll()
    sent: dict[int, float] = {}
    times: list[float] = []
    read, write, now, keep = os.read, os.write, time.perf_counter, times.append
    end = now() + seconds
    for descriptor, request in requests.items():
        poll.register(descriptor, select.EPOLLIN)
        sent[descriptor] = now()
        write(descriptor, request)
    while now() < end:
        ready = poll.poll(ANSWER_WITHIN)
        if not ready:
            raise SystemExit("no answer")
        for descriptor, _ in ready:
            answer = read(descriptor, 512)
            while len(answer) < size:
                more = read(descriptor, 512)
                if not more:
                    raise SystemExit(f"closed, after {answer.hex(' ')}")
                answer += more
            moment = now()
            if answer[7] != 3 or len(answer) != size or answer[:2] != requests[descriptor][:2]:
                raise SystemExit(f"wrong answer: {answer.hex(' ')}")
            keep(moment - sent[descriptor])
            sent[descriptor] = moment
            write(descriptor, requests[descriptor])
    poll.close()
    return times


def median(results: list[Result]) -> Result:
    """Return the median of each figure."""
    fields = ("rate", "p50", "p99", "generator", "server")
    return Result(*(statistics.median(getattr(result, field) for result in results) for field in fields))


def report(servers: list[Server], load: Load, connections: int, seconds: float, runs: int) -> dict[str, Result]:
    """Put one load on each server in turn, several times, and print the medians."""
    results: dict[str, list[Result]] = {server.name: [] for server in servers}
    for _ in range(runs):
        for server in servers:
            results[server.name].append(put_on(server, load, connections, seconds))
    medians = {name: median(some) for name, some in results.items()}
    for name, result in medians.items():
        print(
            f"{load.title:33} {connections:4}  {name:12} {result.rate:9,.0f} {result.p50 * 1e3:8.3f} "
            f"{result.p99 * 1e3:8.3f} {result.generator:8.0%} {result.server:8.0%} {result.cost * 1e6:8.1f}"
        )
    return medians


def compared(found: dict[str, Result]) -> str:
    """Say how this gateway stands beside pymodbus' server and the bare loop."""
    own, pymodbus, bare = (found[name] for name in ("gateway", "pymodbus", "bare uvloop"))
    return (
        f"{own.rate / pymodbus.rate:.1f} x pymodbus, {own.rate / bare.rate:.0%} of the bare loop; "
        f"by processor time {pymodbus.cost / own.cost:.1f} x and {bare.cost / own.cost:.0%}"
    )


def main() -> None:
    """Print the table, and how this gateway stands beside pymodbus' server."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of a run")
    parser.add_argument("--runs", type=int, default=RUNS, help="runs of which the median is shown")
    options = parser.parse_args()
    print(f"MODBUS-TCP over loopback, medians of {options.runs} runs of {options.seconds:g} s, on uvloop")
    print(f"{'request':33} conn  {'server':12}     req/s   p50 ms   p99 ms  gen cpu  srv cpu   us/req")
    ratios = []
    with serving("gateway") as gateway, serving("pymodbus") as pymodbus, serving("bare uvloop") as bare:
        for load in LOADS:
            for connections in CONNECTIONS:
                found = report([gateway, pymodbus, bare], load, connections, options.seconds, options.runs)
                ratios.append(f"{load.title}, {connections} connections: {compared(found)}")
        for connections in CONNECTIONS:
            report([gateway], COMPACT_MAP, connections, options.seconds, options.runs)
    print(*ratios, sep="\n")


if __name__ == "__main__":
    main()
