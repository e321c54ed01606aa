"""The writes to one drive's EEPROM: each is permitted by its budget, and counted for good before it is sent (H08)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gateway.control.budget import Budget
from gateway.control.command import GATEWAY, Reason, Status
from gateway.control.execution import Execution
from gateway.control.ledger import Ledger


@dataclass(slots=True)
class StoredWrites:
    """The EEPROM of one drive. `ring` wakes its line when a count was stored; `tell` takes a caution as an event."""

    drive: str
    ledger: Ledger
    budget: Budget
    ring: Callable[[], None]
    tell: Callable[[str, str], None]

    def reserve(self, execution: Execution, now: float) -> None:
        """Have a write counted, once; the execution is told when that is done, or why it cannot be."""
        if execution.is_reserving:
            return
        address = execution.write.register.address
        count = self.ledger.count(self.drive, address)
        if refusal := self.budget.why_not(count, now):
            status = Status.FAILED if execution.was_sent else Status.REFUSED
            execution.finish(status, Reason.WORN if refusal.is_worn else Reason.TOO_OFTEN, refusal.text)
            return
        if caution := self.budget.caution(count):
            self.tell("eeprom", f"{execution.write.register.name}: {caution}")
        self.budget.take(now)
        if execution.command.source == GATEWAY:  # F803 is worth more than its counter: it does not wait for the store
            self.ledger.note(self.drive, address)
            execution.reserved()
            return
        execution.is_reserving = True

        def counted(problem: str) -> None:
            execution.is_reserving = False
            execution.reserved(problem)
            self.ring()

        self.ledger.reserve(self.drive, address, counted)
