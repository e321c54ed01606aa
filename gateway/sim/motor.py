"""The motor and its load: how the output frequency ramps, and what current, voltage and torque come of it."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

BASE_FREQUENCY = 60.0  # Hz where the output voltage is full; the manual's 60 Hz example shows 94.69 % (4.1.3)
BOOST = 4.0  # % of voltage at standstill, so that the motor has torque at low speed
MAGNETISING = 32.0  # % of rated current that flows without load
SLIP = 0.04  # of the base frequency, at rated torque
FRICTION = 0.15  # of the load that does not depend on speed
INERTIA = 1.6  # % of torque for each Hz/s of acceleration
NOISE = 0.25  # % of rated current, one standard deviation
EFFICIENCY = 0.87


@dataclass(frozen=True, slots=True)
class Ramp:
    """How the frequency moves: Hz per second upwards and downwards."""

    up: float
    down: float


class Motor:
    """Output frequency, signed: reverse is negative. Loads rise with the square of speed, as pumps do."""

    def __init__(self, rng: Random, load: float = 0.6) -> None:
        self._rng = rng
        self._load = load  # of rated torque at the base frequency
        self.frequency = 0.0
        self.acceleration = 0.0  # Hz/s, signed by the change of |frequency|

    def cut(self) -> None:
        """Switch the output off: the motor coasts, the drive puts out nothing."""
        self.frequency = 0.0
        self.acceleration = 0.0

    def advance(self, target: float, ramp: Ramp, seconds: float) -> None:
        """Ramp towards a signed target for that long; a change of direction goes through standstill."""
        left = seconds
        self.acceleration = 0.0
        while left > 0 and self.frequency != target:
            goal = target if self.frequency * target >= 0 else 0.0
            rate = ramp.up if abs(goal) > abs(self.frequency) else ramp.down
            needed = abs(goal - self.frequency) / rate
            if needed > left:
                self.frequency += rate * left * (1 if goal > self.frequency else -1)
                self.acceleration = rate if abs(goal) > abs(self.frequency) else -rate
                return
            self.frequency, left = goal, left - needed

    def time_to_stop(self, ramp: Ramp) -> float:
        """Return the seconds that a ramp down to standstill takes."""
        return abs(self.frequency) / ramp.down

    @property
    def torque(self) -> float:
        """Return the torque in % of rated, negative while the motor brakes."""
        if self.frequency == 0:
            return 0.0
        speed = abs(self.frequency) / BASE_FREQUENCY
        load = 100.0 * self._load * (FRICTION + (1 - FRICTION) * speed * speed)
        return load + INERTIA * self.acceleration

    @property
    def voltage(self) -> float:
        """Return the output voltage in %: in proportion to frequency up to the base frequency, and boosted."""
        if self.frequency == 0:
            return 0.0
        return min(100.0, BOOST + (100.0 - BOOST) * abs(self.frequency) / BASE_FREQUENCY)

    @property
    def slip(self) -> float:
        """Return by how many Hz the shaft falls behind."""
        return SLIP * BASE_FREQUENCY * self.torque / 100.0

    def current(self) -> float:
        """Return the output current in % of rated, as measured just now."""
        if self.frequency == 0:
            return 0.0
        true: float = (MAGNETISING**2 + self.torque**2) ** 0.5
        return max(0.0, true + self._rng.gauss(0.0, NOISE))

    def bus_voltage(self) -> float:
        """Return the DC voltage in %: sagging under load, rising while the motor brakes."""
        return 100.0 - 0.03 * self.torque + self._rng.gauss(0.0, 0.08)

    def output_power(self, kilowatts: float) -> float:
        """Return the power at the shaft in kW."""
        return kilowatts * self.torque / 100.0 * abs(self.frequency) / BASE_FREQUENCY

    def input_power(self, kilowatts: float) -> float:
        """Return the power from the mains in kW; without regeneration it is never negative."""
        standby = 0.01 if self.frequency == 0 else 0.02
        return max(0.0, self.output_power(kilowatts)) / EFFICIENCY + standby
