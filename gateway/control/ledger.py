"""What control keeps for longer than the process: how often each parameter was stored, and the audit of commands.

Setpoints and run commands are never kept as something to go on from: the audit is only ever read by people.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

from gateway.control.command import Result
from gateway.control.wear import UNWORN, Key, Wear

Counted = Callable[[str], None]  # "": the write is counted for good; else why it cannot be, and must not be made

KEPT = 10_000  # entries that the twin in memory keeps


@dataclass(frozen=True, slots=True)
class Entry:
    """One row of the audit. `time` is UTC seconds; words are raw, by register name."""

    time: float
    drive: str
    kind: Literal["command", "event"]
    source: str = ""
    verb: str = ""
    id: str = ""
    value: str = ""
    before: Mapping[str, int] = field(default_factory=dict)
    words: Mapping[str, int] = field(default_factory=dict)
    read_back: Mapping[str, int] = field(default_factory=dict)
    status: str = ""
    reason: str = ""
    text: str = ""

    @classmethod
    def of_result(cls, result: Result, time: float) -> Entry:
        """Return the row for a command that has ended."""
        command = result.command
        return cls(
            time,
            command.drive,
            "command",
            source=str(command.source),
            verb=command.verb.value,
            id=command.id,
            value=command.text if command.value is None else str(command.value),
            before=dict(result.before),
            words=dict(result.raw),
            read_back=dict(result.read_back),
            status=result.status.value,
            reason=result.reason.value,
            text=result.text,
        )

    @classmethod
    def of_event(cls, drive: str, event: str, reason: str, time: float) -> Entry:
        """Return the row for an event: armed, disarmed, lease lost, left alone."""
        return cls(time, drive, "event", verb=event, text=reason)


class Ledger(Protocol):
    """The counts of writes to the EEPROM, which only go up, and the audit. No call waits for a disk."""

    @property
    def problem(self) -> str:
        """Say why nothing can be counted for good; "" while all is well."""

    @property
    def dropped(self) -> int:
        """Return how many rows of the audit were dropped since the start."""

    @property
    def wear(self) -> Mapping[Key, Wear]:
        """Return all that was counted, by drive and number; times are monotonic seconds."""

    def count(self, drive: str, address: int) -> int:
        """Return how many writes of a parameter were counted: never fewer than were made."""

    def last(self, drive: str) -> float:
        """Return when a write to the drive was counted last, before the last start too; -inf where none was."""

    def reserve(self, drive: str, address: int, then: Counted) -> None:
        """Count a write that is about to be made; `then` is called in the event loop, perhaps before this returns.

        Only after `then("")` may the frame be sent: so a process that is killed may have counted one too many,
        never one too few.
        """

    def note(self, drive: str, address: int) -> None:
        """Count a write that is made anyway, without waiting for the disk."""

    def record(self, entry: Entry) -> None:
        """Add a row to the audit; it is dropped, and that counted, where too many wait already."""


@dataclass(slots=True)
class MemoryLedger:
    """A ledger that lasts as long as the process, and knows no time.

    `problem` may be set, to see what a broken one does.
    """

    problem: str = ""
    dropped: int = 0
    wear: dict[Key, Wear] = field(default_factory=dict)
    entries: deque[Entry] = field(default_factory=deque)

    def count(self, drive: str, address: int) -> int:
        """Return the writes counted since the start."""
        return self.wear.get((drive, address), UNWORN).writes

    def last(self, drive: str) -> float:
        """Return that nothing is known from before the start."""
        return float("-inf")

    def reserve(self, drive: str, address: int, then: Counted) -> None:
        """Count a write, and say so at once."""
        if not self.problem:
            self.note(drive, address)
        then(self.problem)

    def note(self, drive: str, address: int) -> None:
        """Count a write."""
        self.wear[drive, address] = Wear(self.count(drive, address) + 1)

    def record(self, entry: Entry) -> None:
        """Keep an entry; the oldest gives way."""
        if len(self.entries) >= KEPT:
            self.entries.popleft()
            self.dropped += 1
        self.entries.append(entry)
