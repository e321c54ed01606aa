"""The writes to one drive's EEPROM: each is permitted by its budget, and counted for good before it is sent (H08)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from gateway.control.budget import Budget
from gateway.control.command import GATEWAY, Reason, Status
from gateway.control.execution import Execution
from gateway.control.ledger import Ledger

OWN_ATTEMPTS = 5  # writes of F803, F804 or F808 by the gateway itself since it has started


@dataclass(slots=True)
class StoredWrites:
    """The EEPROM of one drive. `ring` wakes its line when a count was stored; `tell` takes a caution as an event."""

    drive: str
    ledger: Ledger
    budget: Budget
    ring: Callable[[], None]
    tell: Callable[[str, str], None]
    _own: Counter[int] = field(default_factory=Counter)  # writes of the gateway itself, by number
    _is_begun: bool = False

    def reserve(self, execution: Execution, now: float) -> None:
        """Have a write counted, once; the execution is told when that is done, or why it cannot be."""
        if execution.is_reserving:
            return
        if not self._is_begun:  # a restart does not fill the bucket
            self._is_begun = True
            self.budget.begin(self.ledger.last(self.drive))
        address = execution.write.register.address
        count = self.ledger.count(self.drive, address)
        is_own = execution.command.source == GATEWAY
        refusal = self.budget.why_not(count, now)
        if refusal is not None and (refusal.is_worn or not is_own):
            status = Status.FAILED if execution.was_sent else Status.REFUSED
            execution.finish(status, Reason.WORN if refusal.is_worn else Reason.TOO_OFTEN, refusal.text)
            return
        if is_own and self._own[address] >= OWN_ATTEMPTS:
            text = f"it was written {OWN_ATTEMPTS} times since the start and does not stay: set it by hand"
            execution.finish(Status.REFUSED, Reason.TOO_OFTEN, text)
            return
        if caution := self.budget.caution(count):
            self.tell("eeprom", f"{execution.write.register.name}: {caution}")
        self.budget.take(now)
        if is_own:  # F803 is worth more than its counter: it does not wait for the store
            self._own[address] += 1
            self.ledger.note(self.drive, address)
            execution.reserved()
            return
        execution.is_reserving = True

        def counted(problem: str) -> None:
            execution.is_reserving = False
            execution.reserved(problem)
            self.ring()

        self.ledger.reserve(self.drive, address, counted)
