"""A server with TLS over loopback, a set of certificates for it, and clients that show them."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import struct
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway.clock import SystemClock
from gateway.config import ModbusTcpSection
from gateway.control.door import Door
from gateway.image import Image
from gateway.metrics import LineStats, Stats
from gateway.modbus_tcp.listeners import RtuListener, TcpListener, TlsListener
from gateway.modbus_tcp.server import IDENTITY, ModbusTcpServer
from tests.modbus_tcp.certificates import CLIENT_AUTH, SERVER_AUTH, Authority, Key, address, role, usage
from tests.modbus_tcp.rig import StandingClock, fresh_image, request


class MovableClock(StandingClock):
    """A clock that stands, but for UTC, which is that of this machine and what a test adds to it."""

    shift: float = 0.0  # seconds

    def wall(self) -> float:
        """Return UTC seconds."""
        return SystemClock().wall() + self.shift


@dataclass
class Pki:
    """Authorities, and certificates of one key."""

    folder: Path
    key: Key = field(init=False)
    authority: Authority = field(init=False)
    server: Path = field(init=False)

    def __post_init__(self) -> None:
        self.key = Key.make(self.folder / "one.key")
        self.authority = Authority(self.folder)
        self.server = self.authority.issue("server", self.key, address(), usage(SERVER_AUTH), ends=90.0)

    def client(self, name: str, *extensions: bytes, by: Authority | None = None, **more: Any) -> Path:
        """Issue a certificate for a client; by default one that is right but for its role."""
        return (by or self.authority).issue(name, self.key, *extensions, usage(CLIENT_AUTH), **more)

    def holder_of(self, text: str) -> ssl.SSLContext:
        """Return what a client with a role has."""
        return self.context(self.client(f"holder-{text}", role(text)))

    def context(self, certificate: Path | None) -> ssl.SSLContext:
        """Return what a client has that shows a certificate, or none."""
        context = ssl.create_default_context(cafile=self.authority.path)
        context.verify_flags |= ssl.VERIFY_X509_STRICT
        if certificate is not None:
            context.load_cert_chain(certificate, self.key.path)
        return context

    def section(self, **more: Any) -> dict[str, Any]:
        """Return the configuration of TLS."""
        files = {"certificate": str(self.server), "key": str(self.key.path), "ca": str(self.authority.path)}
        return {"listen": "127.0.0.1:0", **files, **more}


class Secured(ModbusTcpServer):
    """A server with a plain port and one for TLS, both free ones."""

    def __init__(
        self,
        pki: Pki,
        tls: dict[str, Any] | None = None,
        image: Image | None = None,
        door: Door | None = None,
        **more: Any,
    ) -> None:
        self.clock = MovableClock()
        self.stats = Stats(0.0, {"a": LineStats()})
        table = {"listen": "127.0.0.1:0", "tls": pki.section(**(tls or {})), **more}
        section = ModbusTcpSection.model_validate(table)
        super().__init__(section, image or fresh_image(), self.stats, self.clock, IDENTITY, door)

    @property
    def tls_port(self) -> int:
        """Return the port for TLS."""
        return self.port_of(TlsListener)

    @property
    def rtu_port(self) -> int:
        """Return the port for MODBUS-RTU over TCP."""
        return self.port_of(RtuListener)

    @property
    def plain_port(self) -> int:
        """Return the port without TLS."""
        return self.port_of(TcpListener)

    @property
    def ends(self) -> dict[str, int]:
        """Return how handshakes have ended."""
        return dict(self.stats.tcp.handshakes)


@contextlib.asynccontextmanager
async def serving(pki: Pki, **more: Any) -> AsyncIterator[Secured]:
    """Run a server."""
    server = Secured(pki, **more)
    await server.start()
    try:
        yield server
    finally:
        await server.stop()


class Client:
    """A client over loopback: `ask` returns the PDU that answers."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.asked = 0

    async def ask(self, unit: int, pdu: bytes) -> bytes:
        """Send a request and wait for its answer."""
        self.asked += 1
        self.writer.write(request(self.asked, unit, pdu))
        head = await self.reader.readexactly(6)
        number, protocol, length = struct.unpack(">HHH", head)
        assert (number, protocol) == (self.asked, 0)
        return (await self.reader.readexactly(length))[1:]

    async def is_closed(self) -> bool:
        """Wait until the server has closed the connection; AssertionError where it sends anything."""
        with contextlib.suppress(ConnectionError, ssl.SSLError):
            assert await self.reader.read() == b""
        return True


@contextlib.asynccontextmanager
async def client(port: int, context: ssl.SSLContext | None = None) -> AsyncIterator[Client]:
    """Connect, by TLS where a context is given."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
    try:
        yield Client(reader, writer)
    finally:
        writer.transport.abort()


async def refused(port: int, context: ssl.SSLContext) -> str:
    """Try to be served by TLS; return what a client is told, AssertionError where it is served."""
    try:
        async with client(port, context) as made:
            told = await made.ask(1, bytes.fromhex("03fd000001"))
    except (ssl.SSLError, ConnectionError, asyncio.IncompleteReadError) as error:
        return str(error)
    raise AssertionError(told)


class ByHand:
    """A TLS client whose records a test sends itself."""

    def __init__(self, context: ssl.SSLContext, streams: tuple[asyncio.StreamReader, asyncio.StreamWriter]) -> None:
        self.reader, self.writer = streams
        self.incoming, self.outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.tls = context.wrap_bio(self.incoming, self.outgoing, server_hostname="127.0.0.1")

    async def shake_hands(self) -> None:
        """Come to terms with the server."""
        while True:
            try:
                self.tls.do_handshake()
            except ssl.SSLWantReadError:
                self.flush()
                self.incoming.write(await self.reader.read(65536))
            else:
                break
        self.flush()

    def flush(self) -> None:
        """Send what is to be sent."""
        self.writer.write(self.outgoing.read())

    async def read(self, size: int) -> bytes:
        """Read so many bytes that the server has said."""
        told = b""
        while len(told) < size:
            try:
                told += self.tls.read(size - len(told))
            except ssl.SSLWantReadError:
                self.incoming.write(await self.reader.read(65536))
        return told

    async def take_the_rest(self) -> None:
        """Take all that comes until the server closes."""
        with contextlib.suppress(ConnectionError):
            while data := await self.reader.read(65536):
                self.incoming.write(data)


@contextlib.asynccontextmanager
async def by_hand(port: int, context: ssl.SSLContext, *, is_small: bool = False) -> AsyncIterator[ByHand]:
    """Connect, and do the handshake; a small client has room for little that it has not read."""
    sock = socket.socket()
    if is_small:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    sock.setblocking(False)
    await asyncio.get_running_loop().sock_connect(sock, ("127.0.0.1", port))
    made = ByHand(context, await asyncio.open_connection(sock=sock))
    try:
        await made.shake_hands()
        yield made
    finally:
        made.writer.transport.abort()


async def raw(port: int, data: bytes) -> bytes:
    """Send bytes and return all that comes until the server closes."""
    with socket.create_connection(("127.0.0.1", port)) as sock:
        sock.setblocking(False)
        loop = asyncio.get_running_loop()
        await loop.sock_sendall(sock, data)
        told = b""
        with contextlib.suppress(ConnectionError):
            while piece := await loop.sock_recv(sock, 4096):
                told += piece
        return told
