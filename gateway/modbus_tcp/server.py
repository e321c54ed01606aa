"""Listens for MODBUS-TCP clients, cuts those whose time is over, and identifies drives and gateway by pymodbus."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping

from pymodbus.constants import DeviceInformation
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest, ReadDeviceInformationResponse

from gateway import __version__
from gateway.clock import Clock
from gateway.config import ModbusTcpSection, address
from gateway.control.door import Door
from gateway.image import Image
from gateway.metrics import Stats
from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.connection import Connection, Places
from gateway.modbus_tcp.gateway_unit import UNIT, GatewayUnit
from gateway.modbus_tcp.mirror_unit import MirrorUnit
from gateway.modbus_tcp.read_back import CommandedUnit
from gateway.modbus_tcp.responder import Responder, Unit
from gateway.modbus_tcp.session import Writer
from gateway.modbus_tcp.sockets import Listener, listen
from gateway.modbus_tcp.user_map import user_maps
from gateway.modbus_tcp.writing import DriveWriter
from gateway.ports import explain_bind_error

log = logging.getLogger("gateway.modbus_tcp")

KEY = "modbus_tcp.listen"
SWEEP_EVERY = 0.5  # seconds between two looks for connections whose time is over
BACKLOG = 128
REQUEST_SIZE = 4  # bytes: function, MEI type, read code, object
OBJECTS = {0: "vendor", 1: "device", 2: "version"}  # the basic ones of MODBUS Application Protocol V1.1b3, 6.21
LONGEST_OBJECT = 64  # bytes; three of them fit an answer
BASIC_AND_INDIVIDUAL = 0x81  # conformity level: the basic objects, as a stream or one by one
IDENTITY = {"vendor": "tosvert-gateway", "device": "tosvert-gateway", "version": __version__}


class ModbusTcpServer:
    """The server of one image. `start` raises GatewayError with the key to change where it cannot listen."""

    def __init__(
        self,
        section: ModbusTcpSection,
        image: Image,
        stats: Stats,
        clock: Clock,
        identity: Mapping[str, str] = IDENTITY,
        door: Door | None = None,
    ) -> None:
        self._section = section
        self._clock = clock
        self._places = Places(section.connections, stats.tcp)
        maps = user_maps(section, image, identity)
        gateway_unit = GatewayUnit(image, stats, identity, clock.now(), maps.get(UNIT))
        units: dict[int, Unit] = {**image.by_unit, **maps, UNIT: gateway_unit}
        self._writers: dict[int, Writer] = {}
        if door is not None and door.controls:
            self._open(door, image, gateway_unit, units)
        self._responder = Responder(units, identify, stats.tcp)
        self._server: Listener | asyncio.Server | None = None
        self._next_sweep: asyncio.TimerHandle | None = None

    def _open(self, door: Door, image: Image, gateway_unit: GatewayUnit, units: dict[int, Unit]) -> None:
        """Let the drives be commanded that may be."""
        for drive in image.drives:
            if drive.drive.name in door.controls and drive.drive.unit:
                commanded = CommandedUnit(drive, door)
                units[drive.drive.unit] = commanded
                self._writers[drive.drive.unit] = DriveWriter(drive.drive.name, door, commanded)
        mirror = MirrorUnit(image, door, gateway_unit)
        units[UNIT] = mirror
        self._writers[UNIT] = mirror

    async def start(self) -> None:
        """Listen, and serve from now on."""
        host, port = address(self._section.listen)
        try:
            self._server = await listen(self._connection, host, port, BACKLOG)
        except OSError as error:
            raise explain_bind_error(error, host, port, KEY) from error
        self._sweep_again()
        log.info("MODBUS-TCP on %s port %d, %d connections at most", host, self.port, self._section.connections)

    @property
    def port(self) -> int:
        """Return the port that is listened on."""
        if self._server is None:
            raise RuntimeError("the server has not been started")
        return int(self._server.sockets[0].getsockname()[1])

    def _connection(self) -> Connection:
        return Connection(self._responder, self._clock, self._places, self._writers)

    def _sweep_again(self) -> None:
        self.sweep()
        self._next_sweep = asyncio.get_running_loop().call_later(SWEEP_EVERY, self._sweep_again)

    def sweep(self) -> None:
        """Cut the connections whose time is over."""
        now = self._clock.now()
        for connection in tuple(self._places.taken):
            reason = connection.overdue(now, self._section.idle_timeout)
            if reason is not None:
                connection.cut(reason)

    async def stop(self) -> None:
        """Stop listening and cut every connection."""
        if self._next_sweep is not None:
            self._next_sweep.cancel()
        if self._server is None:
            return
        self._server.close()
        for connection in tuple(self._places.taken):
            connection.cut("the gateway ends")
        await self._places.all_free.wait()
        await self._server.wait_closed()
        self._server = None


def identify(pdu: bytes, identity: Mapping[str, str]) -> bytes | ExceptionCode:
    """Answer a request PDU of function 43, MEI type 14, from vendor, device and version."""
    if pdu[1:2] != bytes([ReadDeviceInformationRequest.sub_function_code]):
        return ExceptionCode.ILLEGAL_FUNCTION
    if len(pdu) != REQUEST_SIZE:
        return ExceptionCode.ILLEGAL_DATA_VALUE
    request = ReadDeviceInformationRequest()
    request.decode(pdu[1:])
    if not DeviceInformation.BASIC <= request.read_code <= DeviceInformation.SPECIFIC:
        return ExceptionCode.ILLEGAL_DATA_VALUE
    told = {number: identity[key] for number, key in OBJECTS.items() if key in identity}
    if not told:
        return ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND
    is_known = request.object_id in told
    if request.read_code == DeviceInformation.SPECIFIC and not is_known:
        return ExceptionCode.ILLEGAL_DATA_ADDRESS
    if request.read_code == DeviceInformation.SPECIFIC:
        told = {request.object_id: told[request.object_id]}
    elif is_known:  # a stream goes on from the object asked for; an unknown one stands for the first
        told = {number: text for number, text in told.items() if number >= request.object_id}
    objects = {number: text.encode("ascii", "replace")[:LONGEST_OBJECT] for number, text in told.items()}
    answer = ReadDeviceInformationResponse(request.read_code, objects)
    answer.conformity = BASIC_AND_INDIVIDUAL
    return bytes([ReadDeviceInformationResponse.function_code]) + answer.encode()
