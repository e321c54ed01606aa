"""What can be asked of a simulated line: counts, the state of its drives, and what went over it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gateway.config import Section
from gateway.sim.installation import Installation
from gateway.sim.journal import Entry
from gateway.sim.loop import LineLoop
from gateway.sim.quantities import DriveKey
from gateway.sim.state import state


class Question(Section):
    """Something that is asked; its fields are what it takes."""

    do: str

    def answer(self, line: Installation, loop: LineLoop, now: float) -> Any:
        """Return the answer; WrongRequest says why there is none."""
        raise NotImplementedError


class Stats(Question):
    """What the line counted, how busy it was and how late the simulation was."""

    do: Literal["stats"] = "stats"

    def answer(self, line: Installation, loop: LineLoop, now: float) -> dict[str, Any]:
        """Return the counts."""
        return loop.statistics() | line.counts()


class ResetStats(Question):
    """Counts from 0 again."""

    do: Literal["reset_stats"] = "reset_stats"

    def answer(self, line: Installation, loop: LineLoop, now: float) -> None:
        """Begin anew."""
        loop.reset_statistics()
        line.reset_counts()


class State(Question):
    """What a drive is and holds; without one a list of all drives, in the order of the file."""

    do: Literal["state"] = "state"
    drive: DriveKey | None = None

    def answer(self, line: Installation, loop: LineLoop, now: float) -> Any:
        """Describe it, or them."""
        states = [state(drive, line.name_of(drive), line.opened) for drive in line.drives(self.drive, now)]
        return states if self.drive is None else states[0]


class Log(Question):
    """The latest frames and events, the oldest first."""

    do: Literal["log"] = "log"
    count: int = Field(100, ge=1, description="how many at most")

    def answer(self, line: Installation, loop: LineLoop, now: float) -> list[dict[str, Any]]:
        """Return them."""
        return [table(entry, line.opened) for entry in line.wire.journal.last(self.count)]


def table(entry: Entry, opened: float) -> dict[str, Any]:
    """Describe an entry of the journal; times are seconds since the line was opened."""
    described: dict[str, Any] = {
        "way": entry.way.value,
        "begin": round(entry.begin - opened, 6),
        "end": round(entry.end - opened, 6),
    }
    if entry.drive is not None:
        described["drive"] = entry.drive
    if entry.data:
        described["data"] = entry.data.hex(" ").upper()
        if (text := entry.text) is not None:
            described["text"] = text
    if entry.note:
        described["note"] = entry.note
    return described


AnyQuestion = Annotated[Stats | ResetStats | State | Log, Field(discriminator="do")]
