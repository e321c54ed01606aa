"""Clients' sockets and their turns, over loopback: a line waits for one turn, a client for nobody's defect."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import select
import socket
import struct
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any, cast

import pytest
import uvloop

from gateway.modbus_tcp import sockets, turns
from gateway.modbus_tcp.sockets import ClientSocket, Listener, listen
from gateway.modbus_tcp.turns import Answering
from tests.modbus_tcp.rig import until

pytestmark = pytest.mark.e2e

LIMIT = 10.0  # seconds for anything to happen
LOOPS = {"asyncio": asyncio.new_event_loop, "uvloop": uvloop.new_event_loop}
MUCH = 4 * 1024 * 1024  # bytes, more than the system's buffers take
Scenario = Callable[[], Coroutine[None, None, None]]
Run = Callable[[Scenario], None]


@pytest.fixture(params=LOOPS)
def run(request: pytest.FixtureRequest) -> Run:
    """Run a scenario on one loop and the other."""

    def in_time(scenario: Scenario) -> None:
        async def main() -> None:
            async with asyncio.timeout(LIMIT):
                await scenario()

        with asyncio.Runner(loop_factory=LOOPS[request.param]) as runner:
            runner.run(main())

    return in_time


class Noting(Answering):
    """A protocol that notes what it is told."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport
        self.got = b""
        self.told: list[str] = []
        self.lost: list[Exception | None] = []
        self.stays_open = False
        self.on_data: Callable[[bytes], None] = lambda data: None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport."""
        self.transport = cast("asyncio.Transport", transport)

    def data_received(self, data: bytes) -> None:
        """Take what came."""
        self.got += data
        self.on_data(data)

    def eof_received(self) -> bool:
        """Take that no more comes."""
        self.told.append("eof")
        return self.stays_open

    def pause_writing(self) -> None:
        """Take that enough is written."""
        self.told.append("pause")

    def resume_writing(self) -> None:
        """Take that more may be written."""
        self.told.append("resume")

    def connection_lost(self, exc: Exception | None) -> None:
        """Take that it is over."""
        self.lost.append(exc)


class Served:
    """A listener whose protocols are at hand."""

    def __init__(self) -> None:
        self.made: list[Noting] = []
        self.listener: Listener

    def _make(self) -> Noting:
        self.made.append(Noting())
        return self.made[-1]

    async def start(self) -> None:
        """Listen."""
        self.listener = cast("Listener", await listen(self._make, time.monotonic, "127.0.0.1", 0, 128))

    async def connect(self) -> tuple[socket.socket, Noting]:
        """Open a connection; return its two ends."""
        client = socket.socket()
        client.setblocking(False)
        count = len(self.made)
        await asyncio.get_running_loop().sock_connect(client, self.listener.sockets[0].getsockname())
        await until(lambda: len(self.made) == count + 1 and hasattr(self.made[-1], "transport"))
        return client, self.made[-1]


@contextlib.asynccontextmanager
async def serving() -> AsyncIterator[Served]:
    """Run a listener; whatever is open in the end is closed."""
    served = Served()
    await served.start()
    try:
        yield served
    finally:
        served.listener.close()
        for each in served.made:
            each.transport.abort()
        await until(lambda: all(each.lost for each in served.made))
        await served.listener.wait_closed()


async def received(client: socket.socket, size: int) -> int:
    """Read so many bytes, or up to the end; return how many came."""
    count = 0
    while count < size:
        data = await asyncio.get_running_loop().sock_recv(client, min(size - count, 1 << 16))
        if not data:
            break
        count += len(data)
    return count


TURNS = {  # how long one is, what counts as nothing between two of them, and how many of eight clients it serves
    "over at once": (-1.0, float("inf"), 1),
    "after something else": (LIMIT, -1.0, 1),
    "time enough": (LIMIT, float("inf"), 8),
}


@pytest.mark.hazard("H25")
@pytest.mark.parametrize(("turn", "alone", "served_by_one"), TURNS.values(), ids=TURNS)
def test_a_turn_that_is_over_lets_the_loop_go_on_first(
    run: Run, monkeypatch: pytest.MonkeyPatch, turn: float, alone: float, served_by_one: int
) -> None:
    """Eight clients ask at once: where a turn is over after the first, the loop goes on between any two."""
    monkeypatch.setattr(turns, "TURN", turn)
    monkeypatch.setattr(turns, "ALONE", alone)

    async def scenario() -> None:
        async with serving() as served:
            ends = [await served.connect() for _ in range(8)]
            order: list[int] = []
            its = served.listener._turns
            asyncio.get_running_loop().remove_reader(its._epoll.fileno())
            for place, (client, protocol) in enumerate(ends):
                protocol.on_data = lambda _, place=place: order.append(place)  # type: ignore[misc]
                client.send(b"x")
            await until(lambda: len(its._epoll.poll(0)) == 8)
            for served_by_now in range(served_by_one, 9, served_by_one):
                its._turn()
                assert len(order) == served_by_now
            assert sorted(order) == list(range(8))
            asyncio.get_running_loop().add_reader(its._epoll.fileno(), its._turn)
            for client, _ in ends:
                client.close()

    run(scenario)


def test_a_client_that_asks_all_the_time_does_not_keep_others_from_their_turn(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One has a megabyte waiting, and turns are over after each client: the other one is served at once."""
    monkeypatch.setattr(turns, "TURN", -1.0)

    async def scenario() -> None:
        async with serving() as served:
            flooding, flood = await served.connect()
            other, quiet = await served.connect()
            with contextlib.suppress(BlockingIOError):
                flooding.send(bytes(1 << 20))
            await until(lambda: len(flood.got) > 0)
            other.send(b"x")
            await until(lambda: quiet.got == b"x")
            assert len(flood.got) < 1 << 16
            flooding.close()
            other.close()

    run(scenario)


