"""Bytes of anybody on the port for TLS: nothing is raised, nobody is answered, and nothing is left behind."""

from __future__ import annotations

import asyncio
import contextlib
import random
import ssl
from pathlib import Path

import pytest

from gateway.modbus_tcp.listeners import TlsListener
from gateway.modbus_tcp.tls_connection import TlsClient
from tests.modbus_tcp.rig import Wire, read, until
from tests.modbus_tcp.secured import Pki, Secured, client, serving
from tests.soak import FACTOR

pytestmark = pytest.mark.e2e

LIMIT = 60.0  # seconds for anything to happen


class Peer:
    """A client in memory, and the server's side of it."""

    def __init__(self, server: Secured, context: ssl.SSLContext) -> None:
        listener = next(one for one in server._listeners if isinstance(one, TlsListener))
        made = listener._factory()
        assert isinstance(made, TlsClient)
        self.wire = _Wire()
        self.wire.connection = made  # type: ignore[assignment]
        self.made = made
        self.made.connection_made(self.wire)
        self.incoming, self.outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.tls = context.wrap_bio(self.incoming, self.outgoing, server_hostname="127.0.0.1")
        self.done = 0

    def flight(self) -> bytes:
        """Return what the client sends next: its part of the handshake, and then a request."""
        self.incoming.write(self.wire.sent[self.done :])
        self.done = len(self.wire.sent)
        with contextlib.suppress(ssl.SSLError):
            self.tls.do_handshake()
            self.tls.write(read(1, 1, 0xFD00, 1))
        return self.outgoing.read()


class _Wire(Wire):
    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Take what the server sends."""
        self.writes.append(bytes(data))

    def abort(self) -> None:
        """Close at once."""
        self.close()

    def close(self) -> None:
        """Close."""
        if not self.is_closed:
            self.is_closed = True
            self.connection.connection_lost(None)


@pytest.mark.hazard("H26")
async def test_changed_handshakes_and_records_are_never_answered(tmp_path: Path) -> None:
    """By seed: bytes are changed, lost or added in any flight; from then on nothing is done."""
    pki = Pki(tmp_path)
    context = pki.holder_of("viewer")
    chance = random.Random(802)
    server = Secured(pki)
    served = 0
    for number in range(120 * FACTOR):
        server.clock.moment += 1.0
        server.stats.tcp.requests.clear()
        peer, is_changed = Peer(server, context), False
        for _ in range(4):
            right = peer.flight()
            data = bytearray(right)
            if data and chance.random() < number % 3 / 3:
                at, size = chance.randrange(len(data)), chance.randint(0, 3)
                data[at : at + size] = chance.randbytes(chance.randint(0, 3))
            is_changed |= data != right
            before = server.stats.tcp.requests[3]
            while data and not peer.wire.is_closed:
                size = chance.randint(1, 1500)
                peer.made.data_received(bytes(data[:size]))
                del data[:size]
            assert server.stats.tcp.requests[3] == before or not is_changed
        served += server.stats.tcp.requests[3]
        peer.wire.close()
        assert not server._places.taken
    assert served >= 120 * FACTOR
    assert sum(server.ends.values()) == 120 * FACTOR


@pytest.mark.hazard("H26")
async def test_any_bytes_end_a_handshake(tmp_path: Path) -> None:
    """Whatever they are, in whatever pieces."""
    server = Secured(Pki(tmp_path))
    context = ssl.create_default_context()
    chance = random.Random(443)
    heads = (b"", b"\x16\x03\x01", b"\x16\x03\x03\x00\x20", b"\x15\x03\x03\x00\x02", b"\x17\x03\x03", b"\x80\x2e\x01")
    for _ in range(2_000 * FACTOR):
        server.clock.moment += 1.0
        peer = Peer(server, context)
        for _ in range(chance.randint(1, 3)):
            peer.made.data_received(chance.choice(heads) + chance.randbytes(chance.randint(0, 60)))
        peer.wire.close()
    assert sum(server.ends.values()) == 2_000 * FACTOR
    assert not server._places.taken
    assert set(server.ends) <= {"not_tls", "left", "other", "version", "refused_by_client", "no_cipher"}


@pytest.mark.hazard("H25")
async def test_connections_that_come_and_go_leave_nothing_behind(tmp_path: Path) -> None:
    """Served, half open, without TLS, without a certificate: descriptors and tasks are those of before."""
    pki = Pki(tmp_path)
    context, nobody = pki.holder_of("viewer"), pki.context(None)
    async with asyncio.timeout(LIMIT), serving(pki) as server:
        before, tasks = _descriptors(), len(asyncio.all_tasks())
        for _ in range(20 * FACTOR):
            async with client(server.tls_port, context) as made:
                assert await made.ask(255, bytes.fromhex("0300000001"))
            with contextlib.suppress(ssl.SSLError, ConnectionError, asyncio.IncompleteReadError):
                async with client(server.tls_port, nobody) as made:
                    await made.ask(255, bytes.fromhex("0300000001"))
            async with client(server.tls_port) as made:
                made.writer.write(b"\x16\x03\x01" if server.stats.tcp.accepted % 2 else b"GET /")
        await until(lambda: sum(server.ends.values()) == 60 * FACTOR and server.stats.tcp.connections == 0)
        await until(lambda: _descriptors() <= before and len(asyncio.all_tasks()) <= tasks)


def _descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))
