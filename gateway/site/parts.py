"""What a site is made of: lines, their drives, and what is read of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gateway.config import Config, DriveSection, server_address
from gateway.drives.catalogue import Catalogue
from gateway.drives.model import Model
from gateway.drives.register import Derived, Register
from gateway.protocol.codec import Codec
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.timing import LineTiming


@dataclass(frozen=True, slots=True)
class PollGroup:
    """Registers of one drive that are read every `period` seconds (0: as fast as the line allows)."""

    registers: tuple[Register, ...]
    period: float
    max_age: float


@dataclass(frozen=True, slots=True)
class Point:
    """A value of one drive: its register and the age in seconds past which it is stale."""

    register: Register
    max_age: float


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive as configured. `points` holds every polled register once, by name, in the order asked.

    `bases` are registers that derived values need; they are read when the drive is identified.
    """

    name: str
    line: str
    number: int
    unit: int
    model: Model
    protocol: str
    wait_time: float
    groups: tuple[PollGroup, ...]
    points: Mapping[str, Point]
    derived: tuple[Derived, ...]
    deadband: Mapping[str, float]
    provision: bool = False
    block_write: bool = False
    section: DriveSection | None = field(default=None, repr=False)

    @property
    def is_controlled(self) -> bool:
        """Say whether somebody may command it."""
        return self.section is not None and self.section.control != "off"

    def is_commanded_by(self, way: str) -> bool:
        """Say whether somebody may command it by that way in."""
        return self.is_controlled and self.section is not None and way in self.section.sources

    @property
    def codec(self) -> Codec:
        """Return the codec of the protocol that the drive speaks."""
        return PROTOCOLS[self.protocol]

    @property
    def bases(self) -> tuple[Register, ...]:
        """Return the registers that derived values are computed from, each once."""
        return tuple(self.model.registers[name] for name in dict.fromkeys(d.base for d in self.derived))


@dataclass(frozen=True, slots=True)
class DriveGroup:
    """Drives of one line, by name, that are written to together."""

    name: str
    drives: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Line:
    """One RS485 line as configured; times in seconds."""

    name: str
    port: str
    baud: int
    parity: str
    margin: float
    silent_share: float
    probe_every: float
    probe_at_most: float
    drives: tuple[Drive, ...]
    groups: tuple[DriveGroup, ...] = ()
    rs485: str = "auto"
    rts_on_send: bool = True
    rts_delay_before: float = 0.0
    rts_delay_after: float = 0.0
    local_echo: str = "auto"

    @property
    def timing(self) -> LineTiming:
        """Return the arithmetic of this line."""
        return LineTiming(self.baud)

    @property
    def is_network(self) -> bool:
        """Say whether the port is a serial server on the network."""
        return server_address(self.port) is not None


@dataclass(frozen=True, slots=True)
class Site:
    """All that one gateway serves: its configuration, the folder that it is in, and its lines with their drives."""

    config: Config
    lines: tuple[Line, ...]
    catalogue: Catalogue = field(repr=False)
    folder: Path = Path()

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Return every drive, in the order of the file."""
        return tuple(drive for line in self.lines for drive in line.drives)
