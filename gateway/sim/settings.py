"""The file that describes a simulated line, and how the line comes of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, Literal, get_args

from pydantic import Field, ValidationError, model_validator

from gateway import config
from gateway.config import Section, seconds
from gateway.drives import catalogue
from gateway.drives.model import Model
from gateway.errors import BadConfig
from gateway.protocol.timing import LineTiming
from gateway.sim.doing import OfRegister, known
from gateway.sim.doings import Renumber
from gateway.sim.drive import SimulatedDrive
from gateway.sim.drive_section import LineDefaults, Protocol, SimulatedDriveSection, make
from gateway.sim.fault_section import FaultSection
from gateway.sim.faults import Faults
from gateway.sim.installation import Adapter, Installation, WrongRequest
from gateway.sim.quantities import Span, problems
from gateway.sim.scenario import EventSection, Scenario
from gateway.sim.wire import Delivery, Wire

Baud = Literal[9600, 19200, 38400]
LARGEST_NUMBERS = {"modbus-rtu": 247, "toshiba": 99}  # F802 that a master can address (E6581657 6.2)


class SimulatedLineConfig(Section):
    """The whole file."""

    baud: Baud = 19200
    parity: Literal["even", "odd", "none"] = "even"
    checks_baud: bool = Field(False, description="a master at another rate is not understood")
    protocol: Protocol = Field("modbus-rtu", description="of the drives that have no own")
    seed: int = 1
    processing_time: Span = Field(
        seconds("5ms"), ge=0, le=2, description="from a frame's end to the answer; up to 15 ms on VF-nC3"
    )
    eeprom_time: Span | None = Field(
        None, ge=0, le=2, description="the same for a write to the EEPROM; the model's longest by default"
    )
    delivery: Delivery = Field(Delivery.FRAME, strict=False, description="answers whole, or by characters")
    trace: bool = Field(False, description="`simulate` tells every frame")
    link: str | None = Field(None, description="a symbolic link to the port, kept while the line runs")
    catalogue: list[str] = Field([], description="further catalogue files, relative to this file")
    drive: list[SimulatedDriveSection] = Field(min_length=1)
    fault: list[FaultSection] = Field([], description="faults of the whole line")
    event: list[EventSection] = Field([], description="the scenario: what is done to the line when")

    @model_validator(mode="after")
    def _names_its_drives(self) -> SimulatedLineConfig:
        names = [drive.name for drive in self.drive if drive.name is not None]
        if doubled := [name for name, count in Counter(names).items() if count > 1]:
            raise ValueError(f"the name of one drive only: {', '.join(doubled)}")
        numbers = [drive.number for drive in self.drive]
        later = [event.doing.number for event in self.event if isinstance(event.doing, Renumber)]
        for place, event in enumerate(self.event):
            key = getattr(event.doing, "drive", None)
            if key is not None and key not in (*names, *numbers, *later):
                known = ", ".join(map(str, [*numbers, *names]))
                raise ValueError(f"event[{place}].drive: no drive {key}; on the line: {known}")
        return self


def load(path: Path) -> SimulatedLineConfig:
    """Read the file of a simulated line; BadConfig lists all that is wrong with it."""
    table = config.read(path)
    read = _validated(table, str(path))
    return read.model_copy(update={"catalogue": [str(path.parent / name) for name in read.catalogue]})


def from_options(drives: Sequence[str], *, baud: int = 19200, parity: str = "even") -> SimulatedLineConfig:
    """Make a line of drives, each "NUMBER:MODEL" or "NUMBER:MODEL:PROTOCOL"; BadConfig says what would be right."""
    if baud not in get_args(Baud):
        raise BadConfig(f"--baud {baud}: give one of {', '.join(map(str, get_args(Baud)))}")
    sections = [_drive_option(drive) for drive in drives]
    return _validated({"baud": baud, "parity": parity, "drive": sections}, "simulate")


def _drive_option(option: str) -> dict[str, object]:
    number, *others = option.split(":")
    if not number.isdecimal() or len(others) not in (1, 2) or not all(others):
        raise BadConfig(f"--drive {option}: give NUMBER:MODEL[:PROTOCOL], such as 1:vf-nc3 or 2:vf-nc3:toshiba")
    if others[1:] and others[1] not in get_args(Protocol):
        raise BadConfig(f"--drive {option}: no protocol {others[1]!r}; known: {', '.join(get_args(Protocol))}")
    return {"number": int(number), **dict(zip(("model", "protocol"), others, strict=False))}


def _validated(table: Mapping[str, Any], name: str) -> SimulatedLineConfig:
    try:
        return SimulatedLineConfig.model_validate(table)
    except ValidationError as error:
        raise BadConfig("\n".join(f"{name}: {problem}" for problem in problems(error))) from error


def notes(line: SimulatedLineConfig) -> Iterator[str]:
    """Say what can be simulated, and is seldom meant."""
    for number, count in Counter(drive.number for drive in line.drive).items():
        if count > 1:
            yield f"{number} is the number of more than one drive: their answers collide"
    for drive in line.drive:
        protocol = drive.protocol or line.protocol
        if protocol == "modbus-rtu" and drive.number == 0:
            yield "drive 0 speaks MODBUS-RTU, where 0 is for all: it obeys, and answers nothing"
        if drive.number > LARGEST_NUMBERS[protocol]:
            yield f"drive {drive.number} speaks TOSHIBA, where numbers end at 99 (ASCII) and 63 (binary)"


def build(line: SimulatedLineConfig, now: float = 0.0) -> Wire:
    """Make a line in memory, with its drives and its scenario; BadConfig says what the catalogue does not have."""
    return install(line, now).wire


def install(line: SimulatedLineConfig, now: float, port: Adapter | None = None) -> Installation:
    """Make a line with its drives and its scenario, behind a port; BadConfig as for `build`."""
    drives = _drives(line, now)
    of_drives = [(drive, fault) for drive, own in zip(drives, line.drive, strict=True) for fault in own.fault]
    of_line: list[tuple[SimulatedDrive | None, FaultSection]] = [(None, fault) for fault in line.fault]
    faults = [section.fault(drive, now) for drive, section in [*of_line, *of_drives]]
    wire = Wire(
        LineTiming(line.baud),
        drives,
        Faults(_chance(line.seed, "faults"), faults),
        parity=line.parity,
        delivery=line.delivery,
    )
    names = {own.name: drive for drive, own in zip(drives, line.drive, strict=True) if own.name is not None}
    installation = Installation(wire, now, names, port)
    if line.event:
        _check_registers(line, installation)
        wire.script = Scenario(line.event, installation, lambda purpose: _chance(line.seed, purpose))
    return installation


def _check_registers(line: SimulatedLineConfig, installation: Installation) -> None:
    """Raise BadConfig where an event names a register that its drive, as it is numbered now, does not have."""
    wrong = []
    for place, event in enumerate(line.event):
        drive = installation.find(event.doing.drive) if isinstance(event.doing, OfRegister) else None
        if isinstance(event.doing, OfRegister) and drive is not None:
            try:
                known(drive, event.doing.register_)
            except WrongRequest as error:
                wrong.append(f"event[{place}].register: {error}")
    if wrong:
        raise BadConfig("\n".join(wrong))


def _drives(line: SimulatedLineConfig, now: float) -> list[SimulatedDrive]:
    """Make the drives, and look at each of them before BadConfig names all that is wrong."""
    models = _models(tuple(line.catalogue))
    defaults = LineDefaults(line.baud, line.parity, line.protocol, line.processing_time, line.eeprom_time)
    drives, wrong = [], []
    for place, section in enumerate(line.drive):
        try:
            drives.append(make(section, defaults, models, _chance(line.seed, f"drive {place}"), now))
        except BadConfig as error:
            wrong.append(f"drive[{place}]: {error}")
    if wrong:
        raise BadConfig("\n".join(wrong))
    return drives


@cache
def _models(files: tuple[str, ...]) -> Mapping[str, Model]:
    return catalogue.load(Path(name) for name in files)


def _chance(seed: int, purpose: str) -> Random:
    """Return a source of chance of its own for each purpose, so that one does not shift another."""
    return Random(f"{seed} {purpose}")  # noqa: S311  (reproducible noise, not a secret)
