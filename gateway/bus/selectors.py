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
from gateway.site import Drive

DISPLAY_CODES = range(0x100)  # a character of the display, with or without its dot; its units (E6581657 7.3.1)
TOLERANCE = 50  # counts; a monitored value moves between two reads
TOLERANCE_SHARE = 0.08  # of the value
DISAGREEMENTS = 2  # of one register in a row, before a mapping is given up
PROOFS = 3  # tries to prove a mapping, before it is held to be wrong
SUSPECT_EVERY = 0.1  # seconds between two checks after a disagreement
UNPROVEN_EVERY = 2.0  # seconds between two checks while some word has only agreed at 0
AUDIT_SHARE = 0.05  # of the line, for the checks of all its drives together while nothing has disagreed
STIR_AT_MOST = 2  # blocks in a row of which each may bring the words in doubt to be checked at once
PROVEN_EVERY = 30.0  # seconds between two checks afterwards


def mapping_of(model: Model, selectors: Sequence[int | None]) -> BlockMapping | None:
    """Return what the words of the block carry by these selectors; None where they carry nothing known."""
    names = [model.read_selectors.get(code, "") if code is not None else "" for code in selectors]
    mapping = tuple(model.registers[name] if name else None for name in names)
    return mapping if any(mapping) else None


def best(drive: Drive) -> tuple[int, ...]:
    """Return the values for F875-F879 that bring the most often wanted registers in the block."""
    code_of = {name: code for code, name in drive.model.read_selectors.items() if name}
    wanted = [
        register.name
        for group in sorted(drive.groups, key=lambda group: group.period)
        for register in group.registers
        if register.name in code_of
    ]
    length = drive.model.blocks.indirect_read_maximum
    return tuple(code_of[name] for name in list(dict.fromkeys(wanted))[:length])


def may_be_display(words: Sequence[int]) -> bool:
    """Say whether a block may be the display's text, which it carries while FA80 = 1."""
    return all(word in DISPLAY_CODES for word in words)


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


def is_telling(mapping: BlockMapping, block: Sequence[int], singles: Mapping[str, int]) -> bool:
    """Say whether some word agrees on something but 0: where all is 0, a block that carries nothing agrees too."""
    words = zip(mapping, block, strict=False)
    return any(r is not None and word & r.mask and singles.get(r.name, 0) & r.mask for r, word in words)


@dataclass(slots=True)
class Audit:
    """Checks a mapping in use, word by word: block, single read, block.

    `proven` are registers that have agreed on something but 0. `unsettled` are those for which the selectors
    say something else than what is in force: a reset, which nobody may notice, changes them.
    """

    watched: tuple[tuple[int, Register], ...]
    proven: set[str] = field(default_factory=set)
    unsettled: frozenset[str] = frozenset()
    _turn: int = 0
    _pending: dict[int, tuple[Register, int, int]] = field(default_factory=dict)
    _last: tuple[int, ...] = ()
    _suspect: Register | None = None
    _disagreements: int = 0
    _stirs: int = 0

    @property
    def every(self) -> float:
        """Return the seconds between two checks: few while some word is in doubt."""
        if self._suspect is not None:
            return SUSPECT_EVERY
        return UNPROVEN_EVERY if self._doubted() else PROVEN_EVERY

    def _doubted(self) -> list[Register]:
        registers = (register for _, register in self.watched)
        return [r for r in registers if r.name not in self.proven or r.name in self.unsettled]

    def next(self) -> Register:
        """Return the register to be read alone next; one that disagreed is asked again first."""
        if self._suspect is not None:
            return self._suspect
        doubted, place = self._doubted(), self._turn // 2
        if doubted and self._turn % 2 == 0:  # a word that is always 0 must not keep the others from being checked
            return doubted[place % len(doubted)]
        return self.watched[place % len(self.watched)][1]

    def untrusted(self, words: Sequence[int]) -> list[Register]:
        """Return the registers whose word is not believed yet: it left 0 for the first time, or one disagreed."""
        return [
            register
            for index, register in self.watched
            if register.name not in self.proven
            and index < len(words)
            and (self._suspect is not None or words[index] & register.mask)
        ]

    def stirred(self, words: Sequence[int]) -> list[Register]:
        """Return the registers to be checked at once, when words begin to change: they may be those of others now.

        These are the first that changed, all that have only agreed at 0, and one that disagreed before.
        """
        last = self._last
        changed = [
            register
            for index, register in self.watched
            if index < min(len(words), len(last)) and not agree(register, words[index], last[index], last[index])
        ]
        self._stirs = self._stirs + 1 if changed else 0
        due = [self._suspect] if self._suspect is not None else []
        if 0 < self._stirs <= STIR_AT_MOST:
            due += [*changed[:1], *(r for _, r in self.watched if r.name not in self.proven)]
        return due

    def single(self, register: Register, word: int) -> None:
        """Take a single read; it is judged when the next block comes."""
        self._turn += 1
        for index, watched in self.watched:
            if watched is register and index < len(self._last):
                self._pending[index] = (register, word, self._last[index])

    def block(self, words: Sequence[int]) -> bool:
        """Take the words of a block; return False when the mapping can no longer be believed."""
        self._last = tuple(words)
        pending, self._pending = self._pending, {}
        verdicts = [self._judge(*rest, words[index]) for index, rest in pending.items() if index < len(words)]
        return all(verdicts)

    def _judge(self, register: Register, single: int, before: int, after: int) -> bool:
        if not agree(register, single, before, after):
            self._disagreements = self._disagreements + 1 if self._suspect is not None else 1
            self._suspect = self._suspect or register
            return self._disagreements < DISAGREEMENTS
        if register is self._suspect:
            self._suspect = None
        if single & register.mask:
            self.proven.add(register.name)
        return True
