"""Drives, an image, requests and a transport in memory for the tests of the MODBUS-TCP server."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal

from gateway.clock import Alarm
from gateway.control.command import Source
from gateway.drives.model import Model
from gateway.drives.register import Enumeration, Kind, Register
from gateway.drives.scaling import Scaling
from gateway.image import DriveImage, Image, LinkState
from gateway.metrics import LineStats, Stats
from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.connection import Connection
from gateway.modbus_tcp.gateway_unit import UNIT, GatewayUnit
from gateway.modbus_tcp.places import Places
from gateway.modbus_tcp.responder import Responder, Unit
from gateway.modbus_tcp.server import IDENTITY, identify
from gateway.modbus_tcp.session import Reply, Writer
from gateway.site import Drive, Point

NOW = 1000.0  # monotonic seconds
MAX_AGE = 1.0
TOLD = {"vendor": "TOSHIBA", "device": "VFNC3-2007P", "version": "0102"}


async def until(condition: Callable[[], bool]) -> None:
    """Let the loop run until something holds; the caller's time limit ends a vain wait."""
    while not condition():
        await asyncio.sleep(0)


@dataclass
class StandingClock:
    """A clock that moves when a test moves it."""

    moment: float = NOW

    def now(self) -> float:
        """Return monotonic seconds."""
        return self.moment

    def wall(self) -> float:
        """Return UTC seconds."""
        return 1_700_000_000.0 + self.moment

    def alarm(self) -> Alarm:
        """Nobody waits here."""
        raise NotImplementedError


def registers() -> dict[str, Register]:
    """Return a run FD00H to FD03H, two single numbers, and one that no drive here polls."""
    hundredths = Scaling(Decimal("0.01"))
    trips = Enumeration("trip_code", {0: "none", 1: "oc1"}, {code: f"trip {code}" for code in range(10)})
    made = (
        Register("output_frequency", 0xFD00, Kind.MONITOR, "test", "Output frequency", "Hz", hundredths),
        Register("status", 0xFD01, Kind.STATUS, "test", "Status", mask=0x0007, bits={0: "failure", 1: "tripped"}),
        Register("frequency_command_value", 0xFD02, Kind.MONITOR, "test", unit="Hz", scaling=hundredths),
        Register("output_current", 0xFD03, Kind.MONITOR, "test", unit="%", scaling=hundredths),
        Register("torque", 0xFD18, Kind.MONITOR, "test", "Torque | shaft", "%", Scaling(Decimal("0.01"), True)),
        Register("trip_code", 0xFC90, Kind.STATUS, "test", "Trip code", enumeration=trips),
        Register("last", 0xFFFF, Kind.MONITOR, "test", "the last number"),
        Register("output_power", 0xFD30, Kind.MONITOR, "test", unit="kW", scaling=hundredths),
    )
    return {register.name: register for register in made}


POLLED = ("output_frequency", "status", "frequency_command_value", "output_current", "torque", "trip_code", "last")


def drive(
    name: str = "pump-1",
    unit: int = 1,
    polled: Iterable[str] = POLLED,
    max_ages: Mapping[str, float] | None = None,
    line: str = "a",
) -> Drive:
    """Make a drive that polls these values."""
    known = registers()
    ages = max_ages or {}
    return Drive(
        name=name,
        line=line,
        number=unit,
        unit=unit,
        model=Model("test", "Test drive", "test", known),
        protocol="modbus-rtu",
        wait_time=0.0,
        groups=(),
        points={value: Point(known[value], ages.get(value, MAX_AGE)) for value in polled},
        derived=(),
        deadband={},
    )


def answer(image: DriveImage, now: float = NOW, **words: int) -> None:
    """Bring the image these values, as an answer of the drive would."""
    pairs = [(image.points[name].register.address, word) for name, word in words.items()]
    image.apply(pairs, now, 1_700_000_000.0 + now)


ALL = {
    "output_frequency": 6000,
    "status": 3,
    "frequency_command_value": 5000,
    "output_current": 0x1234,
    "torque": 0xFFFF,
    "trip_code": 1,
    "last": 0xBEEF,
}


def fresh_image() -> Image:
    """Return unit 1 with all values, 2 silent, 3 on a line that is down, 4 never read but connected."""
    image = Image([drive(f"pump-{unit}", unit) for unit in (1, 2, 3, 4)])
    for unit in (1, 2, 3):
        image.by_unit[unit].set_link(LinkState.ONLINE)
        answer(image.by_unit[unit], **ALL)
        image.by_unit[unit].identity = TOLD
    image.by_unit[2].set_link(LinkState.OFFLINE, "no answer")
    image.by_unit[3].set_link(LinkState.LINE_DOWN, "unplugged")
    image.by_unit[4].set_link(LinkState.ONLINE)
    return image


def read(transaction: int, unit: int, start: int, count: int, function: int = 3) -> bytes:
    """Make a request to read registers."""
    return struct.pack(">HHHBBHH", transaction, 0, 6, unit, function, start, count)


