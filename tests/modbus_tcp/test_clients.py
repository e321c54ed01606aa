"""The server over loopback, on both event loops, with foreign clients and with clients that misbehave."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import struct
import subprocess
from collections.abc import Callable, Coroutine

import pytest
import uvloop
from pymodbus.client import AsyncModbusTcpClient, ModbusTcpClient

from gateway.clock import SystemClock
from gateway.config import ModbusTcpSection
from gateway.errors import GatewayError
from gateway.image import Image, LinkState
from gateway.metrics import Stats
from gateway.modbus_tcp.connection import Connection
from gateway.modbus_tcp.server import IDENTITY, ModbusTcpServer
from tests.modbus_tcp.rig import TOLD, answers, drive, fresh_image, read, until
from tests.modbus_tcp.served import Served, left_behind, resident, serving

pytestmark = pytest.mark.e2e

LIMIT = 60.0  # seconds for anything to happen
CONNECTIONS = 10_000
LEFT_AT_MOST = 2 * 1024 * 1024  # bytes; 200 for each of them would be a leak
LOOPS = {"asyncio": asyncio.new_event_loop, "uvloop": uvloop.new_event_loop}
Scenario = Callable[[], Coroutine[None, None, None]]


@pytest.fixture(params=LOOPS)
def run(request: pytest.FixtureRequest) -> Callable[[Scenario], None]:
    """Run a scenario on one loop and the other."""

    def in_time(scenario: Scenario) -> None:
        async def main() -> None:
            async with asyncio.timeout(LIMIT):
                await scenario()

        with asyncio.Runner(loop_factory=LOOPS[request.param]) as runner:
            runner.run(main())

    return in_time


async def is_closed(reader: asyncio.StreamReader) -> bool:
    """Say that the server has closed the connection, with nothing more sent."""
    try:
        return await reader.read() == b""
    except ConnectionResetError:
        return True


async def received(client: socket.socket) -> int:
    """Count what still arrives until the connection is closed."""
    size = 0
    with client, contextlib.suppress(ConnectionError):
        while data := await asyncio.get_running_loop().sock_recv(client, 1 << 20):
            size += len(data)
    return size


async def hang_up(*writers: asyncio.StreamWriter) -> None:
    """Close connections from the client's side."""
    for writer in writers:
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


def test_pymodbus_reads_synchronously(run: Callable[[Scenario], None]) -> None:
    """Values, exceptions, identification and the compact map."""

    def client(port: int) -> None:
        with ModbusTcpClient("127.0.0.1", port=port) as modbus:
            assert modbus.read_holding_registers(0xFD00, count=4, device_id=1).registers == [6000, 3, 5000, 0x1234]
            assert modbus.read_input_registers(0xFD18, count=1, device_id=1).registers == [0xFFFF]
            assert modbus.read_holding_registers(0xFD00, count=1, device_id=2).exception_code == 0x0B
            assert modbus.read_holding_registers(0xFD00, count=1, device_id=3).exception_code == 0x0A
            assert modbus.read_holding_registers(0xFD30, count=1, device_id=1).exception_code == 0x02
            assert modbus.write_register(0xFA00, 0x8400, device_id=1).exception_code == 0x01
            assert modbus.read_coils(0, count=1, device_id=1).exception_code == 0x01
            drives = modbus.read_holding_registers(0, count=64, device_id=255).registers
            assert [drives[16 * place] for place in range(4)] == [0, 2, 5, 0]
            told = modbus.read_device_information(device_id=1).information
            assert told == {i: text.encode() for i, text in enumerate(TOLD.values())}
            gateway = modbus.read_device_information(device_id=255).information
            assert gateway[1] == IDENTITY["device"].encode()

    async def scenario() -> None:
        async with serving() as server:
            await asyncio.to_thread(client, server.port)
            assert server.stats.tcp.requests[3] == 5

    run(scenario)


