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
    """The provisioning of one drive: each selector is written at most once, and once more without an answer."""

    drive: Drive
    is_marked: bool = False
    _attempts: Counter[str] = field(default_factory=Counter)
    _changed: set[str] = field(default_factory=set)

    @property
    def awaits_reset(self) -> bool:
        """Say whether selectors were written since the last reset that is known of."""
        return bool(self._changed)

    def next(self, facts: Mapping[str, int]) -> tuple[Register, WriteRam | WriteStored] | None:
        """Return the next register to write and its request; None when nothing is left to do.

        The reset mark is set last, so that the reset can be told from a lost cable.
        """
        registers, number = self.drive.model.registers, self.drive.number
        for name, code in wanted(self.drive, facts).items():
            if self._attempts[name] < ATTEMPTS:
                return registers[name], WriteStored(number, registers[name].address, code)
        mark = registers.get(RESET_MARK)
        if self.awaits_reset and not self.is_marked and mark is not None:
            return mark, WriteRam(number, mark.address, 1)
        return None

    def attempted(self, register: Register) -> None:
        """Take note that a write is under way: from now on it may have happened."""
        if register.name == RESET_MARK:
            self.is_marked = True
            return
        self._attempts[register.name] += 1
        self._changed.add(register.name)

    def acknowledged(self, register: Register) -> None:
        """Take note that the drive has written it: it is not written again."""
        self._attempts[register.name] = ATTEMPTS

    def refused(self, register: Register) -> None:
        """Take note that the drive refuses a write: it is not tried again."""
        self._attempts[register.name] = ATTEMPTS
        self._changed.discard(register.name)

    def reset_seen(self) -> None:
        """Take note that the drive was reset: what was written is in force."""
        self.is_marked = False
        self._changed.clear()
