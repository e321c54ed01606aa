"""What the indirect block carries: the mapping that the drive's selectors give, and whether it is in force.

F875-F879 act only after a reset: the parameter that reads back is not always the one in force
(E6581657 5.1.2, 6). So a mapping is believed once single reads of the same registers agree with the
block, and it is checked again and again while it is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gateway.bus.blocks import BlockMapping
from gateway.drives.model import Model
from gateway.drives.register import Register

TOLERANCE = 25  # counts; a monitored value moves between two reads
TOLERANCE_SHARE = 0.05  # of the value
DISAGREEMENTS = 2  # in a row, before a mapping is given up
UNPROVEN_EVERY = 2.0  # seconds between two checks while some word has only agreed at 0
PROVEN_EVERY = 30.0  # seconds between two checks afterwards


def mapping_of(model: Model, selectors: Sequence[int | None]) -> BlockMapping | None:
    """Return what the words of the block carry by these selectors; None where they carry nothing known."""
    names = [model.read_selectors.get(code, "") if code is not None else "" for code in selectors]
    mapping = tuple(model.registers[name] if name else None for name in names)
    return mapping if any(mapping) else None


def agree(register: Register, single: int, before: int, after: int) -> bool:
    """Say whether a single read fits between the block's words read before and after it."""
    if register.bits or register.enumeration:
        mask = register.mask
        return single & mask in (before & mask, after & mask)
    value = register.scaling.raw(single)
    low, high = sorted((register.scaling.raw(before), register.scaling.raw(after)))
    slack = max(TOLERANCE, TOLERANCE_SHARE * abs(value))
    return low - slack <= value <= high + slack


def fits(
    mapping: BlockMapping, before: Sequence[int], after: Sequence[int], singles: Mapping[str, int]
) -> bool:
    """Say whether every single read agrees with the block's word for it."""
    words = zip(mapping, before, after, strict=False)
    return all(
        agree(register, singles[register.name], first, last)
        for register, first, last in words
        if register is not None and register.name in singles
    )


@dataclass(slots=True)
class Audit:
    """Checks a mapping in use, one word at a time: block, single read, block."""

    watched: tuple[tuple[int, Register], ...]
    proven: set[str] = field(default_factory=set)
    _turn: int = 0
    _pending: tuple[int, Register, int, int] | None = None
    _last: tuple[int, ...] = ()
    _disagreements: int = 0

    @property
    def every(self) -> float:
        """Return the seconds between two checks: often until each word has agreed on something but 0."""
        return PROVEN_EVERY if len(self.proven) == len(self.watched) else UNPROVEN_EVERY

    def next(self) -> Register:
        """Return the register to be read alone next."""
        unproven = [entry for entry in self.watched if entry[1].name not in self.proven]
        choice = unproven or self.watched
        return choice[self._turn % len(choice)][1]

    def single(self, register: Register, word: int) -> None:
        """Take a single read; it is judged when the next block comes."""
        self._turn += 1
        for index, watched in self.watched:
            if watched is register and index < len(self._last):
                self._pending = (index, register, word, self._last[index])

    def block(self, words: Sequence[int]) -> bool:
        """Take the words of a block; return False when the mapping can no longer be believed."""
        self._last = tuple(words)
        if self._pending is not None and self._pending[0] < len(words):
            index, register, single, before = self._pending
            self._pending = None
            if not agree(register, single, before, words[index]):
                self._disagreements += 1
                return self._disagreements < DISAGREEMENTS
            self._disagreements = 0
            if single & register.mask:
                self.proven.add(register.name)
        return True
