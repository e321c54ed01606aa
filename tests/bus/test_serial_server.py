"""Lines behind serial servers, raw and by RFC 2217, with foreign servers on the other side; and servers that fail."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
import sys
import threading
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
import uvloop

from gateway import site
from gateway.bus import serial_server
from gateway.bus.serial_line import open_line
from gateway.bus.session import opened
from gateway.clock import SystemClock
from gateway.errors import LineDown, NoReply
from gateway.protocol.pdu import ReadWords, WriteRam, Written
from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig
from tests.bus.bridge import bridged

pytestmark = pytest.mark.e2e

LOOPS = {"asyncio": asyncio.new_event_loop, "uvloop": uvloop.new_event_loop}
COMMAND_FREQUENCY = 0xFA01
EXCHANGES = 20
LIMIT = 30.0  # seconds after which a wait is given up
SOON = 4.0  # seconds on a busy machine; a server that does not accept is waited for longer


def configured(port: str, **more: Any) -> site.Line:
    """Return a line of one drive behind a port."""
    drive = {"name": "d1", "number": 1, "model": "vf-nc3"}
    table = {"gateway": {"name": "t"}, "line": [{"name": "a", "port": port, "drive": [drive], **more}]}
    return site.build(table, "test", Path()).lines[0]


@pytest.fixture
def simulated() -> Iterator[SimulatedLine]:
    """Run a simulated line of one drive."""
    config = {"drive": [{"number": 1, "model": "vf-nc3", "block_read": [1, 2, 3, 4, 5]}]}
    with SimulatedLine(SimulatedLineConfig.model_validate(config)) as line:
        yield line


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
async def test_drives_behind_a_serial_server_are_read_and_written_with_every_gap_kept(
    simulated: SimulatedLine, scheme: str
) -> None:
    """By raw TCP, and by RFC 2217 against pyserial's server; the words have every byte in them, FFH too."""
    async with bridged(simulated.port, speaks_rfc2217=scheme == "rfc2217") as (_, address):
        line = configured(f"{scheme}://{address}")
        async with opened(line, SystemClock()) as session:
            for word in range(0, 0x1400, 0x1400 // EXCHANGES):
                written = await session.send(line.drives[0].codec, WriteRam(1, COMMAND_FREQUENCY, word | 0xFF), 0.05)
                assert isinstance(written, Written)
                reply = await session.ask(line.drives[0], ReadWords(1, COMMAND_FREQUENCY))
                assert getattr(reply, "words", None) == (word | 0xFF,)
    counted = simulated.stats()
    assert counted["answers"] >= 2 * EXCHANGES
    assert counted["gap_violations"] == counted["splits"] == counted["collisions"] == 0


@pytest.mark.hazard("H15")
@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
async def test_a_dead_drive_behind_a_server_that_echoes_gives_no_reply(simulated: SimulatedLine, scheme: str) -> None:
    """A read shows the echo, and the echo of a write is no answer then."""
    simulated.do({"do": "fault", "kind": "echo"})
    simulated.do({"do": "fault", "kind": "cut"})
    async with bridged(simulated.port, speaks_rfc2217=scheme == "rfc2217") as (_, address):
        line = configured(f"{scheme}://{address}")
        async with opened(line, SystemClock()) as session:
            with pytest.raises(NoReply, match="only the echo"):
                await session.ask(line.drives[0], ReadWords(1, COMMAND_FREQUENCY))
            with pytest.raises(NoReply, match="only the echo"):
                await session.send(line.drives[0].codec, WriteRam(1, COMMAND_FREQUENCY, 5), 0.05)


@pytest.mark.parametrize(("parity", "letter", "stop_bits"), [("even", "E", 1), ("none", "N", 2)])
async def test_an_rfc2217_server_is_set_as_the_line_is_configured(
    simulated: SimulatedLine, parity: str, letter: str, stop_bits: int
) -> None:
    """Baud rate, parity, stop bits, no flow control; what lay in its buffers is thrown away."""
    async with bridged(simulated.port, speaks_rfc2217=True) as (bridge, address):
        port = await open_line(configured(f"rfc2217://{address}", baud=38400, parity=parity), SystemClock())
        await port.drain(0.05, 0.5)
        port.close()
        has = bridge.settings
        assert (has.baudrate, has.parity, has.stopbits, has.bytesize) == (38400, letter, stop_bits, 8)
        assert has.resets == ["input", "output"]


async def test_a_server_without_rfc2217_is_named_as_such(
    simulated: SimulatedLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And the other scheme with it."""
    monkeypatch.setattr(serial_server, "SETTINGS_TIMEOUT", 0.2)
    async with bridged(simulated.port) as (_, address):
        with pytest.raises(LineDown, match=r"does not speak RFC 2217; .*socket://"):
            await open_line(configured(f"rfc2217://{address}"), SystemClock())


# ---- servers that fail


@contextlib.asynccontextmanager
async def deaf_server() -> AsyncIterator[str]:
    """Listen without ever accepting, with the queue full: connecting takes for ever."""
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(socket.socket())
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        for _ in range(4):
            filling = stack.enter_context(socket.socket())
            filling.setblocking(False)
            filling.connect_ex(server.getsockname())
        yield f"127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.parametrize("loop", LOOPS)
def test_connecting_ends_at_once_when_it_is_broken_off(loop: str) -> None:
    """A gateway that ends does not wait for a server that does not accept."""

    async def main() -> float:
        async with deaf_server() as address:
            opening = asyncio.create_task(open_line(configured(f"socket://{address}"), SystemClock()))
            done, _ = await asyncio.wait([opening], timeout=0.2)
            assert not done
            opening.cancel()
            await asyncio.gather(opening, return_exceptions=True)
            return time.monotonic()

    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        begun = time.monotonic()
        runner.run(main())
    assert time.monotonic() - begun < SOON


@pytest.mark.parametrize("loop", LOOPS)
def test_a_server_that_does_not_accept_is_given_up_in_time(loop: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """With what may be the reason."""
    monkeypatch.setattr(serial_server, "CONNECT_TIMEOUT", 0.2)

    async def main() -> None:
        async with deaf_server() as address:
            with pytest.raises(LineDown, match="does not accept a connection; serial servers accept one client only"):
                await open_line(configured(f"socket://{address}"), SystemClock())

    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        runner.run(main())


async def test_a_server_that_goes_at_once_takes_the_line_down() -> None:
    """Reset before anything was asked of it; where it was can no longer be said."""

    def reset(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.abort()

    server = await asyncio.start_server(reset, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    with pytest.raises(LineDown, match=r"closed by the other side|gone|at once"):
        async with opened(configured(f"socket://127.0.0.1:{port}"), SystemClock()):
            raise AssertionError("it is gone")
    with pytest.raises(LineDown, match=r"closes the connection at once|reset"):
        await open_line(configured(f"rfc2217://127.0.0.1:{port}"), SystemClock())
    server.close()
    with socket.socket() as gone:
        assert not serial_server.is_on_this_machine(gone)


@pytest.mark.parametrize("loop", LOOPS)
def test_an_address_that_leads_nowhere_does_not_take_the_time_of_the_next(
    loop: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A name with an IPv6 address that is not routed, and one that works."""

    async def main() -> None:
        async with deaf_server() as deaf:
            with socket.create_server(("127.0.0.1", 0)) as server:
                ports = int(deaf.rpartition(":")[2]), server.getsockname()[1]
                found = [(socket.AF_INET, ("127.0.0.1", port)) for port in ports]
                monkeypatch.setattr(serial_server, "_look_up", lambda *_: found)
                line = await open_line(configured("socket://plc.example:4001"), SystemClock())
                assert line.may_be_simulated
                line.close()

    monkeypatch.setattr(serial_server, "CONNECT_TIMEOUT", 0.6)
    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        runner.run(main())


async def test_a_port_that_nobody_listens_on_and_a_name_that_nobody_has_are_said() -> None:
    """Each with what to look at."""
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        with pytest.raises(LineDown, match="is the serial server on, and line"):
            await open_line(configured(f"socket://127.0.0.1:{unused.getsockname()[1]}"), SystemClock())
    with pytest.raises(LineDown, match=r"nowhere\.invalid"):
        await open_line(configured("socket://nowhere.invalid:4001"), SystemClock())


async def test_a_name_is_looked_up_without_holding_up_the_loop_or_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """The resolver may take as long as it likes."""
    is_asked, may_answer = threading.Event(), threading.Event()

    def slow(host: str, port: int, flags: int = 0) -> list[serial_server.Address]:
        is_asked.set()
        may_answer.wait(30)
        return []

    monkeypatch.setattr(serial_server, "_look_up", slow)
    opening = asyncio.create_task(open_line(configured("socket://plc.example:4001"), SystemClock()))
    await asyncio.get_running_loop().run_in_executor(None, is_asked.wait, SOON)
    begun = time.monotonic()
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    assert time.monotonic() - begun < SOON
    may_answer.set()


def connecting(address: str) -> int:
    """Count the connections to an address that are not accepted yet: state 02 of proc_net_tcp(5)."""
    port = int(address.rpartition(":")[2])
    rows = [row.split() for row in Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]]
    return sum(row[2].endswith(f":{port:04X}") and row[3] == "02" for row in rows)


async def is_connecting(address: str, before: int) -> None:
    """Wait for one more connection to an address to be tried."""
    async with asyncio.timeout(LIMIT):
        while connecting(address) <= before:
            await asyncio.sleep(0.05)


@pytest.mark.parametrize("loop", LOOPS)
async def test_the_gateway_ends_at_once_while_a_serial_server_does_not_accept(loop: str, tmp_path: Path) -> None:
    """SIGTERM, as the service manager sends it."""
    async with deaf_server() as address:
        file = tmp_path / "gateway.toml"
        file.write_text(
            f'[gateway]\nname = "t"\nloop = "{loop}"\n[[line]]\nname = "a"\nport = "socket://{address}"\n'
            '[[line.drive]]\nname = "d1"\nnumber = 1\nmodel = "vf-nc3"\n'
        )
        before = connecting(address)
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "gateway", "run", str(file), stderr=asyncio.subprocess.PIPE
        )
        await is_connecting(address, before)
        process.send_signal(signal.SIGTERM)
        begun = time.monotonic()
        _, said = await asyncio.wait_for(process.communicate(), LIMIT)
        assert process.returncode == 0, said
        assert time.monotonic() - begun < SOON