def test_what_the_system_does_not_take_is_sent_later(run: Run) -> None:
    """The protocol is told to pause, and to go on when it was read; closing waits for all of it."""

    async def scenario() -> None:
        async with serving() as served:
            client, protocol = await served.connect()
            protocol.transport.write(bytes(MUCH))
            protocol.transport.write(bytes(MUCH))
            assert protocol.told == ["pause"]
            assert protocol.transport.get_write_buffer_size() > 0
            assert await received(client, MUCH) == MUCH
            assert await received(client, MUCH) == MUCH
            await until(lambda: protocol.told == ["pause", "resume"])
            protocol.transport.write(bytes(MUCH))
            protocol.transport.close()
            assert protocol.transport.is_closing()
            protocol.transport.write(b"too late")
            assert await received(client, 2 * MUCH) == MUCH
            await until(lambda: protocol.lost == [None])
            client.close()

    run(scenario)


def test_abort_sends_nothing_more(run: Run) -> None:
    """What waits is dropped, and the end is told once."""

    async def scenario() -> None:
        async with serving() as served:
            client, protocol = await served.connect()
            protocol.transport.write(bytes(MUCH))
            protocol.transport.abort()
            protocol.transport.abort()
            protocol.transport.close()
            await until(lambda: protocol.lost == [None])
            with contextlib.suppress(ConnectionError):
                assert await received(client, MUCH) < MUCH
            client.close()

    run(scenario)


def test_no_more_is_read_while_reading_is_paused(run: Run) -> None:
    """Nor after a half-closed client has sent its last, though its end stands there for good."""

    async def scenario() -> None:
        async with serving() as served:
            client, protocol = await served.connect()
            protocol.stays_open = True
            protocol.transport.pause_reading()
            client.send(b"x")
            for _ in range(20):
                await asyncio.sleep(0)
            assert protocol.got == b""
            assert not protocol.transport.is_reading()
            protocol.transport.resume_reading()
            await until(lambda: protocol.got == b"x")
            client.shutdown(socket.SHUT_WR)
            await until(lambda: protocol.told == ["eof"])
            for _ in range(20):
                await asyncio.sleep(0)
            assert protocol.told == ["eof"]
            protocol.transport.write(b"answer")
            assert await received(client, 6) == 6
            client.close()

    run(scenario)


def test_another_protocol_may_take_over(run: Run) -> None:
    """What comes from then on is its own, and so is the end."""

    async def scenario() -> None:
        async with serving() as served:
            client, first = await served.connect()
            second = Noting()
            second.connection_made(first.transport)
            first.transport.set_protocol(second)
            assert first.transport.get_protocol() is second
            client.send(b"x")
            await until(lambda: second.got == b"x")
            client.close()
            await until(lambda: second.lost == [None])
            assert (first.got, first.lost) == (b"", [])
            served.made[:] = [second]

    run(scenario)


def test_closing_in_order_costs_no_answer(run: Run) -> None:
    """More was sent than is read at once: what is left unread does not turn the end into a reset."""

    async def scenario() -> None:
        async with serving() as served:
            client, protocol = await served.connect()

            def answer_and_close(_data: bytes) -> None:
                protocol.transport.write(b"answer")
                protocol.transport.close()

            protocol.on_data = answer_and_close
            client.send(bytes(20_000))
            await until(lambda: protocol.lost == [None])
            assert await asyncio.get_running_loop().sock_recv(client, 100) == b"answer"
            assert await asyncio.get_running_loop().sock_recv(client, 100) == b""
            client.close()

    run(scenario)