def test_pymodbus_reads_asynchronously_from_many_connections(run: Callable[[Scenario], None]) -> None:
    """Sixteen clients at a time, each with its own answers."""

    async def client(port: int, count: int) -> list[int]:
        async with AsyncModbusTcpClient("127.0.0.1", port=port) as modbus:
            for _ in range(5):
                told = await modbus.read_holding_registers(0xFD00, count=count, device_id=1)
                assert len(told.registers) == count
            return list(told.registers)

    async def scenario() -> None:
        async with serving() as server:
            told = await asyncio.gather(*(client(server.port, 1 + i % 4) for i in range(16)))
            assert [len(words) for words in told] == [1 + i % 4 for i in range(16)]
            assert server.stats.tcp.accepted == 16
            await until(lambda: server.stats.tcp.connections == 0)

    run(scenario)


MBPOLL = [
    (["-a", "247", "-0", "-r", "0", "-t", "4:float", "-B", "-c", "1"], 0, "[0]: \t60\n"),
    (["-a", "247", "-0", "-r", "2", "-t", "4:int", "-c", "1"], 0, "[2]: \t-10\n"),
    (["-a", "1", "-r", "64769", "-c", "4"], 0, "[64769]: \t6000"),
    (["-a", "1", "-0", "-r", "64768", "-c", "4"], 0, "[64771]: \t4660"),
    (["-a", "1", "-t", "3", "-r", "64769", "-c", "1"], 0, "[64769]: \t6000"),
    (["-a", "255", "-0", "-r", "0", "-c", "64"], 0, "[4]: \t6000"),
    (["-a", "255", "-0", "-t", "4:int", "-B", "-r", "61442", "-c", "1"], 0, "[61442]: \t0"),
    (["-a", "2", "-r", "64769", "-c", "1"], 1, "Target device failed to respond"),
    (["-a", "3", "-r", "64769", "-c", "1"], 1, "Gateway path unavailable"),
    (["-a", "77", "-r", "64769", "-c", "1"], 1, "Gateway path unavailable"),
    (["-a", "1", "-r", "1", "-c", "1"], 1, "Illegal data address"),
]


@pytest.mark.parametrize(("arguments", "code", "words"), MBPOLL, ids=[" ".join(row[0]) for row in MBPOLL])
def test_mbpoll_reads(arguments: list[str], code: int, words: str) -> None:
    """The tool that integrators have: as documented, with its 1-based numbers and with -0."""

    async def scenario() -> None:
        async with serving() as server:
            command = ["mbpoll", "-m", "tcp", "-p", str(server.port), *arguments, "-1", "127.0.0.1"]
            done = await asyncio.to_thread(
                subprocess.run, command, capture_output=True, text=True, check=False, timeout=LIMIT
            )
            assert words in done.stdout + done.stderr
            assert done.returncode == code

    asyncio.run(scenario())


@pytest.mark.hazard("H26")
def test_requests_in_pieces_and_in_heaps(run: Callable[[Scenario], None]) -> None:
    """Thirteen bytes at a time, then two thousand at once: all answered, in order."""

    async def scenario() -> None:
        async with serving() as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            stream = b"".join(read(i, 1, 0xFD00, 4) for i in range(2000))
            for at in range(0, 1300, 13):
                writer.write(stream[at : at + 13])
                await asyncio.sleep(0)
            writer.write(stream[1300:])
            told = answers(await reader.readexactly(2000 * 17))
            assert [transaction for transaction, _, _ in told] == list(range(2000))
            await hang_up(writer)

    run(scenario)


@pytest.mark.hazard("H26")
def test_what_is_no_modbus_is_closed(run: Callable[[Scenario], None]) -> None:
    """A browser, for example; the answer to what came before it still arrives."""

    async def scenario() -> None:
        async with serving() as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(read(1, 1, 0xFD00, 1) + b"GET / HTTP/1.1\r\nHost: gateway\r\n\r\n")
            assert len(answers(await reader.readexactly(11))) == 1
            assert await is_closed(reader)
            await until(lambda: server.stats.tcp.connections == 0)
            await hang_up(writer)

    run(scenario)


