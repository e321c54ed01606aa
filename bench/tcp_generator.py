"""The load on a MODBUS-TCP server, put on by a program in C, and what it and the server took of the processor."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

from bench.native import LIBMODBUS, built

CORES = sorted(os.sched_getaffinity(0))
SERVER_CORE, GENERATOR_CORE = CORES[0], CORES[-1]
PROCESS_CLOCK = 2  # CPUCLOCK_SCHED of another process' clock, see clock_getcpuclockid(3) and linux/posix-timers.h
IN_C = {"libmodbus": ("libmodbus_server", LIBMODBUS), "bare C": ("fixed_answer_server", ())}


@dataclass(frozen=True, slots=True)
class Load:
    """What is asked: registers of one unit from one address."""

    title: str
    unit: int
    start: int
    count: int


@dataclass(frozen=True, slots=True)
class Result:
    """One run: requests a second, answer times in seconds, processor shares of generator and server."""

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
    """A server process under load, on a core of its own where there are two."""

    name: str
    pid: int
    port: int

    def processor_time(self) -> float:
        """Return the seconds of processor time that all its threads have used, those that have ended too."""
        return time.clock_gettime(~self.pid << 3 | PROCESS_CLOCK)


def pin(pid: int, core: int) -> None:
    """Keep a process on a core; 0 is this one."""
    os.sched_setaffinity(pid, {core})


@contextlib.contextmanager
def serving(name: str) -> Iterator[Server]:
    """Run one of the servers in a process of its own; it ends when its standard input closes."""
    if name in IN_C:
        source, libraries = IN_C[name]
        command = [str(built(source, *libraries))]
    else:
        command = [sys.executable, "-m", "bench.tcp_servers", name]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        pin(process.pid, SERVER_CORE)
        assert process.stdout is not None  # noqa: S101 - PIPE was asked for
        yield Server(name, process.pid, int(process.stdout.readline()))


@contextlib.contextmanager
def loading(port: int, load: Load, connections: int, seconds: float) -> Iterator[subprocess.Popen[str]]:
    """Run the generator beside the block; `told` has what it says in the end."""
    program = built("tcp_generator")
    numbers = (port, connections, load.unit, load.start, load.count, seconds)
    command = [str(program), *map(str, numbers)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        pin(process.pid, GENERATOR_CORE)
        yield process


def told(process: subprocess.Popen[str]) -> tuple[int, float, float, float, float]:
    """Wait for a generator: answers, seconds, its processor seconds, p50 and p99; SystemExit if it failed."""
    said, why = process.communicate()
    if process.returncode:
        raise SystemExit(f"the load generator: {why.strip()}")
    answers, elapsed, used, p50, p99, _ = said.split()
    return int(answers), float(elapsed), float(used), float(p50) / 1e6, float(p99) / 1e6


def put_on(server: Server, load: Load, connections: int, seconds: float) -> Result:
    """Keep one request outstanding on each connection for some seconds."""
    before = server.processor_time()
    with loading(server.port, load, connections, seconds) as process:
        answers, elapsed, used, p50, p99 = told(process)
    spent = server.processor_time() - before
    return Result(answers / elapsed, p50, p99, used / elapsed, spent / elapsed)


@contextlib.contextmanager
def stuck_client(port: int, request: bytes) -> Iterator[None]:
    """Ask all the time and never read, until the block ends or the server has had enough."""
    client = socket.create_connection(("127.0.0.1", port))
    burst = request * 1000

    def flood() -> None:
        with contextlib.suppress(OSError):
            while True:
                client.sendall(burst)

    thread = threading.Thread(target=flood, daemon=True)
    thread.start()
    try:
        yield
    finally:
        with contextlib.suppress(OSError):  # cut already
            client.shutdown(socket.SHUT_RDWR)  # lets the thread go
        thread.join()
        client.close()
