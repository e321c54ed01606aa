"""Small drives for the MQTT tests: a number, a bit field, a code, a derived value."""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal

from gateway.drives.model import Model
from gateway.drives.register import Derived, Enumeration, Kind, Register
from gateway.drives.scaling import Scaling
from gateway.image import DriveImage, Image, LinkState
from gateway.site import Drive, Point, PollGroup

FREQUENCY, TORQUE, STATUS, TRIP, COMMAND, CURRENT = 0xFD00, 0xFD18, 0xFD01, 0xFC90, 0xFA00, 0xFD03
MAX_AGE = 1.0
LONG = 3600.0  # a max_age that no test outlives by chance
WALL = 1_772_366_400.25  # 2026-03-01T12:00:00.250Z

TRIPS = Enumeration("trips", {0: "", 1: "OC1"}, {0: "no trip", 1: "overcurrent during acceleration"})

REGISTERS = (
    Register("output_frequency", FREQUENCY, Kind.MONITOR, "7.2", unit="Hz", scaling=Scaling(Decimal("0.01"))),
    Register("torque", TORQUE, Kind.MONITOR, "7.2", unit="%", scaling=Scaling(Decimal("0.01"), signed=True)),
    Register("status", STATUS, Kind.STATUS, "7.2", mask=0x0007, bits={0: "running", 1: "reverse", 2: "tripped"}),
    Register("trip_code", TRIP, Kind.STATUS, "7.2", enumeration=TRIPS),
    Register("command", COMMAND, Kind.COMMAND, "7.1", is_writable=True),
    Register("output_current_rate", CURRENT, Kind.MONITOR, "7.2", unit="%", scaling=Scaling(Decimal("0.01"))),
)
CURRENT_IN_AMPERES = Derived("output_current", of="output_current_rate", base="rated_current", unit="A")
MODEL = Model("test", "a drive for tests", "none", {register.name: register for register in REGISTERS})


def drive(name: str = "pump-1", deadband: Mapping[str, float] | None = None, max_age: float = MAX_AGE) -> Drive:
    """Return a drive with every value of the model."""
    return Drive(
        name=name,
        line="a",
        number=1,
        unit=1,
        model=MODEL,
        protocol="modbus-rtu",
        wait_time=0.0,
        groups=(PollGroup(REGISTERS, 0.1, max_age),),
        points={register.name: Point(register, max_age) for register in REGISTERS},
        derived=(CURRENT_IN_AMPERES,),
        deadband=deadband or {},
    )


def image(*drives: Drive) -> Image:
    """Return an image whose drives are online and have never been read; one drive by default."""
    made = Image(drives or (drive(),))
    for each in made.drives:
        each.bases["rated_current"] = Decimal("12.5")
        each.set_link(LinkState.ONLINE)
    return made


def read(target: DriveImage, now: float, **words: int) -> None:
    """Apply an answer with these words, by value name, read `now`."""
    target.apply([(MODEL.registers[name].address, word) for name, word in words.items()], now, WALL + now)
