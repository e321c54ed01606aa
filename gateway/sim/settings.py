"""The file that describes a simulated line, and how drives on a wire come of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, PlainSerializer, ValidationError

from gateway import config
from gateway.config import Duration, Section, ValueName, seconds
from gateway.drives import catalogue
from gateway.drives.model import Model
from gateway.errors import BadConfig
from gateway.protocol.timing import LineTiming
from gateway.sim.condition import Limits
from gateway.sim.drive import BAUD_CODES, PARITY_CODES, SimulatedDrive
from gateway.sim.faults import Fault, Faults, Kind
from gateway.sim.options import DriveOptions
from gateway.sim.ratings import of_capacity
from gateway.sim.wire import Delivery, Wire

Span = Annotated[Duration, PlainSerializer(lambda value: f"{value:.9f}s", when_used="json")]
Baud = Literal[9600, 19200, 38400]
Number = Annotated[int, Field(ge=0, le=247)]
Hertz = Annotated[float, Field(ge=0, le=500)]
Word = Annotated[int, Field(ge=0, le=0xFFFF)]


class FaultSection(Section):
    """A fault; `value` is seconds, bytes or bits, as its kind wants."""

    kind: Kind = Field(strict=False)
    value: float | None = Field(None, ge=0)
    probability: float = Field(1.0, ge=0, le=1)
    count: int | None = Field(None, ge=1, description="how often it strikes; without end by default")
    after: Span = Field(0.0, ge=0, description="since the line was opened")
    until: Span | None = Field(None, gt=0)


class SimulatedDriveSection(Section):
    """One simulated drive."""

    number: Number = Field(description="inverter number F802")
    model: str = Field(description="a model of the catalogue")
    capacity: str | int | None = Field(None, description='type form ("VFnC3-2007P") or its FB05 code')
    running_at: Hertz = Field(0.0, description="started from the panel, in Hz")
    block_read: list[Word] = Field([], max_length=5, description="F875 to F879; 0 as shipped")
    block_write: list[Word] = Field([], max_length=2, description="F870 and F871; 0 as shipped")
    registers: dict[ValueName, Word] = Field({}, description="further words in its EEPROM, by name")
    processing_time: Span | None = Field(None, ge=0, le=2, description="the line's by default")
    direct_blocks: bool = Field(False, description="accept direct blocks for FAxx-FExx too")
    stable_bits: bool = Field(False, description="undefined bits read 0 instead of changing by chance")
    load: float = Field(0.6, ge=0, le=2, description="of rated torque at 60 Hz")
    maximum_frequency: Hertz = Field(80.0, gt=0, description="FH")
    jog_frequency: Hertz = 5.0
    preset_frequencies: list[Hertz] = Field([], max_length=15, description="preset speeds 1 to 15")
    version: int = Field(100, ge=0, le=9999, description="FE08, and what 2BH answers")
    fault: list[FaultSection] = Field([], description="faults of this drive")


class SimulatedLineConfig(Section):
    """The whole file."""

    baud: Baud = 19200
    parity: Literal["even", "odd", "none"] = "even"
    seed: int = 1
    processing_time: Span = Field(
        seconds("5ms"), ge=0, le=2, description="from a frame's end to the answer; up to 15 ms on VF-nC3"
    )
    eeprom_time: Span | None = Field(
        None, ge=0, le=2, description="the same for a write to the EEPROM; the model's longest by default"
    )
    delivery: Delivery = Field(Delivery.FRAME, strict=False, description="answers whole, or by characters")
    link: str | None = Field(None, description="a symbolic link to the port, kept while the line runs")
    catalogue: list[str] = Field([], description="further catalogue files, relative to this file")
    drive: list[SimulatedDriveSection] = Field(min_length=1)
    fault: list[FaultSection] = Field([], description="faults of the whole line")


def load(path: Path) -> SimulatedLineConfig:
    """Read the file of a simulated line; BadConfig lists all that is wrong with it."""
    table = config.read(path)
    read = _validated(table, str(path))
    return read.model_copy(update={"catalogue": [str(path.parent / name) for name in read.catalogue]})


def from_options(drives: Sequence[str], *, baud: int = 19200, parity: str = "even") -> SimulatedLineConfig:
    """Make a line of drives given as "NUMBER:MODEL"; BadConfig says what would be right."""
    sections = []
    for drive in drives:
        number, colon, model = drive.partition(":")
        if not colon or not number.isdigit():
            raise BadConfig(f"--drive {drive}: give NUMBER:MODEL, such as 1:vf-nc3")
        sections.append({"number": int(number), "model": model})
    if baud not in get_args(Baud):
        raise BadConfig(f"--baud {baud}: give one of {', '.join(map(str, get_args(Baud)))}")
    return _validated({"baud": baud, "parity": parity, "drive": sections}, "simulate")


def _validated(table: Mapping[str, Any], name: str) -> SimulatedLineConfig:
    try:
        return SimulatedLineConfig.model_validate(table)
    except ValidationError as error:
        problems = [_explain(item) for item in error.errors(include_url=False)]
        raise BadConfig("\n".join(f"{name}: {problem}" for problem in problems)) from error


def _explain(item: Mapping[str, Any]) -> str:
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in item["loc"]).lstrip(".")
    if item["type"] == "extra_forbidden":
        return f"{key}: unknown key"
    reason = item["msg"].removeprefix("Value error, ")
    return f"{key}: {reason} (given: {item['input']!r:.60})"


def build(line: SimulatedLineConfig, now: float = 0.0) -> Wire:
    """Make the drives and the wire of a line; BadConfig says what the catalogue does not have."""
    models = _models(tuple(line.catalogue))
    problems: list[str] = []
    drives = []
    for place, section in enumerate(line.drive):
        try:
            drives.append(_drive(line, section, models, place, now))
        except BadConfig as error:
            problems.append(f"drive[{place}]: {error}")
    if problems:
        raise BadConfig("\n".join(problems))
    faults = Faults(_chance(line.seed, "faults"), _faults(line, now))
    return Wire(LineTiming(line.baud), drives, faults, parity=line.parity, delivery=line.delivery)


@cache
def _models(files: tuple[str, ...]) -> catalogue.Catalogue:
    return catalogue.load(Path(name) for name in files)


def doubled_numbers(line: SimulatedLineConfig) -> list[int]:
    """Return the numbers that more than one drive has: allowed, for it can be simulated, but worth a word."""
    return [number for number, count in Counter(drive.number for drive in line.drive).items() if count > 1]


def _drive(
    line: SimulatedLineConfig, section: SimulatedDriveSection, models: Mapping[str, Model], place: int, now: float
) -> SimulatedDrive:
    model = models.get(section.model)
    if model is None:
        raise BadConfig(f"no model {section.model!r}; known: {', '.join(sorted(models))}")
    presets = {**_line_settings(line, model), **_selectors(section, model), **section.registers}
    if unknown := [name for name in presets if name not in model.registers]:
        raise BadConfig(f"{section.model} has no register {', '.join(unknown)}")
    try:
        of_capacity(model, section.capacity)
    except KeyError:
        known = ", ".join(f"{code}: {form}" for code, form in model.capacities.items())
        raise BadConfig(f"no capacity {section.capacity!r}; known: {known or 'none'}") from None
    own = section.processing_time
    options = DriveOptions(
        number=section.number,
        capacity=section.capacity,
        presets=presets,
        running_at=min(section.running_at, section.maximum_frequency),
        processing=line.processing_time if own is None else own,
        eeprom=line.eeprom_time,
        accepts_direct_blocks=section.direct_blocks,
        load=section.load,
        limits=Limits(section.maximum_frequency, section.jog_frequency, tuple(section.preset_frequencies)),
        version=section.version,
        stable_bits=section.stable_bits,
    )
    return SimulatedDrive(model, options, _chance(line.seed, f"drive {place}"), now)


def _line_settings(line: SimulatedLineConfig, model: Model) -> dict[str, int]:
    """Set the drive to the line's baud rate and parity, where the model has parameters for them."""
    connector = model.connector()
    roles = connector.parameters if connector else {}
    codes = {"baud_rate": BAUD_CODES[line.baud], "parity": PARITY_CODES[line.parity]}
    return {roles[role]: code for role, code in codes.items() if role in roles}


