"""How one simulated drive is set up before it is switched on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from gateway.drives.model import Model
from gateway.sim.condition import Limits

TOSHIBA, MODBUS_RTU = 0, 1  # F829
PROTOCOLS = {"toshiba": TOSHIBA, "modbus-rtu": MODBUS_RTU}
ACCELERATION = 100  # counts of 0.1 s: ACC and DEC as shipped


@dataclass(frozen=True, slots=True)
class DriveOptions:
    """How one drive is set up. Times in seconds, frequencies in Hz, `presets` are register words by name.

    `eeprom` is how long a write to the EEPROM takes, the model's longest time by default. `load` is the
    motor's load at the base frequency, 1 for rated torque. `hours` is how long it has run so far.
    `protocol` presets F829; where the model's codes for it are not known it is what the drive speaks.
    """

    number: int
    protocol: Literal["modbus-rtu", "toshiba"] = "modbus-rtu"
    capacity: str | int | None = None
    presets: Mapping[str, int] = field(default_factory=dict)
    running_at: float = 0.0
    processing: float = 0.005
    eeprom: float | None = None
    accepts_direct_blocks: bool = False  # outside the ranges that the manual shows
    load: float = 0.6
    limits: Limits = field(default_factory=Limits)
    version: int = 100
    hours: float = 1000.0
    stable_bits: bool = False  # undefined bits read 0 instead of changing by chance
    proportional_restarts_timer: bool = False  # S, which is never answered, counts for F803 too


def roles(model: Model) -> Mapping[str, str]:
    """Return the communication parameters of the model's first connector: role to name."""
    connector = model.connector()
    return connector.parameters if connector else {}


def as_set_up(model: Model, options: DriveOptions) -> dict[str, int]:
    """Return the EEPROM of a drive that is ready for its protocol under its number; the rest as shipped."""
    ready = {
        roles(model).get("number", ""): options.number,
        roles(model).get("protocol", ""): PROTOCOLS[options.protocol],
        "acceleration_time_1": ACCELERATION,
        "deceleration_time_1": ACCELERATION,
    }
    return {name: word for name, word in ready.items() if name in model.registers} | dict(options.presets)
