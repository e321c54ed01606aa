"""What the line carries next: earliest deadline first, silent drives within their share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

Work = TypeVar("Work")
AHEAD = float("-inf")  # deadline of what goes before everything else


@dataclass(slots=True, eq=False)
class Job(Generic[Work]):
    """Something to be done for one drive again and again, or once (`period` None).

    `due` is when it may start, `deadline` when it should have been done; both monotonic seconds.
    A period of 0 means as often as the line allows: `due` is then when the next run is promised, and `waits_since`
    when it may be done if the line is free.
    """

    drive: str
    work: Work
    period: float | None
    due: float
    deadline: float
    waits_since: float = float("-inf")
    on_grid: float | None = None  # when it was due before it was held: its place among the others

    def may_begin(self, now: float) -> bool:
        """Say whether it may be done, urgent or not."""
        return self.waits_since <= now if self.period == 0 else self.due <= now


@dataclass(frozen=True, slots=True)
class Send(Generic[Work]):
    """Do this now."""

    job: Job[Work]
    is_probe: bool = False


@dataclass(frozen=True, slots=True)
class NotBefore:
    """Nothing is due before that time."""

    when: float


@dataclass(slots=True)
class _Probe(Generic[Work]):
    job: Job[Work]
    interval: float
    is_untried: bool = True


@dataclass(slots=True)
class Schedule(Generic[Work]):
    """The jobs of one line.

    Polls run earliest deadline first and without preemption. Jobs with period 0 are promised one run each in a
    `turn`, with that deadline; whatever else is free is theirs as well. The one that waits longest goes first.
    Probes of silent drives go ahead of polls, but after the first one of each only as often as
    `silent_share` of the line pays for.
    """

    silent_share: float
    probe_every: float
    probe_at_most: float
    turn: float = 0.1
    _jobs: dict[str, list[Job[Work]]] = field(default_factory=dict)
    _probes: dict[str, _Probe[Work]] = field(default_factory=dict)
    _probing_allowed: float = float("-inf")
    _suspended: set[str] = field(default_factory=set)

    def suspend(self, drive: str) -> None:
        """Do nothing at all for a drive until `resume`."""
        self._suspended.add(drive)

    def resume(self, drive: str) -> None:
        """Go on with a drive; what fell due meanwhile is due now."""
        self._suspended.discard(drive)

    def set_jobs(self, drive: str, jobs: Iterable[Job[Work]]) -> None:
        """Replace all that is done for a drive; it is no longer probed."""
        self._probes.pop(drive, None)
        self._jobs[drive] = list(jobs)

    def add(self, job: Job[Work]) -> None:
        """Add a job for a drive that has some."""
        self._jobs.setdefault(job.drive, []).append(job)

    def hold(self, drive: str, until: float) -> None:
        """Let nothing be done for a drive before that time, but what is ahead of everything."""
        for job in self._jobs.get(drive, ()):
            if job.period == 0:
                job.waits_since = max(job.waits_since, until)
            elif job.deadline != AHEAD and job.due < until:
                job.on_grid = job.due if job.on_grid is None else job.on_grid
                job.due = until
                job.deadline = max(job.deadline, until)

    def remove(self, job: Job[Work]) -> None:
        """Drop a job."""
        self._jobs[job.drive].remove(job)

    def most_urgent(self, drive: str, now: float) -> Job[Work] | None:
        """Return the job of a drive that may be done and has the earliest deadline."""
        due = (job for job in self._jobs.get(drive, ()) if job.may_begin(now))
        return min(due, key=lambda job: job.deadline, default=None)

    def has_overdue(self, now: float) -> bool:
        """Say whether a poll that may be done should have been done by now."""
        return any(
            job.deadline < now and job.deadline != AHEAD and job.may_begin(now)
            for drive, jobs in self._jobs.items()
            if drive not in self._suspended
            for job in jobs
        )

    def jobs(self, drive: str) -> tuple[Job[Work], ...]:
        """Return the jobs of a drive."""
        return tuple(self._jobs.get(drive, ()))

    def probe(self, drive: str, work: Work, when: float) -> None:
        """Stop polling a drive and try it now and then, the first time at `when`."""
        self._jobs.pop(drive, None)
        self._probes[drive] = _Probe(Job(drive, work, None, when, when), self.probe_every)

    def is_probed(self, drive: str) -> bool:
        """Say whether a drive is only probed."""
        return drive in self._probes

    def next(self, now: float) -> Send[Work] | NotBefore | None:
        """Say what the line should carry next; None when nothing is planned at all."""
        probe_at = float("inf")
        if self._probes:
            probe = min(self._probes.values(), key=lambda p: (self._probe_time(p), p.job.due))
            probe_at = self._probe_time(probe)
            if probe_at <= now:
                return Send(probe.job, is_probe=True)
        best: Job[Work] | None = None  # of what is due, that with the earliest deadline
        longest: Job[Work] | None = None  # of those without a period, that which waits longest
        earliest = probe_at
        for drive, jobs in self._jobs.items():
            if drive in self._suspended:
                continue
            for job in jobs:
                if job.period == 0:
                    if job.waits_since > now:
                        earliest = min(earliest, job.waits_since)
                        continue
                    if longest is None or job.waits_since < longest.waits_since:
                        longest = job
                if job.due <= now:
                    if best is None or job.deadline < best.deadline:
                        best = job
                elif job.period != 0:
                    earliest = min(earliest, job.due)
        if longest is not None and (best is None or best.period == 0):
            return Send(longest if best is None else _instead(best, longest))
        if best is not None:
            return Send(best)
        return None if earliest == float("inf") else NotBefore(earliest)

    def _probe_time(self, probe: _Probe[Work]) -> float:
        """Return when a probe may go: the first of each drive at its time, later ones when the share allows."""
        if probe.is_untried or not any(self._jobs.values()):
            return probe.job.due
        return max(probe.job.due, self._probing_allowed)

    def in_vain(self, job: Job[Work], begun: float, now: float) -> None:
        """Take note that a probe met silence: the next one, of whatever drive, waits until its cost is paid."""
        self._probing_allowed = begun + (now - begun) / self.silent_share
        probe = self._probes.get(job.drive)
        if probe is not None and probe.job is job:
            probe.is_untried = False
            job.due = now + probe.interval
            probe.interval = min(2 * probe.interval, self.probe_at_most)

    def done(self, job: Job[Work], now: float) -> None:
        """Take note that a job was carried out: drop it, or set its next time on the grid of its period."""
        if job.period is None:
            if job in self._jobs.get(job.drive, ()):
                self.remove(job)
        elif job.period == 0:
            job.waits_since = now
            if job.due <= now:
                job.due = max(now, job.deadline)
                job.deadline = job.due + self.turn
        else:
            begun, job.on_grid = job.due if job.on_grid is None else job.on_grid, None
            missed = int(max(0.0, now - begun) / job.period)
            job.due = begun + (missed + 1) * job.period
            job.deadline = job.due + job.period


def _instead(due: Job[Work], longest: Job[Work]) -> Job[Work]:
    """Let the job that waits longest have the run that is promised now, and the other one its own."""
    due.due, longest.due = longest.due, due.due
    due.deadline, longest.deadline = longest.deadline, due.deadline
    return longest


def spread(count: int, period: float, phase: float = 0.0) -> list[float]:
    """Return offsets that lay `count` jobs of one period evenly over it.

    `phase` (0 to 1) shifts them between each other: where each of several drives has one of its own, evenly spread,
    their jobs do not fall on each other.
    """
    return [(index + phase) * period / count for index in range(count)]


def on_grid(offset: float, period: float, now: float) -> float:
    """Return the next time from now on that is `offset` behind a multiple of the period, whenever a drive joins."""
    return now + (offset - now) % period
