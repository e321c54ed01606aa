"""Damaged requests over real sockets: every whole frame is answered, nothing is raised, and memory stays flat."""

from __future__ import annotations

import asyncio
import contextlib
import random
import struct
from typing import Any

import pytest
import uvloop

from gateway.modbus_tcp.connection import IN_FLIGHT
from tests.modbus_tcp.rig import answers, read, until, write
from tests.modbus_tcp.served import Served, left_behind, resident, serving
from tests.modbus_tcp.test_fuzz import FRAMES, damaged, judge
from tests.soak import FACTOR

pytestmark = pytest.mark.e2e

SEED = 20_260_102
REQUESTS = 100_000 * FACTOR
CLIENTS = 16  # at a time
TOGETHER = 40  # requests on one connection
LIMIT = 120.0 * FACTOR  # seconds
GROWN_AT_MOST = 4 * 1024 * 1024  # bytes, while ever more requests come
COUNTERS = read(5, 255, 0xF000, 24)  # which count these very requests
ALL_FRAMES = (*FRAMES, write(9, 1, 0xFA01, 3000), write(10, 2, 0xFA01, 3000))


class Fuzzer:
    """Sends damaged requests on one connection after another, until one of them puts its connection out of step."""

    def __init__(self, seed: int, port: int) -> None:
        self.rng = random.Random(seed)
        self.port = port
        self.sent = self.answered = self.closed = 0

    def in_step(self) -> bytes:
        """Make 40 requests whose header is right, and whatever stands behind it."""
        stream = b""
        for _ in range(TOGETHER):
            body = damaged(self.rng, self.rng.choice(ALL_FRAMES))[6:]
            body = bytes((body + bytes(2))[: max(2, min(len(body), 254))])
            stream += self.rng.randbytes(2) + struct.pack(">HH", 0, len(body)) + body
        return stream

    async def run(self, requests: int) -> None:
        """Send so many, and hold the answers against what was sent."""
        while self.sent < requests:
            reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
            stream, at = self.in_step(), 0
            while at < len(stream):
                end = at + self.rng.choice((1, 5, 13, 100, 1000))
                writer.write(stream[at:end])
                at = end
            told = b""
            while judge(told)[0] < TOGETHER:
                told += await reader.read(1 << 16)
            assert [transaction for transaction, _, _ in answers(told)] == transactions(stream)
            await self._end(reader, writer)
            self.sent += TOGETHER + 1
            self.answered += TOGETHER

    async def _end(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Send what is damaged anywhere: it is answered as far as it is whole, or closes the connection."""
        last = damaged(self.rng, self.rng.choice(ALL_FRAMES))
        whole, is_in_step = judge(last)
        writer.write(last)
        if is_in_step:
            writer.write_eof()
        with contextlib.suppress(ConnectionError):
            assert len(answers(await reader.read())) == whole
        self.closed += not is_in_step
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


def transactions(stream: bytes) -> list[int]:
    """Return the ids of a stream of whole frames."""
    found = []
    while stream:
        transaction, _, length = struct.unpack_from(">HHH", stream)
        found.append(transaction)
        stream = stream[6 + length :]
    return found


async def fuzz(server: Served, seed: int, requests: int) -> list[Fuzzer]:
    """Let many clients send at a time."""
    fuzzers = [Fuzzer(seed + place, server.port) for place in range(CLIENTS)]
    await asyncio.gather(*(fuzzer.run(requests // CLIENTS) for fuzzer in fuzzers))
    await until(lambda: server.stats.tcp.connections == 0)
    return fuzzers


@pytest.mark.hazard("H18")
@pytest.mark.hazard("H26")
def test_a_hundred_thousand_damaged_requests_over_sockets() -> None:
    """In pieces, from many clients at a time: one answer for each whole frame, and nothing is left of any of them."""

    async def main() -> None:
        raised: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: raised.append(context))
        async with asyncio.timeout(LIMIT), serving() as server:
            server.obey(1)
            await fuzz(server, SEED, REQUESTS // 5)  # what is made once is made by now
            before, memory = left_behind(), resident()
            fuzzers = await fuzz(server, SEED + CLIENTS, REQUESTS)
            assert sum(fuzzer.sent for fuzzer in fuzzers) >= REQUESTS * 0.99
            assert sum(fuzzer.answered for fuzzer in fuzzers) > REQUESTS * 0.9
            assert sum(fuzzer.closed for fuzzer in fuzzers) > REQUESTS // 200
            assert left_behind() == before
            assert resident() - memory < GROWN_AT_MOST
            assert raised == []

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())


@pytest.mark.hazard("H26")
def test_every_split_point_over_sockets() -> None:
    """A stream of reads, writes and refusals in two pieces, the second when the first has been taken."""
    stream = b"".join(frame for frame in ALL_FRAMES if frame != COUNTERS)

    async def ask(server: Served, *pieces: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        for piece in pieces:
            asked = server.stats.tcp.requests.total() + judge(piece)[0] if piece is pieces[0] else 0
            writer.write(piece)
            await until(lambda asked=asked: server.stats.tcp.requests.total() >= asked)  # type: ignore[misc]
        writer.write_eof()
        told = await reader.read()
        writer.close()
        await writer.wait_closed()
        return told

    async def main() -> None:
        async with asyncio.timeout(LIMIT), serving() as server:
            server.obey(1)
            whole = await ask(server, stream)
            assert len(answers(whole)) == len(ALL_FRAMES) - 1
            for at in range(1, len(stream)):
                assert await ask(server, stream[:at], stream[at:]) == whole

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())


def test_more_than_the_requests_in_flight_come_in_one_segment() -> None:
    """Twice as many reads, then as many again: each is answered once, in order."""

    async def main() -> None:
        async with asyncio.timeout(LIMIT), serving() as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            for begin in (0, 2 * IN_FLIGHT):
                writer.write(b"".join(read(begin + i, 1, 0xFD00, 4) for i in range(2 * IN_FLIGHT)))
                told = answers(await reader.readexactly(2 * IN_FLIGHT * 17))
                assert [transaction for transaction, _, _ in told] == list(range(begin, begin + 2 * IN_FLIGHT))
            writer.close()
            await writer.wait_closed()

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(main())