@pytest.mark.hazard("H25")
def test_the_thirty_third_client(run: Callable[[Scenario], None]) -> None:
    """Closed at once and counted; those that are in stay in; a place that is free again is given."""

    async def scenario() -> None:
        async with serving() as server:
            inside = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(32)]
            await until(lambda: server.stats.tcp.connections == 32)
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            assert await is_closed(reader)
            assert server.stats.tcp.turned_away == 1
            for i, (_, asking) in enumerate(inside):
                asking.write(read(i, 1, 0xFD00, 1))
            for i, (telling, _) in enumerate(inside):
                assert (await telling.readexactly(11))[:2] == struct.pack(">H", i)
            await hang_up(inside.pop()[1])
            await until(lambda: server.stats.tcp.connections == 31)
            inside.append(await asyncio.open_connection("127.0.0.1", server.port))
            inside[-1][1].write(read(7, 1, 0xFD00, 1))
            assert len(await inside[-1][0].readexactly(11)) == 11
            await hang_up(writer, *(one for _, one in inside))

    run(scenario)


@pytest.mark.hazard("H25")
def test_a_client_that_never_reads_is_cut_and_hinders_nobody(run: Callable[[Scenario], None]) -> None:
    """It is served until its buffers are full; five seconds later it is gone."""

    async def scenario() -> None:
        async with serving() as server:
            loop = asyncio.get_running_loop()
            stuck = socket.create_connection(("127.0.0.1", server.port))
            stuck.setblocking(False)
            flood = b"".join(read(i, 255, 0, 64) for i in range(60_000))
            sending = asyncio.create_task(loop.sock_sendall(stuck, flood))
            await until(lambda: any(c.overdue(server.clock.now() + 5, 60.0) for c in server._places.taken))
            before = server.stats.tcp.requests[3]
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            for i in range(50):
                writer.write(read(i, 1, 0xFD00, 1))
                await reader.readexactly(11)
            assert server.stats.tcp.requests[3] == before + 50 < 60_000
            server.clock.moment += 5.0
            server.sweep()
            await until(lambda: server.stats.tcp.connections == 1)
            with contextlib.suppress(ConnectionError):
                await sending
            assert await received(stuck) < 60_000 * 137
            await hang_up(writer)

    run(scenario)


@pytest.mark.hazard("H25")
def test_an_idle_client_is_cut_after_its_time(run: Callable[[Scenario], None]) -> None:
    """Sixty seconds by the clock, one that asks meanwhile stays."""

    async def scenario() -> None:
        async with serving() as server:
            idle, writer = await asyncio.open_connection("127.0.0.1", server.port)
            busy, asking = await asyncio.open_connection("127.0.0.1", server.port)
            await until(lambda: server.stats.tcp.connections == 2)
            server.clock.moment += 59.0
            asking.write(read(1, 255, 0, 1))
            await busy.readexactly(11)
            server.clock.moment += 2.0
            server.sweep()
            assert await is_closed(idle)
            assert server.stats.tcp.connections == 1
            await hang_up(writer, asking)

    run(scenario)


@pytest.mark.hazard("H25")
def test_the_sweep_runs_by_itself(run: Callable[[Scenario], None]) -> None:
    """A short idle time-out, the machine's clock, and nobody who calls the sweep."""

    async def scenario() -> None:
        clock = SystemClock()
        image = Image([drive()])
        image.drives[0].set_link(LinkState.ONLINE)
        keys = {"listen": "127.0.0.1:0", "connections": 32, "idle_timeout": 0.05}  # shorter than a user may set
        section = ModbusTcpSection.model_construct(**keys)  # type: ignore[arg-type]
        server = ModbusTcpServer(section, image, Stats(0.0), clock)
        await server.start()
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        assert await is_closed(reader)
        await hang_up(writer)
        await server.stop()

    run(scenario)


