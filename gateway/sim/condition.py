"""What a simulated drive is at one moment: its memory, motor, trip and counters."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

from gateway.sim.memory import Memory
from gateway.sim.motor import Motor
from gateway.sim.ratings import Ratings

HISTORY = 8  # past trips that are kept; VF-nC3 shows four of them


class TripCode(IntEnum):
    """The codes of FC90 that the simulation trips with by itself (E6581657 7.2)."""

    NONE = 0x00
    EMERGENCY = 0x11
    COMMUNICATION = 0x18


@dataclass(slots=True)
class Panel:
    """What an operator chose at the drive itself; the frequency in Hz counts where the model has no FA03."""

    is_running: bool = False
    is_reverse: bool = False
    frequency: float = 0.0


@dataclass(frozen=True, slots=True)
class Limits:
    """Frequencies in Hz that the RS485 manuals name without their communication numbers.

    FH (maximum frequency), the jog frequency, and preset speeds 1 to 15, which are 0 Hz as shipped.
    """

    maximum: float = 80.0
    jog: float = 5.0
    presets: tuple[float, ...] = ()


@dataclass(slots=True)
class Counters:
    """What a drive counts over its life; hours are kept in seconds."""

    running: float
    powered: float
    forward_starts: int = 0
    reverse_starts: int = 0
    input_energy: float = 0.0  # kWh
    output_energy: float = 0.0


@dataclass(slots=True)
class Condition:
    """The state from which every monitor is computed."""

    memory: Memory
    motor: Motor
    ratings: Ratings
    limits: Limits
    counters: Counters
    panel: Panel = field(default_factory=Panel)
    trip_code: int = TripCode.NONE
    past_trips: tuple[int, ...] = (0,) * HISTORY
    alarm: int = 0  # FC91, set from outside
    is_timed_out: bool = False  # F803 ran out, and no message was acknowledged since
    is_master_tripped: bool = False  # the master's last word was s (VF-MB1 RS485 6)
    is_speed_commanded: bool = False  # FA13 was written after FA01
    version: int = 100  # FE08 and the version that 2BH answers
    time: float = 0.0
    overload: float = 0.0  # % of what trips by overload

    @property
    def is_tripped(self) -> bool:
        """Say whether a trip is held."""
        return self.trip_code != TripCode.NONE

    def add_to_history(self, code: int) -> None:
        """Put a trip in front of the past ones; the earliest is forgotten."""
        self.past_trips = (code, *self.past_trips[: HISTORY - 1])
