"""How often the EEPROM of one drive may be written (SAFETY.md H08). Pure: times are monotonic seconds."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import ceil

from gateway.config import StoredWritesSection

HOUR = 3600.0  # seconds


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a write is not made. `is_worn`: the parameter has been written too often, and waiting does not help."""

    is_worn: bool
    text: str


@dataclass(slots=True)
class Budget:
    """A bucket of `burst` writes that fills again by `per_hour`, for all the parameters of one drive.

    Besides, a parameter that was written `refuse` times is not written any more, and from `warn` times on it is said.
    """

    burst: int
    per_hour: float
    warn: int
    refuse: int
    _full_at: float = field(default=float("-inf"), init=False)  # when the bucket is, or was, full again

    @classmethod
    def of(cls, section: StoredWritesSection) -> Budget:
        """Return a full bucket as it is configured."""
        return cls(section.burst, section.per_hour, section.warn, section.refuse)

    @property
    def _interval(self) -> float:
        return HOUR / self.per_hour

    def begin(self, last: float) -> None:
        """Start as if the bucket had been emptied by a write at `last`: a restart does not fill it."""
        self._full_at = max(self._full_at, last + self.burst * self._interval)

    def why_not(self, count: int, now: float) -> Refusal | None:
        """Say why a parameter that was written `count` times is not written now; None where it may be."""
        if count >= self.refuse:
            text = (
                f"the parameter has been written to the EEPROM {count} times; stored_writes.refuse = {self.refuse}"
                " permits no more, since the drive stands about 10,000"
            )
            return Refusal(True, text)
        wait = self._full_at - (self.burst - 1) * self._interval - now
        if wait > 0:
            text = (
                f"the EEPROM may be written {self.burst} times at once and {self.per_hour:g} times an hour"
                f" (stored_writes); the next write may be made in {ceil(wait)} s"
            )
            return Refusal(False, text)
        return None

    def take(self, now: float) -> None:
        """Take one write out of the bucket."""
        self._full_at = max(self._full_at, now) + self._interval

    def caution(self, count: int) -> str:
        """Say, with every write of a parameter, that it is worn more than it should be; "" while it is not."""
        if count < self.warn:
            return ""
        return f"the parameter has been written to the EEPROM {count} times; none is made after {self.refuse}"