def _selectors(section: SimulatedDriveSection, model: Model) -> dict[str, int]:
    connector = model.connector()
    reads, writes = (connector.block_read, connector.block_write) if connector else ((), ())
    if len(section.block_read) > len(reads) or len(section.block_write) > len(writes):
        raise BadConfig(f"{model.name} has {len(reads)} selectors for block_read and {len(writes)} for block_write")
    selectors = [*zip(reads, section.block_read, strict=False), *zip(writes, section.block_write, strict=False)]
    known = {**dict.fromkeys(reads, model.read_selectors), **dict.fromkeys(writes, model.write_selectors)}
    if wrong := [f"{name} = {word}" for name, word in selectors if word not in known[name]]:
        raise BadConfig(f"no such selection: {', '.join(wrong)}")
    return dict(selectors)


def _faults(line: SimulatedLineConfig, now: float) -> list[Fault]:
    of_line: list[tuple[int | None, FaultSection]] = [(None, fault) for fault in line.fault]
    of_drives = [(drive.number, fault) for drive in line.drive for fault in drive.fault]
    return [fault_of(section, number, now) for number, section in of_line + of_drives]


def fault_of(section: FaultSection, drive: int | None, now: float) -> Fault:
    """Make the fault that a section describes, its times counted from now."""
    until = float("inf") if section.until is None else now + section.until
    return Fault(
        section.kind, drive, section.value, section.probability, section.count, now + section.after, until
    )


def _chance(seed: int, purpose: str) -> Random:
    """Return a source of chance of its own for each purpose, so that one does not shift another."""
    return Random(f"{seed} {purpose}")  # noqa: S311  (reproducible noise, not a secret)
