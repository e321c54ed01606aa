"""The MODBUS-TCP server: connections, their limits, and framing; it never waits for a drive."""

from __future__ import annotations

import asyncio
import logging
import socket
import struct

from pymodbus.constants import DeviceInformation
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest, ReadDeviceInformationResponse

from gateway import __version__
from gateway.clock import Clock
from gateway.config import ModbusTcpSection, address
from gateway.image import Image
from gateway.metrics import Stats, TcpStats
from gateway.modbus_tcp.mapping import GATEWAY_UNIT
from gateway.modbus_tcp.requests import ILLEGAL_ADDRESS, ILLEGAL_VALUE, TARGET_FAILED, Answerer
from gateway.ports import explain_bind_error

log = logging.getLogger("gateway.modbus_tcp")

MBAP = struct.Struct(">HHHB")  # transaction, protocol, length (unit and PDU), unit
LONGEST = 254  # unit and PDU: a PDU has at most 253 bytes
WRITE_CAP = 64 * 1024  # bytes that may wait for a slow reader
SLOW_READER = 5.0  # seconds for it to take them
READ_CODES = (1, 2, 3, 4)  # basic, regular, extended, one object
GATEWAY_OBJECTS = {0: b"tosvert-gateway", 1: b"TOSVERT MODBUS-TCP/MQTT gateway", 2: __version__.encode()}


class ModbusTcpServer:
    """Serves the image to any number of clients up to the configured one; the next one is closed at once."""

    def __init__(self, section: ModbusTcpSection, image: Image, stats: Stats, clock: Clock) -> None:
        self._section = section
        self._image = image
        self._stats = stats.tcp
        self._answerer = Answerer(image, stats, clock.now, clock.wall, self._identify)
        self._clock = clock
        self._server: asyncio.Server | None = None
        self._watch: asyncio.Task[None] | None = None
        self.connections: set[Connection] = set()

    async def start(self) -> None:
        """Listen; GatewayError says why that cannot be."""
        host, port = address(self._section.listen)
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(self._accept, host, port, backlog=256)
        except OSError as error:
            raise explain_bind_error(error, host, port, "modbus_tcp.listen") from error
        self._watch = asyncio.create_task(self._watch_connections())
        log.info("MODBUS-TCP on %s:%d", host, self.port)

    @property
    def port(self) -> int:
        """Return the port that is listened on."""
        sockets = self._server.sockets if self._server else ()
        return int(sockets[0].getsockname()[1]) if sockets else 0

    async def stop(self) -> None:
        """Stop listening and close every connection."""
        if self._watch is not None:
            self._watch.cancel()
        if self._server is not None:
            self._server.close()
        for connection in list(self.connections):
            connection.abort()
        if self._server is not None:
            await self._server.wait_closed()

    def _accept(self) -> Connection:
        return Connection(self, self._answerer, self._stats, self._clock)

    def admit(self, connection: Connection) -> bool:
        """Say whether a new connection may stay."""
        if len(self.connections) >= self._section.connections:
            self._stats.turned_away += 1
            log.warning("MODBUS-TCP: %d connections are open, which is the limit (modbus_tcp.connections)",
                        len(self.connections))  # fmt: skip
            return False
        self.connections.add(connection)
        self._stats.accepted += 1
        self._stats.connections = len(self.connections)
        return True

    def forget(self, connection: Connection) -> None:
        """Take note that a connection is gone."""
        self.connections.discard(connection)
        self._stats.connections = len(self.connections)

    async def _watch_connections(self) -> None:
        """Close who says nothing for too long or does not read what it asked for."""
        while True:
            await asyncio.sleep(min(1.0, self._section.idle_timeout / 4))
            now = self._clock.now()
            for connection in list(self.connections):
                connection.check(now, self._section.idle_timeout)

    def _identify(self, pdu: bytes, unit: int) -> bytes | int:
        """Answer function 43/14 with the drive's identification, or with the gateway's own."""
        request = ReadDeviceInformationRequest()
        if len(pdu) != 4 or pdu[1] != 0x0E:
            return ILLEGAL_VALUE
        request.decode(pdu[1:])
        objects = dict(GATEWAY_OBJECTS)
        if unit != GATEWAY_UNIT:
            told = self._image.by_unit[unit].identity
            objects = {i: told[key].encode() for i, key in enumerate(("vendor", "device", "version")) if key in told}
            if not objects:
                return TARGET_FAILED
        if request.read_code not in READ_CODES:
            return ILLEGAL_VALUE
        if request.read_code == DeviceInformation.SPECIFIC:
            if request.object_id not in objects:
                return ILLEGAL_ADDRESS
            objects = {request.object_id: objects[request.object_id]}
        elif request.object_id in objects:  # an object that does not exist: begin anew (MODBUS 6.21)
            objects = {number: text for number, text in objects.items() if number >= request.object_id}
        response = ReadDeviceInformationResponse(DeviceInformation(request.read_code), objects)
        return bytes((0x2B,)) + response.encode()


class Connection(asyncio.Protocol):
    """One client: any split and merge of its requests, answered in order, each with its own transaction id."""

    def __init__(self, server: ModbusTcpServer, answerer: Answerer, stats: TcpStats, clock: Clock) -> None:
        self._server = server
        self._answer = answerer.answer
        self._stats = stats
        self._clock = clock
        self._transport: asyncio.Transport | None = None
        self._buffer = b""
        self._heard_at = clock.now()
        self._stuck_since: float | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take a connection in, or close it where there are enough."""
        if not isinstance(transport, asyncio.Transport):
            raise TypeError("a stream transport is wanted")
        if not self._server.admit(self):
            transport.abort()
            return
        self._transport = transport
        transport.set_write_buffer_limits(high=WRITE_CAP)
        connection = transport.get_extra_info("socket")
        if connection is not None:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

    def connection_lost(self, error: Exception | None) -> None:
        """Forget a connection that has ended."""
        self._transport = None
        self._server.forget(self)

    def data_received(self, data: bytes) -> None:
        """Answer every whole request in one write; close the connection where the stream is out of step."""
        transport = self._transport
        if transport is None:
            return
        self._heard_at = self._clock.now()
        buffer = self._buffer + data if self._buffer else data
        answers: list[bytes] = []
        start, size = 0, len(buffer)
        while size - start >= MBAP.size:
            transaction, protocol, length, unit = MBAP.unpack_from(buffer, start)
            if protocol != 0 or not 2 <= length <= LONGEST:
                self._stats.exceptions[0] += 1
                if answers:
                    transport.write(b"".join(answers))
                transport.close()
                self._transport = None
                return
            end = start + 6 + length
            if end > size:
                break
            pdu = self._answer(unit, buffer[start + 7 : end])
            answers.append(MBAP.pack(transaction, 0, len(pdu) + 1, unit))
            answers.append(pdu)
            start = end
        self._buffer = buffer[start:] if start else buffer
        if answers:
            transport.write(b"".join(answers))

    def pause_writing(self) -> None:
        """Read nothing more from a client that does not take its answers."""
        self._stuck_since = self._clock.now()
        if self._transport is not None:
            self._transport.pause_reading()

    def resume_writing(self) -> None:
        """Go on with a client that has taken them."""
        self._stuck_since = None
        if self._transport is not None:
            self._transport.resume_reading()

    def check(self, now: float, idle_timeout: float) -> None:
        """End a connection that is stuck, or that has been idle for too long."""
        if self._stuck_since is not None and now - self._stuck_since > SLOW_READER:
            self.abort()
        elif now - self._heard_at > idle_timeout and self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """End at once."""
        if self._transport is not None:
            self._transport.abort()
