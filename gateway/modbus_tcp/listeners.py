"""The ways in: MODBUS-TCP as it is, by TLS, and with MODBUS-RTU frames; who comes in is known by address or role."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable

from gateway.clock import Clock
from gateway.config import OFF, ModbusTcpSection, ModbusTlsSection, address
from gateway.metrics import TcpStats
from gateway.modbus_tcp.connection import Connection, call_later
from gateway.modbus_tcp.credentials import Keyring
from gateway.modbus_tcp.handshakes import Handshakes
from gateway.modbus_tcp.places import Places
from gateway.modbus_tcp.reception import Reception
from gateway.modbus_tcp.rtu_connection import RtuConnection
from gateway.modbus_tcp.sockets import Listener, listen
from gateway.modbus_tcp.tls_connection import TlsClient
from gateway.modbus_tcp.turns import Answering
from gateway.ports import explain_bind_error

log = logging.getLogger("gateway.modbus_tcp")

BACKLOG = 128

Connect = Callable[[type[Connection]], Connection]
"""Makes a connection of one kind."""


class TcpListener:
    """One port. `start` raises GatewayError with the key to change where it cannot listen."""

    title = "MODBUS-TCP"

    def __init__(self, key: str, listen: str, factory: Callable[[], Answering], clock: Clock) -> None:
        self._key = key
        self._listen = listen
        self._factory = factory
        self._clock = clock
        self._server: Listener | asyncio.Server | None = None

    async def start(self) -> None:
        """Listen from now on."""
        host, port = address(self._listen)
        try:
            self._server = await listen(self._factory, self._clock.now, host, port, BACKLOG)
        except OSError as error:
            raise explain_bind_error(error, host, port, self._key) from error
        log.info("%s on %s port %d", self.title, host, self.port)

    @property
    def port(self) -> int:
        """Return the port that is listened on."""
        if self._server is None:
            raise RuntimeError("the server has not been started")
        return int(self._server.sockets[0].getsockname()[1])

    def pulse(self, now: float) -> None:
        """See to what has run out."""

    def renew(self) -> None:
        """Read anew what is read from files."""

    def close(self) -> None:
        """Listen no more."""
        if self._server is not None:
            self._server.close()

    async def wait_closed(self) -> None:
        """Wait until everything of it is closed."""
        if self._server is not None:
            await self._server.wait_closed()
        self._server = None


class RtuListener(TcpListener):
    """The port for MODBUS-RTU over TCP."""

    title = "MODBUS-RTU over TCP"


class TlsListener(TcpListener):
    """The port for TLS, with its certificates and the handshakes under way."""

    title = "MODBUS/TCP Security"

    def __init__(
        self,
        section: ModbusTlsSection,
        reception: Reception,
        clock: Clock,
        places: Places,
        stats: TcpStats,
        limit: int,
    ) -> None:
        self._keyring = Keyring(section, clock, stats)
        self._handshakes = Handshakes(limit, section.handshake_timeout, stats, call_later)

        def client() -> TlsClient:
            return TlsClient(self._keyring, reception, clock, places, self._handshakes)

        super().__init__("modbus_tcp.tls.listen", section.listen, client, clock)

    def pulse(self, now: float) -> None:
        """Give up handshakes that stall, and look after the certificates."""
        self._handshakes.sweep(now)
        self._keyring.pulse()

    def renew(self) -> None:
        """Read the certificates anew where their files have changed."""
        self._keyring.renew()

    def close(self) -> None:
        """Listen no more, and end the handshakes."""
        super().close()
        self._handshakes.give_up_all()


def listeners(
    section: ModbusTcpSection,
    connect: Connect,
    reception: Reception,
    clock: Clock,
    places: Places,
    stats: TcpStats,
) -> tuple[TcpListener, ...]:
    """Return the listeners of a configuration, the plain one first; `connect` serves clients without TLS."""
    found: list[TcpListener] = []
    if section.listen != OFF:
        found.append(TcpListener("modbus_tcp.listen", section.listen, lambda: connect(Connection), clock))
    if section.tls is not None:
        found.append(TlsListener(section.tls, reception, clock, places, stats, section.connections))
    if section.rtu is not None:
        found.append(RtuListener("modbus_tcp.rtu.listen", section.rtu.listen, lambda: connect(RtuConnection), clock))
    return tuple(found)
