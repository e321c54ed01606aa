"""The MODBUS-TCP load: no wrong answer is taken for a right one, and what is printed follows from figures."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bench.native import COMPILER, NotBuilt, built
from bench.tcp_generator import Load, Result, Server, loading, put_on, serving, told
from bench.tcp_load import compared, is_no_bottleneck, median

needs_compiler = pytest.mark.skipif(not any(map(shutil.which, COMPILER)), reason="no C compiler here")
LOAD = Load("5 registers", 1, 0xFD00, 5)
RIGHT = bytes([3, 10, *range(10)])


@contextlib.contextmanager
def answering(answer: Callable[[bytes], bytes]) -> Iterator[int]:
    """Serve one connection: each request of 12 bytes gets what `answer` makes of it. Yield the port."""
    listening = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        client, _ = listening.accept()
        with client, contextlib.suppress(ConnectionError):
            while request := client.recv(12):
                client.sendall(answer(request))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield listening.getsockname()[1]
    finally:
        thread.join()
        listening.close()


def frame(request: bytes, pdu: bytes = RIGHT, transaction: int = 0, unit: int = 1) -> bytes:
    """Make an answer; `transaction` is added to the request's."""
    asked = struct.unpack_from(">H", request)[0]
    return struct.pack(">HHHB", asked + transaction, 0, 1 + len(pdu), unit) + pdu


WRONG = {
    "another transaction": lambda request: frame(request, transaction=1),
    "another unit": lambda request: frame(request, unit=2),
    "another function": lambda request: frame(request, bytes([4, *RIGHT[1:]])),
    "an exception": lambda request: frame(request, b"\x83\x0b"),
    "a word too many": lambda request: frame(request, bytes([3, 12, *range(12)])),
    "two answers": lambda request: 2 * frame(request),
}


@pytest.mark.e2e
@needs_compiler
@pytest.mark.parametrize("answer", [frame, *WRONG.values()], ids=["right", *WRONG])
def test_the_generator_counts_right_answers_only(answer: Callable[[bytes], bytes]) -> None:
    """One that is wrong ends the benchmark."""
    with answering(answer) as port, loading(port, LOAD, 1, 0.05) as process:
        if answer is frame:
            answers, elapsed, used, p50, p99 = told(process)
            assert answers > 10
            assert 0.05 <= elapsed < 5
            assert 0 < used < elapsed
            assert 0 < p50 <= p99 < 1
        else:
            with pytest.raises(SystemExit, match="wrong answer"):
                told(process)


@pytest.mark.e2e
@needs_compiler
@pytest.mark.parametrize("name", ["gateway", "pymodbus", "pyModbusTCP", "bare uvloop", "bare C"])
def test_each_server_answers_the_generator(name: str) -> None:
    """Rightly, on two connections, and its processor time is seen."""
    with serving(name) as server:
        result = put_on(server, LOAD, 2, 0.05)
    assert result.rate > 0
    assert result.server > 0


def test_what_cannot_be_compiled_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """No compiler: what to install."""
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setattr("bench.native.FOLDER", Path("/nonexistent"))
    with pytest.raises(NotBuilt, match="apt-get install gcc"):
        built("tcp_generator")


def result(rate: float, server: float = 1.0, generator: float = 0.5) -> Result:
    """Make a result."""
    return Result(rate, 0.001, 0.002, generator, server)


def test_servers_are_compared_by_rate_and_by_processor_time() -> None:
    """The second does not depend on what else the machine does."""
    found = {"gateway": result(80_000, 0.8), "libmodbus": result(100_000), "pymodbus": result(10_000)}
    assert compared(found) == "0.80 x libmodbus, 8.00 x pymodbus; by processor time 1.00 x, 10.00 x"


def test_the_generator_is_judged_beside_a_bare_server() -> None:
    """The least that it reached there, and the most that it used elsewhere."""
    tables = [
        {"gateway": result(80_000, generator=0.7), "bare C": result(130_000, generator=0.95)},
        {"gateway": result(90_000, generator=0.8), "bare C": result(120_000, generator=0.99)},
    ]
    said = is_no_bottleneck(tables)
    assert "120,000 requests/s at the least from a bare server in C, 90,000 at the most" in said
    assert "80% of its core" in said


def test_medians_are_taken_of_each_figure() -> None:
    """Not of whole runs."""
    assert median([result(1, 3), result(2, 1), result(3, 2)]) == result(2, 2)


def test_processor_time_is_that_of_the_process() -> None:
    """Of this one, as an example: more than a moment ago after some work."""
    server = Server("this", os.getpid(), 0)
    before = server.processor_time()
    assert sum(range(1_000_000)) > 0
    assert 0 < before < server.processor_time()
