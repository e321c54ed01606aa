"""Serves MODBUS-TCP clients, cuts those whose time is over, and identifies drives and gateway by pymodbus."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from pymodbus.constants import DeviceInformation
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest, ReadDeviceInformationResponse

from gateway import __version__
from gateway.clock import Clock
from gateway.config import ModbusTcpSection
from gateway.control.door import Door
from gateway.errors import GatewayError
from gateway.image import Image
from gateway.metrics import Stats
from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.connection import Connection
from gateway.modbus_tcp.gateway_unit import UNIT, GatewayUnit
from gateway.modbus_tcp.guard import Ward, drive_ward, mirror_ward
from gateway.modbus_tcp.listeners import TcpListener, listeners
from gateway.modbus_tcp.mirror_unit import MirrorUnit
from gateway.modbus_tcp.places import Places, limits_of
from gateway.modbus_tcp.read_back import CommandedUnit
from gateway.modbus_tcp.reception import Reception
from gateway.modbus_tcp.responder import Unit
from gateway.modbus_tcp.rights import Grants
from gateway.modbus_tcp.user_map import user_maps
from gateway.modbus_tcp.writing import DriveWriter

SWEEP_EVERY = 0.5  # seconds between two looks for connections whose time is over
REQUEST_SIZE = 4  # bytes: function, MEI type, read code, object
OBJECTS = {0: "vendor", 1: "device", 2: "version"}  # the basic ones of MODBUS Application Protocol V1.1b3, 6.21
LONGEST_OBJECT = 64  # bytes; three of them fit an answer
BASIC_AND_INDIVIDUAL = 0x81  # conformity level: the basic objects, as a stream or one by one
MAKER = "TOSHIBA"  # as these drives answer by 2BH (E6581657, 5.1.7)
IDENTITY = {"vendor": "tosvert-gateway", "device": "tosvert-gateway", "version": __version__}


class ModbusTcpServer:
    """The server of one image. `start` raises GatewayError with the key to change where it cannot listen.

    BadConfig says which certificate cannot be read.
    """

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
        self._places = Places(limits_of(section), stats.tcp)
        maps = user_maps(section, image, identity)
        gateway_unit = GatewayUnit(image, stats, identity, clock.now(), maps.get(UNIT))
        units: dict[int, Unit] = {**image.by_unit, **maps, UNIT: gateway_unit}
        wards: dict[int, Ward] = {}
        if door is not None and door.controls:
            wards = _open(door, image, gateway_unit, units)
        self._reception = Reception(units, identify, stats.tcp, wards, Grants(section), door)
        self._listeners = listeners(section, self._connection, self._reception, clock, self._places, stats.tcp)
        self._next_sweep: asyncio.TimerHandle | None = None

    async def start(self) -> None:
        """Listen, and serve from now on."""
        try:
            for listener in self._listeners:
                await listener.start()
        except GatewayError:
            await self.stop()
            raise
        self._sweep_again()

    @property
    def port(self) -> int:
        """Return the port that is listened on; that of the first listener where there are several."""
        return self._listeners[0].port

    def port_of(self, kind: type[TcpListener]) -> int:
        """Return the port of a kind of listener."""
        return next(listener.port for listener in self._listeners if isinstance(listener, kind))

    def _connection(self, kind: type[Connection] = Connection) -> Connection:
        """Return what serves a client without TLS, by the rights of its address where addresses differ in them."""
        reception = self._reception
        serve = None if reception.is_open else reception.plain
        return kind(reception.free, self._clock, self._places, reception.free_writers, serve=serve)

    def renew(self) -> None:
        """Read certificates anew where their files have changed."""
        for listener in self._listeners:
            listener.renew()

    def _sweep_again(self) -> None:
        self.sweep()
        self._next_sweep = asyncio.get_running_loop().call_later(SWEEP_EVERY, self._sweep_again)

    def sweep(self) -> None:
        """Cut the connections whose time is over."""
        now = self._clock.now()
        for listener in self._listeners:
            listener.pulse(now)
        for connection in tuple(self._places.taken):
            reason = connection.overdue(now, self._section.idle_timeout)
            if reason is not None:
                connection.cut(reason)

    async def stop(self) -> None:
        """Stop listening and cut every connection."""
        if self._next_sweep is not None:
            self._next_sweep.cancel()
        for listener in self._listeners:
            listener.close()
        for connection in tuple(self._places.taken):
            connection.cut("the gateway ends")
        await self._places.all_free.wait()
        for listener in self._listeners:
            await listener.wait_closed()


def _open(door: Door, image: Image, gateway_unit: GatewayUnit, units: dict[int, Unit]) -> dict[int, Ward]:
    """Let the drives be commanded that may be; return who carries out the writes, by unit."""
    wards: dict[int, Ward] = {}
    for drive in image.drives:
        name, unit = drive.drive.name, drive.drive.unit
        if name in door.controls and unit:
            commanded = CommandedUnit(drive, door)
            units[unit] = commanded
            wards[unit] = drive_ward(unit, DriveWriter(name, door, commanded), name, door)
    mirror = MirrorUnit(image, door, gateway_unit)
    units[UNIT] = mirror
    wards[UNIT] = mirror_ward(UNIT, mirror, tuple(image.by_name), door)
    return wards


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
    known = _known(identity)
    told = {number: known[key] for number, key in OBJECTS.items() if key in known}
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


def _known(identity: Mapping[str, str]) -> Mapping[str, str]:
    """Return what is told: of a drive that has no 2BH, as in the TOSHIBA protocols, its type form and CPU version."""
    read = {"device": identity.get("type_form", ""), "version": identity.get("cpu_version", "")}
    found = {key: text for key, text in read.items() if text}
    return {"vendor": MAKER, **found, **identity} if found else identity
