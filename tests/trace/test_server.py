"""Others see the frames over a socket: all of the ring, or what comes; nobody who looks can hold up a line."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import stat
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.trace import server
from gateway.trace.frames import Frame
from gateway.trace.meaning import Meaning
from gateway.trace.ring import Ring
from gateway.trace.server import TraceServer
from tests.trace.plays import ANSWER, READ, answered
from tests.trace.rig import SetClock

LIMIT = 20.0  # seconds after which a wait is given up
FOLLOW, RING = b'{"do": "follow"}\n', b'{"do": "ring"}\n'


@contextlib.asynccontextmanager
async def served(folder: Path, ring: Ring | None = None) -> AsyncIterator[TraceServer]:
    """Serve a ring while the block lasts."""
    made = TraceServer(folder / "s", "hall-3", {"a": Meaning()}, ring or Ring(100), SetClock())
    await made.start()
    try:
        yield made
    finally:
        await made.stop()
        while Client.opened:
            writer = Client.opened.pop()
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()


class Client:
    """Somebody who looks."""

    opened: list[asyncio.StreamWriter] = []

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def at(cls, folder: Path, request: bytes = b"") -> Client:
        """Connect, and ask for something."""
        client = cls(*await asyncio.open_unix_connection(str(folder / "s"), limit=1 << 20))
        cls.opened.append(client.writer)
        client.writer.write(request)
        return client

    async def table(self) -> dict[str, Any]:
        """Return the next line."""
        line = await asyncio.wait_for(self.reader.readline(), LIMIT)
        table: dict[str, Any] = json.loads(line)
        return table

    async def is_over(self) -> bool:
        """Say whether the connection has ended."""
        try:
            return await asyncio.wait_for(self.reader.read(), LIMIT) == b""
        except ConnectionResetError:  # what it asked for was not read any more
            return True


async def test_the_ring_is_shown_whole_and_then_it_is_over(tmp_path: Path) -> None:
    """Every frame of it, the oldest first."""
    ring = Ring(100)
    for second in range(30):
        ring.add("a", answered(float(second)))
    async with served(tmp_path, ring):
        client = await Client.at(tmp_path, RING)
        assert await client.table() == {"trace": 1, "gateway": "hall-3", "lines": ["a"]}
        shown = [Frame.of_table(await client.table()) for _ in range(60)]
        assert [frame.data for frame in shown] == [READ, ANSWER] * 30
        assert [frame.end for frame in shown] == sorted(frame.end for frame in shown)
        assert await client.table() == {"over": True}
        assert await client.is_over()


async def test_a_reader_of_the_ring_that_pauses_misses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a pager does, for longer than anything else is waited for; to the last frame, and the mark behind it."""
    loop, ring, shown = asyncio.get_running_loop(), Ring(10_000), b""
    for _ in range(2000):
        ring.add("a", answered())
    async with served(tmp_path, ring) as made:
        with socket.socket(socket.AF_UNIX) as client:
            client.setblocking(False)
            await loop.sock_connect(client, str(tmp_path / "s"))
            await loop.sock_sendall(client, RING)
            shown += await asyncio.wait_for(loop.sock_recv(client, 10), LIMIT)
            monkeypatch.setattr(server, "PATIENCE", 0.0)
            (writer,) = made._clients
            while not writer.transport.get_write_buffer_size() and not writer.is_closing():
                await asyncio.sleep(0)
            for _ in range(10):
                await asyncio.sleep(0)
            while data := await asyncio.wait_for(loop.sock_recv(client, 65_536), LIMIT):
                shown += data
    lines = shown.splitlines()
    assert len(lines) == 1 + 4000 + 1
    assert json.loads(lines[-1]) == {"over": True}


async def test_a_follower_sees_what_comes(tmp_path: Path) -> None:
    """And nothing of before."""
    ring = Ring(100)
    ring.add("a", answered(1.0))
    async with served(tmp_path, ring) as made:
        client = await Client.at(tmp_path, FOLLOW)
        await client.table()
        await asyncio.sleep(0)
        made.take("a", answered(5.0))
        shown = [Frame.of_table(await client.table()) for _ in range(2)]
        assert [frame.begin - SetClock().wall() + SetClock().now() for frame in shown] == pytest.approx([5.0, 5.02])


async def test_a_follower_that_does_not_read_loses_frames_and_is_told_how_many(tmp_path: Path) -> None:
    """Nothing waits for it, memory is bounded, and what it gets and what it lost is all that there was."""
    loop, told, counted, rest = asyncio.get_running_loop(), 4000, 0, b""
    async with served(tmp_path) as made:
        with socket.socket(socket.AF_UNIX) as client:
            client.setblocking(False)
            await loop.sock_connect(client, str(tmp_path / "s"))
            await loop.sock_sendall(client, FOLLOW)
            while not made._followers:
                await asyncio.sleep(0)
            (follower,) = made._followers
            for _ in range(told):
                made.take("a", answered())
                await asyncio.sleep(0)
            assert follower.lost > 0
            assert follower.writer.transport.get_write_buffer_size() < 2 * server.MOST_UNREAD
            while counted < 2 * told:
                lines = (rest + await asyncio.wait_for(loop.sock_recv(client, 65_536), LIMIT)).split(b"\n")
                rest = lines.pop()
                counted += sum(json.loads(line).get("lost", 1) for line in lines if b"gateway" not in line)
                if follower.lost and not follower.writer.transport.get_write_buffer_size():
                    made.take("a", answered())  # it says at the next one what was lost
                    told += 1
            assert counted == 2 * told


