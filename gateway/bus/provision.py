"""Which block selectors are to be written to a drive, and whether it must be reset before they act.

F875-F879 stand in the EEPROM and act only after a reset (E6581657 6): until then the old mapping is in force.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.bus import selectors
from gateway.drives.register import Register
from gateway.protocol.pdu import WriteRam, WriteStored
from gateway.site import Drive

ATTEMPTS = 2  # writes of one selector while the gateway runs: the second only where the first went unanswered
MARK_ATTEMPTS = 5  # writes of the reset mark, which wear nothing
RESET_MARK = "reset_detection"  # FA87: set to 1 by the host, 0 after a reset (E6581657 7.1)


def selector_registers(drive: Drive) -> list[Register]:
    """Return F875-F879 of a drive, in order."""
    connector = drive.model.connector()
    return [drive.model.registers[name] for name in (connector.block_read if connector else ())]


def wanted(drive: Drive, facts: Mapping[str, int]) -> dict[str, int]:
    """Return the selectors to be written and their values: none where the block brings all that it could."""
    codes = selectors.best(drive)
    registers = selector_registers(drive)[: len(codes)]
    if len(codes) < drive.model.blocks.indirect_read_minimum or any(r.name not in facts for r in registers):
        return {}
    if set(codes) <= {facts[register.name] for register in registers}:
        return {}
    pairs = zip(registers, codes, strict=True)
    return {register.name: code for register, code in pairs if facts[register.name] != code}


@dataclass(slots=True)
class Provision:
    """The provisioning of one drive: each selector is written at most once, and once more without an answer.

    The reset mark (FA87) is set before the first of them, and reads 0 after any reset that comes later.
    """

    drive: Drive
    _attempts: Counter[str] = field(default_factory=Counter)
    _changed: set[str] = field(default_factory=set)

    def awaits_reset(self, facts: Mapping[str, int]) -> bool:
        """Say whether selectors may stand in the drive that are not in force.

        Nobody but the gateway sets the mark, and only to provision: where it stands, no reset has come since. A
        controlled drive is marked whenever it is armed: then only what this process has written counts.
        """
        if not self.drive.provision:
            return False
        if self.drive.is_controlled:
            return bool(self._changed) and self.is_marked(facts)
        return facts[RESET_MARK] == 1 if RESET_MARK in facts else bool(self._changed)

    @staticmethod
    def is_marked(facts: Mapping[str, int]) -> bool:
        """Say whether the mark stands, or cannot be seen."""
        return facts.get(RESET_MARK, 1) == 1

    def next(self, facts: Mapping[str, int]) -> tuple[Register, WriteRam | WriteStored] | None:
        """Return the next register to write and its request; None when nothing is left to do."""
        registers, number = self.drive.model.registers, self.drive.number
        due = {name: code for name, code in wanted(self.drive, facts).items() if self._attempts[name] < ATTEMPTS}
        if due and facts.get(RESET_MARK) == 0 and self._attempts[RESET_MARK] < MARK_ATTEMPTS:
            return registers[RESET_MARK], WriteRam(number, registers[RESET_MARK].address, 1)
        for name, code in due.items():
            return registers[name], WriteStored(number, registers[name].address, code)
        return None

    def attempted(self, register: Register) -> None:
        """Take note that a write is under way: from now on it may have happened."""
        self._attempts[register.name] += 1
        if register.name != RESET_MARK:
            self._changed.add(register.name)

    def marked(self) -> None:
        """Take note that the reset mark stands."""
        self._attempts[RESET_MARK] = 0

    def read_back(self, facts: Mapping[str, int]) -> None:
        """Take what the drive holds: what is there now is not written again, whoever changes it later."""
        still_wanted = wanted(self.drive, facts)
        for name in self._changed - still_wanted.keys():
            self._attempts[name] = ATTEMPTS

    def is_at_its_end(self, facts: Mapping[str, int]) -> bool:
        """Say whether selectors are wanted that were written, or refused, already."""
        return bool(wanted(self.drive, facts)) and not self.awaits_reset(facts)

    def refused(self, register: Register) -> None:
        """Take note that the drive refuses a write: it is not tried again."""
        self._attempts[register.name] = MARK_ATTEMPTS
        self._changed.discard(register.name)

    def in_force(self) -> None:
        """Take note that what was written is in force."""
        self._changed.clear()
