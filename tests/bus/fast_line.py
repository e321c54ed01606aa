"""A line as fast as it can be reckoned: the real schedule, exchanges that only take their time, and chance."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from random import Random

from gateway.bus.response import Stream, Traffic
from gateway.bus.schedule import Job, Schedule, Send

PERIODS = (0.0, 0.0, 0.05, 0.1, 0.1, 0.15, 0.2, 0.25, 0.4, 0.5, 1.0, 1.0, 2.0)  # seconds; 0: as the line allows
COSTS = (0.012, 0.0235, 0.0332, 0.0354, 0.06, 0.092)  # seconds, of one exchange
AHEAD = ((0.5, 0.03), (1.0, 0.06), (2.0, 0.13), (10.0, 0.18))  # period and cost of what goes ahead of polls


def traffic(chance: Random) -> Traffic:
    """Return any line: one to nine polls, and mostly something that goes ahead of them."""
    count = chance.choice((1, 2, 3, 4, 5, 7, 9))
    polls = [Stream(chance.choice(PERIODS), chance.choice(COSTS)) for _ in range(count)]
    ahead = [Stream(*each) for each in chance.sample(AHEAD, chance.choice((0, 0, 1, 1, 2)))]
    return Traffic(polls, ahead)


@dataclass
class Played:
    """What came of it: the longest response by period, and by poll, and when each poll was answered."""

    latest: dict[float, float] = field(default_factory=lambda: defaultdict(float))
    answers: dict[int, list[float]] = field(default_factory=lambda: defaultdict(list))
    exchanges: int = 0


@dataclass
class FastLine:
    """Plays a line. `haste` is the least share of its longest time that an exchange takes."""

    traffic: Traffic
    chance: Random
    haste: float = 1.0
    offsets: Mapping[int, float] | None = None
    schedule: Schedule[int] = field(default_factory=lambda: Schedule(0.05, 1.0, 5.0))

    def play(self, exchanges: int) -> Played:
        """Carry out that many exchanges."""
        self._begin()
        played, now, schedule, chance = Played(), 0.0, self.schedule, self.chance
        ahead = [[chance.uniform(0, stream.period), stream.period, stream.cost] for stream in self.traffic.ahead]
        costs = [stream.cost for stream in self.traffic.polls]
        haste, latest, answers = self.haste, played.latest, played.answers
        while played.exchanges < exchanges:
            soonest = min(ahead, default=None)
            if soonest is not None and soonest[0] <= now:
                soonest[0] += soonest[1] * chance.choice((1.0, 1.0, 1.1, 1.7))
                now += soonest[2]
                continue
            found = schedule.next(now)
            if not isinstance(found, Send):
                assert found is not None
                now = found.when if soonest is None else min(found.when, soonest[0])
                continue
            job = found.job
            now += costs[job.work] * (haste if haste == 1.0 else chance.uniform(haste, 1.0))
            played.exchanges += 1
            response = now - (job.due if job.period else max(0.0, job.waits_since))
            if response > latest[job.period or 0.0]:
                latest[job.period or 0.0] = response
            answers[job.work].append(now)
            schedule.done(job, now)
        self.end = now
        return played

    def _begin(self) -> None:
        for place, stream in enumerate(self.traffic.polls):
            due = 0.0
            if stream.period:
                due = self.offsets[place] if self.offsets is not None else self.chance.uniform(0, stream.period)
            job = Job(f"d{place}", place, stream.period, due, due + (stream.period or self.traffic.turn))
            self.schedule.set_jobs(job.drive, [job])
        self.schedule.turn = self.traffic.turn
