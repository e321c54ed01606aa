"""A line as fast as it can be reckoned: the real schedule, exchanges that only take their time, and chance."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from random import Random

from gateway.bus.response import Stream, Traffic
from gateway.bus.schedule import AHEAD as URGENT
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


HELD_FOR = 0.4  # seconds for which a drive is left alone behind an exchange that was lost
LOSS_EVERY = 10.0  # seconds, at the soonest
COMMANDS = (1.0, 0.075)  # period and cost: a frame and its read-back
WHO, LOST, SILENCE = 0.02, 0.09, 0.045  # seconds: who is there, an exchange that is lost, a try of a silent drive
ASKING = -1  # the work of asking who is there
SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Disturbed:
    """A line on which exchanges are lost and commands come, some of whose drives are silent. `polls` by drive."""

    polls: tuple[tuple[Stream, ...], ...]
    silent: int
    is_commanded: bool

    @property
    def traffic(self) -> Traffic:
        """Return what it carries, as `gateway.bus.traffic` reckons a real one."""
        held = max(sum(stream.cost for stream in drive) for drive in self.polls)
        ahead = [Stream(*COMMANDS)] if self.is_commanded else []
        ahead += [Stream(LOSS_EVERY, LOST + WHO + held), Stream(SILENCE / SHARE, SILENCE)]
        return Traffic([stream for drive in self.polls for stream in drive], ahead)


def disturbed(chance: Random) -> Disturbed:
    """Return any line that is disturbed."""
    drives = chance.choice((1, 2, 3, 4))
    polls = [
        tuple(Stream(chance.choice(PERIODS), chance.choice(COSTS)) for _ in range(chance.choice((1, 1, 2, 3))))
        for _ in range(drives)
    ]
    return Disturbed(tuple(polls), chance.choice((0, 1, 5)), chance.random() < 0.5)


class DisturbedLine:
    """Plays a disturbed line with the real schedule: holds, questions who is there, tries of silent drives."""

    def __init__(self, line: Disturbed, chance: Random) -> None:
        self.latest: dict[float, float] = defaultdict(float)
        self.losses = self.tries = 0
        self._chance, self._now = chance, 0.0
        self._streams = [(f"d{place}", stream) for place, drive in enumerate(line.polls) for stream in drive]
        self._turn = line.traffic.turn
        self._schedule: Schedule[int] = Schedule(SHARE, 0.5, 2.0, self._turn)
        self._command = chance.uniform(0, COMMANDS[0]) if line.is_commanded else float("inf")
        self._may_lose = chance.uniform(0, LOSS_EVERY)
        self._try_silent(line.silent)
        self._begin()

    def _try_silent(self, count: int) -> None:
        """Try each silent drive once: only later tries keep to their share, and are reckoned."""
        for number in range(count):
            self._schedule.probe(f"s{number}", ASKING, 0.0)
        for _ in range(count):
            found = self._schedule.next(self._now)
            assert isinstance(found, Send)
            self._probe(found.job)

    def _begin(self) -> None:
        begun, drives = self._now, defaultdict[str, list[Job[int]]](list)
        for place, (drive, stream) in enumerate(self._streams):
            due = begun + (self._chance.uniform(0, stream.period) if stream.period else 0.0)
            job = Job(drive, place, stream.period, due, due + (stream.period or self._turn), waits_since=begun)
            drives[drive].append(job)
        for drive, jobs in drives.items():
            self._schedule.set_jobs(drive, jobs)

    def play(self, exchanges: int) -> None:
        """Do so many things."""
        for _ in range(exchanges):
            if self._command <= self._now:
                self._now += COMMANDS[1]
                self._command += COMMANDS[0] * self._chance.choice((1.0, 1.0, 1.3))
                continue
            found = self._schedule.next(self._now)
            if isinstance(found, Send):
                self._send(found)
            elif found is not None:
                self._now = min(found.when, self._command)

    def _probe(self, job: Job[int]) -> None:
        begun, self._now = self._now, self._now + SILENCE
        self._schedule.in_vain(job, begun, self._now)
        self.tries += 1

    def _send(self, found: Send[int]) -> None:
        job = found.job
        if found.is_probe:
            self._probe(job)
        elif job.work == ASKING:
            self._now += WHO
            self._schedule.done(job, self._now)
        elif self._now >= self._may_lose and self._chance.random() < 0.3:
            self._lose(job)
        else:
            self._now += self._streams[job.work][1].cost
            response = self._now - (job.due if job.period else max(0.0, job.waits_since))
            self.latest[job.period or 0.0] = max(self.latest[job.period or 0.0], response)
            self._schedule.done(job, self._now)

    def _lose(self, job: Job[int]) -> None:
        """Lose an exchange: the drive is asked who it is, and else left alone for a while."""
        self._may_lose = self._now + LOSS_EVERY
        self._now += LOST
        self._schedule.done(job, self._now)
        self._schedule.hold(job.drive, self._now + HELD_FOR)
        self._schedule.add(Job(job.drive, ASKING, None, self._now, URGENT))
        self.losses += 1
