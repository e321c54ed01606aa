"""Whether a drive that was told to stop does so: its status and its frequency are looked at until that is seen.

FA00 that reads back says only that the drive has got the command; FD01 and FD00 say what its motor does
(E6581657 7.2).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from gateway.control.composing import has_bit
from gateway.drives.model import Model
from gateway.drives.register import Register

STATUS = "status"  # FD01
OUTPUT = "output_frequency"  # FD00
EVERY = 0.1  # seconds between two looks
WITHIN = 3.0  # seconds in which the motor has to be seen standing, or slowing down


@dataclass(slots=True)
class Following:
    """The looks at one drive after a stop was read back. Times are monotonic seconds."""

    model: Model
    since: float
    is_seen: bool = False
    _highest: int | None = None
    _looked: float = field(default=float("-inf"))
    _is_output_next: bool = False

    def __post_init__(self) -> None:
        self.is_seen = STATUS not in self.model.registers  # nothing to look at: the read-back has to do

    @property
    def due(self) -> float:
        """Return when the next look is to be made."""
        return self._looked + EVERY

    def is_late(self, now: float) -> bool:
        """Say whether the drive should have been seen to stop by now."""
        return not self.is_seen and now > self.since + WITHIN

    def next(self, now: float) -> Register | None:
        """Return what to look at now; None before the next look is due."""
        if self.is_seen or now < self.due:
            return None
        self._looked = now
        name = OUTPUT if self._is_output_next else STATUS
        self._is_output_next = not self._is_output_next and OUTPUT in self.model.registers
        return self.model.registers[name]

    def take(self, register: Register, word: int) -> None:
        """Take what was seen: a motor that stands, a trip, or a frequency that falls."""
        if register.name == STATUS:
            self.is_seen |= not has_bit(register, word, "running") or has_bit(register, word, "tripped")
        elif register.name == OUTPUT:
            if self._highest is not None and word < self._highest:
                self.is_seen = True
            self._highest = max(word, self._highest or 0)