@pytest.mark.parametrize("is_paused", [False, True])
def test_a_client_that_vanishes_is_lost(run: Run, is_paused: bool) -> None:
    """Reset by the peer: with the error where it was read, and also where nothing is read from it."""

    async def scenario() -> None:
        async with serving() as served:
            client, protocol = await served.connect()
            if is_paused:
                protocol.transport.pause_reading()
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()
            await until(lambda: len(protocol.lost) == 1)
            assert isinstance(protocol.lost[0], ConnectionResetError) is not is_paused
            assert protocol.transport.is_closing()

    run(scenario)


def test_writing_to_a_client_that_vanished_loses_it(run: Run) -> None:
    """At once, or with what waits: no exception comes out of it."""

    async def scenario() -> None:
        async with serving() as served:
            for is_waiting in (False, True):
                client, protocol = await served.connect()
                protocol.transport.pause_reading()
                if is_waiting:
                    protocol.transport.write(bytes(MUCH))
                asyncio.get_running_loop().remove_reader(served.listener._turns._epoll.fileno())
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                client.close()
                if not is_waiting:
                    protocol.transport.write(b"x")
                    protocol.transport.write(b"x")
                else:
                    cast("ClientSocket", protocol.transport).look(select.EPOLLOUT)
                turns = served.listener._turns
                asyncio.get_running_loop().add_reader(turns._epoll.fileno(), turns._turn)
                await until(lambda protocol=protocol: len(protocol.lost) == 1)  # type: ignore[misc]
                assert isinstance(protocol.lost[0], ConnectionError)

    run(scenario)


@pytest.mark.hazard("H18")
def test_a_defect_costs_its_client_the_connection_and_is_reported(run: Run) -> None:
    """The loop's handler has it; the next client is served."""

    async def scenario() -> None:
        reports: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: reports.append(context))
        async with serving() as served:
            client, protocol = await served.connect()
            other, sound = await served.connect()
            error = ValueError("a defect")

            def fail(_data: bytes) -> None:
                raise error

            protocol.on_data = fail
            client.send(b"x")
            await until(lambda: protocol.lost == [None])
            other.send(b"y")
            await until(lambda: sound.got == b"y")
            assert [report["exception"] for report in reports] == [error]
            client.close()
            other.close()

    run(scenario)


def test_a_client_waits_where_there_is_no_descriptor_for_it(
    run: Run, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """It is taken a moment later, and the log says why it had to wait; others go on."""
    accept, left = socket.socket.accept, [2]

    def short(listening: socket.socket) -> tuple[socket.socket, Any]:
        if left[0]:
            left[0] -= 1
            raise OSError(errno.EMFILE, "Too many open files")
        return accept(listening)

    monkeypatch.setattr(socket.socket, "accept", short)
    monkeypatch.setattr(sockets, "ACCEPT_AGAIN", 0.001)

    async def scenario() -> None:
        async with serving() as served:
            client, _ = await served.connect()
            assert [record.getMessage() for record in caplog.records] == [
                "no client can be taken for 0.001 s: Too many open files"
            ] * 2
            client.close()

    run(scenario)


async def test_every_address_of_a_host_is_listened_on_or_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A port that is taken on the second address leaves the first one free."""
    taken = socket.create_server(("127.0.0.1", 0))
    port = taken.getsockname()[1]
    found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (host, port)) for host in ("127.0.0.2", "127.0.0.1")]

    async def resolve(*_arguments: object, **_more: object) -> list[Any]:
        return found

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", resolve)
    with pytest.raises(OSError, match="in use"):
        await listen(Noting, time.monotonic, "both", port, 8)
    found.pop()
    listener = await listen(Noting, time.monotonic, "first", port, 8)
    assert [each.getsockname()[0] for each in listener.sockets] == ["127.0.0.2"]
    listener.close()
    await listener.wait_closed()
    taken.close()


async def test_without_epoll_the_transports_of_the_loop_serve(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a system that has none."""
    monkeypatch.setattr(sockets, "HAS_EPOLL", False)
    made: list[Noting] = []

    def connect() -> Noting:
        made.append(Noting())
        return made[-1]

    server = await listen(connect, time.monotonic, "127.0.0.1", 0, 8)
    assert isinstance(server, asyncio.Server)
    _, writer = await asyncio.open_connection(*server.sockets[0].getsockname())
    writer.write(b"x")
    await until(lambda: bool(made) and made[0].got == b"x")
    writer.close()
    await until(lambda: made[0].lost == [None])
    server.close()
    await server.wait_closed()
