"""The rows of the audit, and the ledger that lasts as long as the process."""

from __future__ import annotations

from decimal import Decimal

import pytest

from gateway.control import ledger
from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.ledger import Entry, MemoryLedger

COMMAND = Command(
    "pump", Verb.SPEED, Source(Channel.MODBUS_TCP, "10.0.0.9"), 1.0, 2.0, id="7", value=Decimal("1500.0")
)


def test_a_result_becomes_a_row_with_all_that_is_known_of_it() -> None:
    """Who, what, from which words to which, and how it ended; the value as it was written."""
    result = Result(COMMAND, Status.FAILED, Reason.NOT_READ_BACK, "why", {"f": 2}, {"f": 3}, {"f": 1})
    assert Entry.of_result(result, 99.5) == Entry(
        time=99.5,
        drive="pump",
        kind="command",
        source="modbus-tcp 10.0.0.9",
        verb="speed",
        id="7",
        value="1500.0",
        before={"f": 1},
        words={"f": 2},
        read_back={"f": 3},
        status="failed",
        reason="not_read_back",
        text="why",
    )


def test_an_event_becomes_a_row_with_its_reason() -> None:
    """Nobody commanded it."""
    entry = Entry.of_event("pump", "lease_lost", "no heartbeat", 99.5)
    assert (entry.kind, entry.verb, entry.text, entry.source) == ("event", "lease_lost", "no heartbeat", "")


@pytest.mark.hazard("H08")
def test_the_ledger_in_memory_counts_by_drive_and_number() -> None:
    """A write that is made anyway counts like one that was asked for."""
    memory, told = MemoryLedger(), list[str]()
    memory.reserve("pump", 0x10, told.append)
    memory.note("pump", 0x10)
    memory.note("fan", 0x10)
    assert told == [""]
    assert (memory.count("pump", 0x10), memory.count("fan", 0x10), memory.count("pump", 0x11)) == (2, 1, 0)
    assert memory.last("pump") == float("-inf")


@pytest.mark.hazard("H35")
def test_the_ledger_in_memory_can_be_broken_for_a_test() -> None:
    """Nothing is counted then, and why is told."""
    memory, told = MemoryLedger(problem="disk full"), list[str]()
    memory.reserve("pump", 0x10, told.append)
    assert told == ["disk full"]
    assert memory.count("pump", 0x10) == 0


def test_the_oldest_rows_in_memory_give_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that runs for a year must not fill up; what is gone is counted."""
    monkeypatch.setattr(ledger, "KEPT", 3)
    memory = MemoryLedger()
    for number in range(5):
        memory.record(Entry.of_event("pump", "armed", str(number), 0.0))
    assert [entry.text for entry in memory.entries] == ["2", "3", "4"]
    assert memory.dropped == 2
