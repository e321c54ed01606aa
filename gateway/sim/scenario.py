"""The scenario of a simulated line: what is done to it when, by its clock or by the count of its exchanges."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

from pydantic import Field, model_validator

from gateway.config import Section
from gateway.sim.doings import AnyDoing
from gateway.sim.faults import Range
from gateway.sim.installation import Installation, WrongRequest
from gateway.sim.journal import Entry, Way
from gateway.sim.quantities import SpanRange

CLOSEST = 0.001  # seconds between an event and its next time
SETTLING = 0.002  # seconds from the end of an exchange to the event that waited for it: the answer is read by then


class When(Section):
    """When an event comes, and how often. Of two durations one between them is drawn, each time anew."""

    at: SpanRange | None = Field(None, description="since the line was opened, or since after_exchanges were over")
    after_exchanges: int | None = Field(None, ge=1, description="requests that the line has seen, answered or not")
    every: SpanRange | None = Field(None, description="again, so long after it was due")
    every_exchanges: int | None = Field(None, ge=1, description="again, so many requests later")
    times: int | None = Field(None, ge=1, description="in all; without end by default where there is an every")

    @model_validator(mode="after")
    def _is_told(self) -> When:
        if self.every is not None and self.every_exchanges is not None:
            raise ValueError("every and every_exchanges exclude each other")
        if all(value is None for value in (self.at, self.after_exchanges, self.every, self.every_exchanges)):
            raise ValueError('it does not say when: at = "5s", after_exchanges = 100, every or every_exchanges')
        if self.every is not None and self.every[0] < CLOSEST:
            raise ValueError('every is to be "1ms" or longer')
        if self.times is not None and not self.repeats:
            raise ValueError("times belongs to every or every_exchanges")
        return self

    @property
    def repeats(self) -> bool:
        """Say whether it comes more than once."""
        return self.every is not None or self.every_exchanges is not None


class EventSection(Section):
    """One event: its keys of time, and what is done with the keys of that."""

    when: When
    doing: AnyDoing

    @model_validator(mode="before")
    @classmethod
    def _told_apart(cls, table: Any) -> Any:
        if not isinstance(table, Mapping) or "doing" in table:
            return table
        when = {key: value for key, value in table.items() if key in When.model_fields}
        return {"when": when, "doing": {key: value for key, value in table.items() if key not in when}}


@dataclass(slots=True)
class Pending:
    """An event that is to come: at a time, or when so many exchanges are over; `left` times, None for no end."""

    event: EventSection
    rng: Random
    left: int | None
    time: float | None = None
    exchanges: int | None = None
    counted: int = 0  # where every_exchanges counts from
    delay: Range = (0.0, 0.0)  # seconds behind the exchange that it waits for

    @classmethod
    def planned(cls, event: EventSection, rng: Random, opened: float) -> Pending:
        """Plan an event of a line that was opened then."""
        when = event.when
        pending = cls(event, rng, when.times if when.repeats else 1)
        if when.after_exchanges is not None:
            pending.exchanges, pending.delay = when.after_exchanges, when.at or pending.delay
        elif when.at is not None:
            pending.time = opened + rng.uniform(*when.at)
        else:
            pending.plan_next(opened, 0)
        return pending

    def plan_next(self, last: float, exchanges: int) -> None:
        """Plan the next time, counted from the last one and from the exchanges so far."""
        when = self.event.when
        self.time, self.exchanges, self.delay = None, None, (0.0, 0.0)
        if when.every is not None:
            self.time = last + self.rng.uniform(*when.every)
        elif when.every_exchanges is not None:
            self.exchanges = exchanges + when.every_exchanges


class Scenario:
    """Plays events on a line, each in its time; those of one moment in the order of the file."""

    def __init__(self, events: Sequence[EventSection], line: Installation, chance: Callable[[str], Random]) -> None:
        self._line = line
        self._exchanges = 0
        self._pending = [
            Pending.planned(event, chance(f"event {place}"), line.opened) for place, event in enumerate(events)
        ]
        line.wire.journal.listen(self._count)

    def _count(self, entry: Entry) -> None:
        self._exchanges += entry.way is Way.REQUEST

    @property
    def next_time(self) -> float | None:
        """Return when something comes by the clock; None where nothing does."""
        return min((pending.time for pending in self._pending if pending.time is not None), default=None)

    def exchange_over(self, now: float) -> None:
        """Note that no exchange is under way, or that the master goes on to the next one."""
        for pending in self._pending:
            if pending.exchanges is not None and pending.exchanges <= self._exchanges:
                pending.counted, pending.exchanges = pending.exchanges, None
                pending.time = now + SETTLING + pending.rng.uniform(*pending.delay)

    def play(self, now: float) -> None:
        """Do all that is due."""
        while due := [pending for pending in self._pending if pending.time is not None and pending.time <= now]:
            self._play(min(due, key=lambda pending: pending.time or 0.0), now)

    def _play(self, pending: Pending, now: float) -> None:
        pending.left = None if pending.left is None else pending.left - 1
        if pending.left == 0:
            self._pending.remove(pending)
        else:
            pending.plan_next(pending.time or now, pending.counted or self._exchanges)
        with contextlib.suppress(WrongRequest):  # it stands in the journal, and is counted
            self._line.do(pending.event.doing, now)
