"""All that is not the gateway, in virtual time: a heap of events, one seeded source of chance, and a trace."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from random import Random

START = 1000.0  # monotonic seconds at which a trial begins
EPOCH = 1_700_000_000.0  # UTC seconds at that moment
MOST_LOOKS = 10_000  # of the gateway at its clock at one moment

Action = Callable[[], object]


class Event:
    """Something that happens at a moment, unless it is called off."""

    __slots__ = ("action",)

    def __init__(self, action: Action) -> None:
        self.action: Action | None = action

    def call_off(self) -> None:
        """Let it not happen."""
        self.action = None


@dataclass(slots=True)
class Nap:
    """A standstill of the process when it has looked at the clock so often: before it knows the time, or after."""

    seconds: float
    looks: int
    is_before: bool


class World:
    """The clock that everything goes by, and what is to come. Same seed, same course of events."""

    def __init__(self, seed: str) -> None:
        self.now = START
        self.wall_offset = 0.0  # seconds by which the wall clock was put forward
        self.frozen_until = -math.inf  # the gateway's process stands still before that
        self.started = START  # when the gateway's process was
        self.naps: list[Nap] = []
        self.before_nap: Action = lambda: None  # takes what the gateway has written so far
        self.looks = 1  # of the gateway at its clock, since the last nap: without any it cannot know of it
        self.looks_at_write = 1  # the same, when it wrote to the line last
        self.napped = -math.inf  # when the last nap was over
        self._seen = START
        self._still = 0
        self.has_sent = False  # something to the gateway, which is then to be looked for at once
        self.trace: list[tuple[object, ...]] = []
        self._seed = seed
        self._events: list[tuple[float, int, Event]] = []
        self._order = itertools.count()

    def chance(self, purpose: str) -> Random:
        """Return a source of chance of its own for a purpose, so that one does not shift another."""
        return Random(f"{self._seed} {purpose}")

    def note(self, *what: object) -> None:
        """Write down what happened now."""
        self.trace.append((self.now, *what))

    def at(self, when: float, action: Action) -> Event:
        """Plan an action; what is planned for one moment happens in the order of planning."""
        event = Event(action)
        heapq.heappush(self._events, (max(when, self.now), next(self._order), event))
        return event

    def after(self, seconds: float, action: Action) -> Event:
        """Plan an action so many seconds from now."""
        return self.at(self.now + seconds, action)

    def advance(self, limit: float) -> bool:
        """Move on to the next event, or to `limit` if that is sooner; say whether anything was left to come."""
        while self._events and self._events[0][2].action is None:
            heapq.heappop(self._events)
        when = min(self._events[0][0] if self._events else math.inf, limit)
        if when == math.inf:
            return False
        self.now = max(self.now, when)
        while self._events and self._events[0][0] <= self.now:
            action = heapq.heappop(self._events)[2].action
            if action is not None:
                action()
        return True

    def freeze(self, seconds: float) -> None:
        """Let the gateway's process stand still from now on: the world goes on, its sockets fill."""
        self.note("freeze", seconds)
        self.frozen_until = self.now + seconds

    def look(self) -> float:
        """Return the time as the gateway sees it: it may stand still just then."""
        self.looks += 1
        self._still = self._still + 1 if self.now == self._seen else 0
        self._seen = self.now
        if self._still > MOST_LOOKS:
            raise AssertionError(f"the gateway has looked {MOST_LOOKS} times at its clock, and never waits")
        if not self.naps or self.frozen_until > self.now:
            return self.now
        nap = self.naps[0]
        nap.looks -= 1
        if nap.looks > 0:
            return self.now
        before = self.now
        self.naps.pop(0)
        self.before_nap()
        self.freeze(nap.seconds)
        while self.now < self.frozen_until:
            self.advance(self.frozen_until)
        self.looks, self.napped = int(nap.is_before), self.now
        return self.now if nap.is_before else before

    def wall(self) -> float:
        """Return UTC seconds."""
        return EPOCH + self.now - START + self.wall_offset

    def digest(self) -> str:
        """Return a hash of all that happened, and when."""
        return sha256("\n".join(map(repr, self.trace)).encode()).hexdigest()