def request(transaction: int, unit: int, pdu: bytes) -> bytes:
    """Make any request."""
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu


def answers(stream: bytes) -> list[tuple[int, int, bytes]]:
    """Take a stream of answers apart: transaction, unit, PDU; AssertionError when it is not exact."""
    found = []
    while stream:
        transaction, protocol, length, unit = struct.unpack_from(">HHHB", stream)
        assert protocol == 0
        assert 3 <= length <= 254
        assert len(stream) >= 6 + length
        found.append((transaction, unit, stream[7 : 6 + length]))
        stream = stream[6 + length :]
    return found


class Wire(asyncio.Transport):
    """The transport of a connection under test; while `is_read` is False the client takes nothing."""

    def __init__(self, peer: str = "10.0.0.7") -> None:
        super().__init__({"peername": (peer, 50_000)})
        self.writes: list[bytes] = []
        self.is_read = True
        self.is_closed = False
        self.is_cut = False
        self.is_reading_paused = False
        self.waiting = 0
        self._high = 0
        self.connection: Connection

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Take what the server sends."""
        assert not self.is_closed
        self.writes.append(bytes(data))
        if not self.is_read:
            was, self.waiting = self.waiting, self.waiting + len(data)
            if was <= self._high < self.waiting:
                self.connection.pause_writing()

    def fetch(self) -> None:
        """Let the client read all that waits."""
        self.is_read, self.waiting = True, 0
        self.connection.resume_writing()

    @property
    def sent(self) -> bytes:
        """Return all that the server has sent."""
        return b"".join(self.writes)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Take the limit."""
        self._high = high or 0

    def pause_reading(self) -> None:
        """Read no more."""
        self.is_reading_paused = True

    def resume_reading(self) -> None:
        """Read again."""
        self.is_reading_paused = False

    def is_reading(self) -> bool:
        """Say whether it reads."""
        return not self.is_reading_paused

    def close(self) -> None:
        """Close behind what is sent."""
        self.is_closed = True

    def abort(self) -> None:
        """Close at once."""
        self.is_closed = self.is_cut = True
        self.connection.connection_lost(None)

    def is_closing(self) -> bool:
        """Say whether it is closed."""
        return self.is_closed


REFUSED_AT_ONCE = 0xBAD0  # an address whose writes are answered 06 before they have begun


@dataclass
class Desk:
    """Takes writes, and answers them when a test lets it."""

    patience: float = 0.9
    pending: list[tuple[bytes, Reply]] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)
    begun: list[bytes] = field(default_factory=list)

    def write(self, pdu: bytes, source: Source, reply: Reply) -> float:
        """Keep the request; see `finish`."""
        self.begun.append(pdu)
        self.sources.append(source)
        if pdu[1:3] == struct.pack(">H", REFUSED_AT_ONCE):
            reply(ExceptionCode.SERVER_DEVICE_BUSY)
        else:
            self.pending.append((pdu, reply))
        return self.patience

    def finish(self, place: int = 0, code: ExceptionCode | None = None) -> None:
        """Answer one that is under way: 06H with its echo, or an exception."""
        pdu, reply = self.pending.pop(place)
        reply(pdu[:5] if code is None else code)


def write(transaction: int, unit: int, address: int, word: int) -> bytes:
    """Make a request to write one register."""
    return request(transaction, unit, struct.pack(">BHH", 6, address, word))


@dataclass
class Rig:
    """A responder over an image and connections without sockets."""

    image: Image = field(default_factory=fresh_image)
    clock: StandingClock = field(default_factory=StandingClock)
    limit: int = 32
    writers: dict[int, Writer] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.stats = Stats(self.clock.wall(), {"a": LineStats(is_up=True)})
        self.gateway_unit = GatewayUnit(self.image, self.stats, IDENTITY, self.clock.now())
        units: dict[int, Unit] = {**self.image.by_unit, UNIT: self.gateway_unit}
        self.responder = Responder(units, identify, self.stats.tcp)
        self.places = Places(self.limit, self.stats.tcp)

    def connect(self, peer: str = "10.0.0.7") -> Wire:
        """Open a connection."""
        return self.attach(Wire(peer))

    def attach(self, wire: Wire) -> Wire:
        """Open a connection over a transport of one's own."""
        wire.connection = Connection(self.responder, self.clock, self.places, self.writers)
        wire.connection.connection_made(wire)
        return wire

    def ask(self, unit: int, pdu: bytes) -> bytes:
        """Return the PDU that answers a PDU; AssertionError unless there is exactly one answer."""
        stream, used, _ = self.responder.respond(request(7, unit, pdu), 0, 16, self.clock.now())
        assert used == 7 + len(pdu)
        ((transaction, answering, told),) = answers(stream)
        assert (transaction, answering) == (7, unit)
        return told
