"""Looks whether an armed drive still has the communication time-out that it was armed with (SAFETY.md H06).

Somebody at the panel may switch F803 off while the drive is commanded: then nothing would stop it any more when the
gateway falls silent. Where the time-out is configured it is set again; without one the drive is disarmed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from gateway.control import watchdog
from gateway.control.state import DriveState, Errand, Standing
from gateway.drives.register import Register

LOOK_EVERY = 10.0  # seconds from one look to the next, at F803, F804 and F808 in turn


@dataclass(slots=True)
class TimeoutLooks:
    """The looks at one drive's time-out; `set_again` writes what is configured and reads otherwise.

    Times are monotonic seconds.
    """

    state: DriveState
    set_again: Callable[[float], None]
    _registers: tuple[Register, ...] = field(init=False)
    _turn: int = 0
    _due: float | None = None  # None while the drive is not armed

    def __post_init__(self) -> None:
        self._registers = tuple(watchdog.registers(self.state.drive.model).values())

    @property
    def _is_wanted(self) -> bool:
        state = self.state
        return state.standing is Standing.ARMED and state.is_online and bool(self._registers)

    def next(self, now: float) -> Errand | None:
        """Return the look that is due."""
        if not self._is_wanted:
            self._due = None
            return None
        if self._due is None:
            self._due = now + LOOK_EVERY  # all was looked at when it was armed
        return self.state.look(self._registers[self._turn]) if now >= self._due else None

    def next_time(self) -> float:
        """Return when `next` is to be asked at the latest; infinite where it need not be."""
        return self._due if self._due is not None and self._is_wanted else float("inf")

    def looked(self, register: Register, now: float) -> None:
        """Take that a look has been made: the next one is later, whatever came of it."""
        if self._due is not None and register is self._registers[self._turn]:
            self._due = now + LOOK_EVERY
            self._turn = (self._turn + 1) % len(self._registers)

    def seen(self, register: Register, word: int, now: float) -> None:
        """Take what a look has shown."""
        state = self.state
        before, word = state.facts.get(register.name), word & register.mask
        if register not in self._registers or before in (None, word) or not self._is_wanted:
            return
        state.facts[register.name] = word
        shown = f"{register.title or register.name} reads {register.format(word)}"
        state.tell("watchdog", f"{shown}, and was {register.format(before)}: changed by somebody else")
        self.set_again(now)
        if state.unwatched and not state.settings.is_unwatched:
            state.disarm(state.unwatched)