def test_a_client_that_ends_its_stream_gets_its_answers(run: Callable[[Scenario], None]) -> None:
    """As with printf | nc: shut down for writing, then read."""

    async def scenario() -> None:
        async with serving() as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(b"".join(read(i, 1, 0xFD00, 4) for i in range(100)))
            writer.write_eof()
            told = answers(await reader.read())
            assert [transaction for transaction, _, _ in told] == list(range(100))
            await until(lambda: server.stats.tcp.connections == 0)
            await hang_up(writer)

    run(scenario)


@pytest.mark.hazard("H25")
def test_ten_thousand_connections_leave_nothing_behind(run: Callable[[Scenario], None]) -> None:
    """They come and go, some in the middle of a request: no descriptor, task, place or memory is left."""

    async def come_and_go(server: Served, count: int) -> None:
        loop = asyncio.get_running_loop()
        come = server.stats.tcp.accepted + count
        for i in range(count):
            client = socket.socket()
            client.setblocking(False)
            await loop.sock_connect(client, ("127.0.0.1", server.port))
            if i % 3:
                await loop.sock_sendall(client, read(i & 0xFFFF, 1, 0xFD00, 4)[: 12 - i % 2])
            client.close()
            await until(lambda: server.stats.tcp.connections < 30)
        await until(lambda: server.stats.tcp.accepted == come and server.stats.tcp.connections == 0)

    async def scenario() -> None:
        async with serving() as server:
            await come_and_go(server, CONNECTIONS // 10)  # what is made once is made by now
            before, memory = left_behind(), resident()
            is_used = isinstance(asyncio.get_running_loop(), uvloop.Loop)  # by default: the other gets a tenth
            await come_and_go(server, CONNECTIONS if is_used else CONNECTIONS // 10)
            assert left_behind() == before
            assert resident() - memory < LEFT_AT_MOST

    run(scenario)


def test_keep_alive_is_on(run: Callable[[Scenario], None]) -> None:
    """A machine without power is found out."""

    async def scenario() -> None:
        async with serving() as server:
            _, writer = await asyncio.open_connection("127.0.0.1", server.port)
            await until(lambda: server.stats.tcp.connections == 1)
            (connection,) = server._places.taken
            assert isinstance(connection, Connection)
            peer = connection._transport.get_extra_info("socket")
            assert peer.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
            assert peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == 15
            assert peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
            await hang_up(writer)

    run(scenario)


def test_a_port_in_use_is_explained(run: Callable[[Scenario], None]) -> None:
    """The key to change, and who has it: this process."""

    async def scenario() -> None:
        async with serving() as server:
            second = Served(port=server.port)
            with pytest.raises(GatewayError, match=rf"^modbus_tcp\.listen: .*in use by .*\(pid {os.getpid()}\)"):
                await second.start()
            await second.stop()

    run(scenario)


def test_stop_cuts_every_client_and_frees_the_port(run: Callable[[Scenario], None]) -> None:
    """The same port can be listened on again."""

    async def scenario() -> None:
        server = Served()
        await server.start()
        port = server.port
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        await until(lambda: server.stats.tcp.connections == 1)
        await server.stop()
        assert await is_closed(reader)
        await hang_up(writer)
        again = Served(port=port)
        await again.start()
        assert again.port == port
        await again.stop()

    run(scenario)


def test_a_server_that_was_not_started_has_no_port() -> None:
    """And can be stopped."""
    server = Served()
    asyncio.run(server.stop())
    with pytest.raises(RuntimeError):
        server.port  # noqa: B018


def test_values_change_under_a_client(run: Callable[[Scenario], None]) -> None:
    """What is applied is answered next; what grows old is refused."""

    async def scenario() -> None:
        image = fresh_image()
        server = Served(image)
        await server.start()
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        for word in (1, 2, 3):
            image.by_unit[1].apply([(0xFD00, word)], server.clock.now(), 0.0)
            writer.write(read(word, 1, 0xFD00, 1))
            assert (await reader.readexactly(11))[9:] == struct.pack(">H", word)
        server.clock.moment += 1.5
        writer.write(read(4, 1, 0xFD00, 1))
        assert (await reader.readexactly(9))[7:] == b"\x83\x0b"
        await hang_up(writer)
        await server.stop()

    run(scenario)


