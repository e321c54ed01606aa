"""Doors for the MQTT tests: a small site with controlled drives, and a door that keeps what comes to it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from gateway import site
from gateway.clock import Alarm, Clock
from gateway.control.command import Answer, Command, Reason, Result, Source, Status, Verb
from gateway.control.door import Door
from gateway.drives.model import Model
from tests.mosquitto import LIMIT

LEASED, DIRECT, READ_ONLY = "pump-1", "pump-2", "fan-1"


@cache
def small_site() -> site.Site:
    """Return a line `a` with a leased drive, one without leases, and one that nobody may command."""
    shared = {"model": "vf-nc3", "unwatched": True}
    drives = [
        {"name": LEASED, "number": 1, "control": "leased", **shared},
        {"name": DIRECT, "number": 2, "control": "direct", "command_timeout": "10s", **shared},
        {"name": READ_ONLY, "number": 3, "model": "vf-nc3"},
    ]
    table = {"gateway": {"name": "hall-3"}, "line": [{"name": "a", "port": "/dev/null", "drive": drives}]}
    return site.build(table, "test", Path())


def nc3() -> Model:
    """Return the model of those drives."""
    return small_site().drives[0].model


@dataclass
class StandingClock:
    """A clock that stands until it is set."""

    seconds: float = 1000.0
    utc: float = 1_772_366_400.0  # 2026-03-01T12:00:00Z

    def now(self) -> float:
        """Return monotonic seconds."""
        return self.seconds

    def wall(self) -> float:
        """Return UTC seconds."""
        return self.utc + self.seconds

    def alarm(self) -> Alarm:
        """Make none: nothing waits by this clock."""
        raise AssertionError("nothing waits by this clock")


@dataclass(slots=True)
class KeptDoor(Door):
    """A door that keeps what comes to it, and whose commands end when a test says so, or at once if `is_prompt`."""

    open: list[tuple[Command, Answer]] = field(default_factory=list)
    submitted: list[Command] = field(default_factory=list)
    beats: list[tuple[str, Source, object]] = field(default_factory=list)
    is_prompt: bool = False
    _news: asyncio.Event = field(default_factory=asyncio.Event)
    stopped_lines: list[tuple[str, Verb, Source]] = field(default_factory=list)

    @classmethod
    def small(cls, clock: Clock) -> KeptDoor:
        """Make the door of the small site."""
        made = Door.of(small_site(), clock)
        return cls(clock, controls=made.controls, lines=made.lines, _known=frozenset((LEASED, DIRECT, READ_ONLY)))

    def submit(self, command: Command, answer: Answer) -> None:
        """Keep a command; one for a drive that nobody may command is refused as ever."""
        if command.drive not in self.controls:
            Door.submit(self, command, answer)
            return
        self.submitted.append(command)
        self.open.append((command, answer))
        if self.is_prompt:
            self.finish()
        self._news.set()

    def beat(self, drive: str, source: Source, beat: object) -> None:
        """Keep a heartbeat."""
        self.beats.append((drive, source, beat))
        self._news.set()

    def stop_line(self, line: str, verb: Verb, source: Source, answer: Answer, number: str = "") -> None:
        """Keep a stop of a line, and say of each of its drives that it is done."""
        self.stopped_lines.append((line, verb, source))
        now = self.clock.now()
        for drive in self.lines.get(line, ()):
            self._end(Command(drive, verb, source, now, now, id=number), answer)
        self._news.set()

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait until what came so far fulfils a condition."""
        async with asyncio.timeout(LIMIT):
            while not condition():
                self._news.clear()
                await self._news.wait()

    def finish(self, status: Status = Status.DONE, reason: Reason = Reason.NONE) -> None:
        """End every open command."""
        ended, self.open = self.open, []
        for command, answer in ended:
            self._end(command, answer, status, reason)

    def _end(
        self, command: Command, answer: Answer, status: Status = Status.DONE, reason: Reason = Reason.NONE
    ) -> None:
        result = Result(command, status, reason)
        answer(result)
        self.tell_result(result)
