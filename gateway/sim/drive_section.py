"""One drive in the file of a simulated line, and the drive that comes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from random import Random
from typing import Literal

from pydantic import Field, model_validator

from gateway.config import Section, ValueName
from gateway.drives.model import Model
from gateway.errors import BadConfig
from gateway.sim.condition import Limits
from gateway.sim.doing import outside
from gateway.sim.drive import BAUD_CODES, PARITY_CODES, SimulatedDrive
from gateway.sim.fault_section import OF_THE_LINE, FaultSection
from gateway.sim.options import DriveOptions
from gateway.sim.quantities import DriveName, Hertz, Number, Span, Word
from gateway.sim.ratings import of_capacity

Protocol = Literal["modbus-rtu", "toshiba"]


class SimulatedDriveSection(Section):
    """One simulated drive."""

    number: Number = Field(description="inverter number F802")
    name: DriveName | None = Field(None, description="for scenario and control, whatever its number becomes")
    model: str = Field(description="a model of the catalogue")
    protocol: Protocol | None = Field(None, description="F829; the line's by default")
    capacity: str | int | None = Field(None, description='type form ("VFnC3-2007P") or its FB05 code')
    running_at: Hertz = Field(0.0, description="started from the panel, in Hz")
    block_read: list[Word] = Field([], max_length=5, description="F875 to F879; 0 as shipped")
    block_write: list[Word] = Field([], max_length=2, description="F870 and F871; 0 as shipped")
    registers: dict[ValueName, Word] = Field({}, description="further words in its EEPROM, by name")
    processing_time: Span | None = Field(None, ge=0, le=2, description="the line's by default")
    direct_blocks: bool = Field(False, description="accept direct blocks for FAxx-FExx too")
    stable_bits: bool = Field(False, description="undefined bits read 0 instead of changing by chance")
    proportional_restarts_timer: bool = Field(False, description="S and s count for F803 too")
    load: float = Field(0.6, ge=0, le=2, description="of rated torque at 60 Hz")
    maximum_frequency: Hertz = Field(80.0, gt=0, description="FH")
    jog_frequency: Hertz = 5.0
    preset_frequencies: list[Hertz] = Field([], max_length=15, description="preset speeds 1 to 15")
    version: int = Field(100, ge=0, le=9999, description="FE08, and what 2BH answers")
    fault: list[FaultSection] = Field([], description="faults of this drive")

    @model_validator(mode="after")
    def _has_no_fault_of_the_line(self) -> SimulatedDriveSection:
        for place, fault in enumerate(self.fault):
            if fault.kind in OF_THE_LINE:
                kind = fault.kind.value
                raise ValueError(f"fault[{place}]: {kind} is a fault of the line: it stands under [[fault]]")
        return self


@dataclass(frozen=True, slots=True)
class LineDefaults:
    """What a line gives its drives where they have nothing of their own."""

    baud: int
    parity: str
    protocol: Protocol
    processing_time: float
    eeprom_time: float | None


def make(
    section: SimulatedDriveSection, line: LineDefaults, models: Mapping[str, Model], rng: Random, now: float
) -> SimulatedDrive:
    """Make the drive and switch it on; BadConfig says what its model does not have."""
    model = models.get(section.model)
    if model is None:
        raise BadConfig(f"no model {section.model!r}; known: {', '.join(sorted(models))}")
    presets = {**_line_settings(line, model), **_selectors(section, model), **section.registers}
    if unknown := [name for name in presets if name not in model.registers]:
        raise BadConfig(f"{section.model} has no register {', '.join(unknown)}")
    if wrong := [text for name, word in presets.items() if (text := outside(model.registers[name], word))]:
        raise BadConfig(f"registers: {'; '.join(wrong)}")
    try:
        of_capacity(model, section.capacity)
    except KeyError:
        known = ", ".join(f"{code}: {form}" for code, form in model.capacities.items())
        raise BadConfig(f"no capacity {section.capacity!r}; known: {known or 'none'}") from None
    own = section.processing_time
    options = DriveOptions(
        number=section.number,
        protocol=section.protocol or line.protocol,
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
        proportional_restarts_timer=section.proportional_restarts_timer,
    )
    return SimulatedDrive(model, options, rng, now)


def _line_settings(line: LineDefaults, model: Model) -> dict[str, int]:
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
