"""What a simulated line counts: requests and what became of them, and how long the wire was necessarily busy."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import Any


@dataclass(slots=True)
class DriveStatistics:
    """The answers of one drive."""

    answers: int = 0
    last: float | None = None  # when the last answer ended
    longest_interval: float = 0.0  # seconds between two answers

    def answered(self, end: float) -> None:
        """Count an answer that ends then."""
        self.answers += 1
        if self.last is not None:
            self.longest_interval = max(self.longest_interval, end - self.last)
        self.last = end


@dataclass(slots=True)
class WireStatistics:
    """Counts since the start or the last reset. `busy` is in seconds.

    `busy` adds up, for each exchange, what no master can save: the request's characters, 3.5 characters, the
    drive's own time, the answer's characters and 3.5 characters again.
    """

    requests: int = 0
    answers: int = 0
    unanswered: int = 0  # whole frames that no drive answered
    broken: int = 0  # whole in no protocol: wrong CRC or checksum, no form of the manuals
    lost: int = 0  # frames that no drive could hear
    wrong_baud: int = 0  # of these, frames sent at another baud rate
    gap_violations: int = 0  # frames begun less than 3.5 characters after the last one
    splits: int = 0  # pauses of more than 1.5 characters inside a frame
    collisions: int = 0
    busy: float = 0.0
    drives: dict[int, DriveStatistics] = field(default_factory=dict)

    def answered(self, drive: int, end: float, necessary: float) -> None:
        """Count an exchange."""
        self.answers += 1
        self.busy += necessary
        self.drives.setdefault(drive, DriveStatistics()).answered(end)

    def clear(self) -> None:
        """Count anew."""
        for field_ in fields(self):
            setattr(self, field_.name, type(getattr(self, field_.name))())

    def as_table(self) -> dict[str, Any]:
        """Return the counts for JSON, where keys are text."""
        table = asdict(self)
        table["drives"] = {str(number): counts for number, counts in table["drives"].items()}
        return table
