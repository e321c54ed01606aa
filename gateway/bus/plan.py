"""How one drive is read before anything is known of it: as it is shipped, or with the best block selectors set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gateway.bus import selectors
from gateway.bus.blocks import Abilities, PlannedRead, Planner
from gateway.bus.poll_jobs import PollJobs
from gateway.bus.reading import BLOCK_MODE, Reading
from gateway.bus.schedule import Job
from gateway.bus.work import Work
from gateway.protocol.pdu import ReadBlock
from gateway.site import Drive, Line, PollGroup

QUICK = 0.005  # seconds for a drive to answer: well below what the manuals promise


@dataclass(frozen=True, slots=True)
class DrivePlan:
    """How one drive is read: its groups with their reads, and the selectors that this supposes; all its jobs."""

    drive: Drive
    planner: Planner
    selectors: tuple[int, ...]
    groups: Sequence[tuple[PollGroup, tuple[PlannedRead, ...]]]
    jobs: Sequence[Job[Work]]

    @property
    def load(self) -> float:
        """Return the share of the line that the timed groups take."""
        return sum(self.planner.time(reads) / group.period for group, reads in self.groups if group.period)

    @property
    def round(self) -> float:
        """Return how many seconds of wire one round of the groups without a period takes."""
        return sum(self.planner.time(reads) for group, reads in self.groups if not group.period)

    @property
    def uses_block(self) -> bool:
        """Say whether the indirect block is read."""
        return any(isinstance(read.request, ReadBlock) for _, reads in self.groups for read in reads)


def exchanges(plans: Sequence[DrivePlan]) -> float:
    """Return how many exchanges a second polling comes to on one line, with drives that are quick to answer."""
    quick = [replace(plan, planner=replace(plan.planner, processing=QUICK)) for plan in plans]
    timed = sum(len(reads) / group.period for plan in quick for group, reads in plan.groups if group.period)
    load, turn = sum(plan.load for plan in quick), sum(plan.round for plan in quick)
    if load >= 1.0:
        return timed / load
    count = sum(len(reads) for plan in quick for group, reads in plan.groups if not group.period)
    return timed + (count * (1.0 - load) / turn if turn else 0.0)


def plan_drive(drive: Drive, line: Line, *, with_selectors: bool) -> DrivePlan:
    """Plan a drive as it is shipped (no selectors set), or with the best selectors set."""
    processing = drive.model.times.processing + drive.wait_time
    planner = Planner(drive.number, drive.model, drive.codec, line.timing, processing)
    reading = Reading(drive, planner, drives=len(line.drives))
    codes = selectors.best(drive) if with_selectors and planner.has_block else ()
    reading.able = Abilities(mapping=selectors.mapping_of(drive.model, codes))
    reading.facts = dict.fromkeys({BLOCK_MODE} & drive.model.registers.keys(), 0)
    jobs = PollJobs(reading)
    return DrivePlan(drive, planner, codes, jobs.plan(), jobs.polls(0.0))