@contextlib.asynccontextmanager
async def stuck(folder: Path, made: TraceServer) -> AsyncIterator[tuple[socket.socket, Any]]:
    """Have somebody follow who does not read, until more waits than the kernel takes; and the server's end of it."""
    loop = asyncio.get_running_loop()
    with socket.socket(socket.AF_UNIX) as client:
        client.setblocking(False)
        await loop.sock_connect(client, str(folder / "s"))
        await loop.sock_sendall(client, FOLLOW)
        while not made._followers:
            await asyncio.sleep(0)
        (follower,) = made._followers
        while not follower.lost:
            made.take("a", answered())
            await asyncio.sleep(0)
        yield client, follower.writer.get_extra_info("socket")


async def test_who_goes_without_reading_counts_until_the_connection_is_closed(tmp_path: Path) -> None:
    """No more descriptors are open than clients are counted."""
    async with served(tmp_path) as made, stuck(tmp_path, made) as (client, connection):
        client.shutdown(socket.SHUT_WR)
        while made._followers:
            await asyncio.sleep(0)
        assert connection.fileno() >= 0
        assert len(made._clients) == 1


async def test_a_connection_whose_end_is_not_read_is_broken_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a bounded time: the descriptor is free again, and so is the place."""
    async with served(tmp_path) as made, stuck(tmp_path, made) as (client, connection):
        monkeypatch.setattr(server, "PATIENCE", 0.0)
        client.shutdown(socket.SHUT_WR)
        async with asyncio.timeout(LIMIT):
            while made._clients:
                await asyncio.sleep(0)
        assert connection.fileno() == -1


async def test_the_end_of_the_gateway_closes_every_connection(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of those who do not read."""
    async with served(tmp_path) as made, stuck(tmp_path, made) as (_, connection):
        monkeypatch.setattr(server, "LAST_WORDS", 0.0)
        await asyncio.wait_for(made.stop(), LIMIT)
        assert connection.fileno() == -1


async def test_without_a_follower_nothing_is_worked_on(tmp_path: Path) -> None:
    """Only somebody who looks costs anything."""
    async with served(tmp_path) as made:
        made.take("a", answered())
        assert not made._pending


async def test_the_socket_is_for_its_owner_only(tmp_path: Path) -> None:
    """Mode 0600 from the beginning."""
    async with served(tmp_path):
        assert stat.S_IMODE((tmp_path / "s").stat().st_mode) == 0o600
    assert not (tmp_path / "s").exists()


async def test_no_more_than_a_few_may_look(tmp_path: Path) -> None:
    """The next one is told; a place becomes free when one goes."""
    async with served(tmp_path):
        clients = [await Client.at(tmp_path, FOLLOW) for _ in range(server.MOST_CLIENTS)]
        for client in clients:
            await client.table()
        one_more = await Client.at(tmp_path, FOLLOW)
        assert await one_more.table() == {"error": "8 others look already"}
        assert await one_more.is_over()
        clients[0].writer.close()
        await clients[0].writer.wait_closed()
        while "error" in await (await Client.at(tmp_path, FOLLOW)).table():
            pass


@pytest.mark.parametrize("request_", [b'{"do": "stop"}\n', b"[]\n", b"{}\n"])
async def test_nothing_else_can_be_asked_for(tmp_path: Path, request_: bytes) -> None:
    """It is read only: no request changes anything."""
    async with served(tmp_path):
        client = await Client.at(tmp_path, request_)
        assert "is wanted" in (await client.table())["error"]
        assert await client.is_over()


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=3000))
def test_whatever_is_sent_only_ends_the_connection(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    """Too long, no JSON, no object: the next one is served."""

    async def main() -> None:
        folder = tmp_path_factory.mktemp("s")
        async with served(folder):
            client = await Client.at(folder, data + b"\n")
            with contextlib.suppress(ConnectionError):
                client.writer.write_eof()
                await asyncio.wait_for(client.reader.read(), LIMIT)
            assert "trace" in await (await Client.at(folder, RING)).table()

    asyncio.run(main())


async def test_what_a_killed_gateway_left_is_taken_away(tmp_path: Path) -> None:
    """A socket that nobody serves."""
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "s"))
    async with served(tmp_path):
        assert "trace" in await (await Client.at(tmp_path, RING)).table()


async def test_a_socket_that_is_served_is_left_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The second gateway goes on without, says so, and takes nothing away when it ends."""
    async with served(tmp_path):
        async with served(tmp_path):
            assert "another gateway serves it" in caplog.text
        assert "trace" in await (await Client.at(tmp_path, RING)).table()


@pytest.mark.parametrize("place", ["none/s", "f", "x" * 120])
async def test_a_socket_that_cannot_be_is_no_reason_not_to_run(
    tmp_path: Path, place: str, caplog: pytest.LogCaptureFixture
) -> None:
    """No folder, a file in the way, a path that is too long: the log says what."""
    (tmp_path / "f").write_text("mine")
    made = TraceServer(tmp_path / place, "hall-3", {"a": Meaning()}, Ring(10), SetClock())
    await made.start()
    await made.stop()
    assert "cannot ask this gateway" in caplog.text
    assert (tmp_path / "f").read_text() == "mine"
