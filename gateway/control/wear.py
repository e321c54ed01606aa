"""How worn one parameter of a drive is: the writes to its EEPROM, how fast they come, and how long it will last."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, inf

LIFE = 10_000  # writes of one parameter that its EEPROM stands (E6581657, safety precautions, 4.2 and 5.1.4)
MEMORY = 86_400.0  # seconds over which the pace is a mean: one burst of commissioning is soon forgotten

Key = tuple[str, int]  # drive, communication number


@dataclass(frozen=True, slots=True)
class Wear:
    """One parameter. `last` is when it was written last, and `pace` the writes a second as they were then."""

    writes: int = 0
    pace: float = 0.0
    last: float = -inf

    def after_write(self, now: float) -> Wear:
        """Return it with one more write, at `now`."""
        return Wear(self.writes + 1, self.pace_at(now) + 1 / MEMORY, max(now, self.last))

    def pace_at(self, now: float) -> float:
        """Return the writes a second, a mean in which older ones count less and less."""
        return self.pace * exp(min(0.0, self.last - now) / MEMORY) if self.pace else 0.0

    def seconds_left(self, now: float) -> float:
        """Return how long the EEPROM lasts if writes go on as they come: 0 when it is worn, inf without any."""
        left = max(0, LIFE - self.writes)
        pace = self.pace_at(now)
        if not left:
            return 0.0
        return left / pace if pace else inf

    def joined(self, other: Wear) -> Wear:
        """Return the more worn of two accounts of one parameter, in each respect: counts only go up."""
        return Wear(max(self.writes, other.writes), max(self.pace, other.pace), max(self.last, other.last))


UNWORN = Wear()


def last_write(wear: Mapping[Key, Wear], drive: str) -> float:
    """Return when any parameter of a drive was written last; -inf where none was."""
    return max((of.last for (name, _), of in wear.items() if name == drive), default=-inf)
