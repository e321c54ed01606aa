"""How often the EEPROM of a drive may be written: a machine of chances, and the words of each refusal."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gateway.config import StoredWritesSection
from gateway.control.budget import HOUR, Budget
from gateway.control.ledger import MemoryLedger

NUMBERS = (0x0010, 0x0803, 0x0875)
SLACK = 1e-6  # writes, for rounding


class BudgetMachine(RuleBasedStateMachine):
    """One drive: commands that ask for stored writes, pauses, restarts, a store that fails for a time."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 1000.0
        self.made: list[float] = []  # when each write was sent
        self.written: Counter[int] = Counter()  # what the drive's EEPROM has suffered
        self.seen: Counter[int] = Counter()  # the greatest counts that were ever shown
        self.ledger = MemoryLedger()

    @initialize(
        burst=st.integers(1, 5),
        per_hour=st.sampled_from([0.5, 1.0, 7.0, 20.0, 3600.0]),
        refuse=st.integers(1, 12),
        share=st.floats(0, 1),
    )
    def configure(self, burst: int, per_hour: float, refuse: int, share: float) -> None:
        """Begin with small numbers, so that every limit is met."""
        warn = max(1, int(refuse * share))
        self.section = StoredWritesSection(burst=burst, per_hour=per_hour, warn=warn, refuse=refuse)
        self.budget = Budget.of(self.section)

    @rule(number=st.sampled_from(NUMBERS), is_killed=st.booleans())
    def write(self, number: int, is_killed: bool) -> None:
        """Ask, count, send; the process may be killed between counting and sending."""
        count = self.ledger.count("pump", number)
        refusal = self.budget.why_not(count, self.now)
        if refusal is not None:
            assert refusal.is_worn == (count >= self.section.refuse)
            return
        self.budget.take(self.now)
        told: list[str] = []
        self.ledger.reserve("pump", number, told.append)
        if told == [""] and not is_killed:
            self.made.append(self.now)
            self.written[number] += 1
        if is_killed:
            self.restart()

    @rule()
    def restart(self) -> None:
        """Begin anew with what the ledger kept: the counts, and when it was last written."""
        self.budget = Budget.of(self.section)
        self.budget.begin(self.made[-1] if self.made else float("-inf"))

    @rule(seconds=st.one_of(st.floats(0, 10), st.floats(0, 3 * HOUR)))
    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds

    @precondition(lambda self: self.made)
    @rule()
    def wait_as_long_as_is_said(self) -> None:
        """Wait for the time that a refusal names: then the rate permits a write."""
        refusal = self.budget.why_not(0, self.now)
        if refusal is not None and not refusal.is_worn:
            self.now += float(refusal.text.rpartition(" in ")[2].removesuffix(" s"))
            assert self.budget.why_not(0, self.now) is None

    @rule(problem=st.sampled_from(["", "disk full"]))
    def fare(self, problem: str) -> None:
        """Let the store fail, or come back."""
        self.ledger.problem = problem

    @invariant()
    def no_window_holds_more_than_the_burst_and_the_rate(self) -> None:
        """In every span of time, whatever was asked and however often it was restarted."""
        if not self.made:
            return
        last, rate = self.made[-1], self.section.per_hour / HOUR
        for place, first in enumerate(self.made):
            assert len(self.made) - place <= self.section.burst + rate * (last - first) + SLACK

    @invariant()
    def no_parameter_is_written_beyond_its_limit(self) -> None:
        """Also not after restarts, since each write was counted before."""
        for number in NUMBERS:
            assert self.section.refuse >= self.ledger.count("pump", number) >= self.written[number]

    @invariant()
    def counts_only_go_up(self) -> None:
        """By drive and number."""
        for number in NUMBERS:
            count = self.ledger.count("pump", number)
            assert count >= self.seen[number]
            self.seen[number] = count

    @invariant()
    def it_is_said_from_the_threshold_on(self) -> None:
        """With every write of a parameter that was written so often, and not before."""
        for number in NUMBERS:
            count = self.ledger.count("pump", number)
            assert bool(self.budget.caution(count)) == (count >= self.section.warn)


TestBudget = pytest.mark.hazard("H08")(BudgetMachine.TestCase)


@pytest.mark.hazard("H08")
def test_a_burst_is_permitted_at_once_and_then_the_rate() -> None:
    """Ten at once, then one in three minutes; the refusal says what is configured and how long to wait."""
    budget = Budget.of(StoredWritesSection())
    for _ in range(10):
        assert budget.why_not(0, 100.0) is None
        budget.take(100.0)
    refusal = budget.why_not(0, 100.5)
    assert refusal is not None
    assert (refusal.is_worn, refusal.text) == (
        False,
        "the EEPROM may be written 10 times at once and 20 times an hour (stored_writes);"
        " the next write may be made in 180 s",
    )
    assert budget.why_not(0, 280.0) is None


@pytest.mark.hazard("H08")
def test_a_restart_does_not_fill_the_bucket() -> None:
    """It starts as if its last write had emptied it; one that was long ago has no effect."""
    budget = Budget.of(StoredWritesSection())
    budget.begin(100.0)
    assert budget.why_not(0, 279.0) is not None
    assert budget.why_not(0, 280.0) is None
    budget.begin(-1e6)
    budget.take(280.0)
    assert budget.why_not(0, 281.0) is not None


@pytest.mark.hazard("H08")
def test_a_worn_parameter_is_refused_for_good() -> None:
    """However long ago the last write was; before that it is said with each write."""
    budget = Budget.of(StoredWritesSection(warn=1000, refuse=5000))
    assert budget.caution(999) == ""
    assert "1000 times" in budget.caution(1000)
    assert budget.why_not(4999, 0.0) is None
    refusal = budget.why_not(5000, 1e9)
    assert refusal is not None
    assert refusal.is_worn
    assert "5000 times" in refusal.text
