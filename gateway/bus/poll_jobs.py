"""What is asked of a drive that is set up: its polls, the checks that keep its block honest, and reads at need."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from gateway.bus import selectors
from gateway.bus.blocks import PlannedRead
from gateway.bus.provision import RESET_MARK
from gateway.bus.reading import BLOCK_MODE, Reading
from gateway.bus.schedule import Job, on_grid, spread
from gateway.bus.work import Learnt, Task, Work
from gateway.control.carrying import Form, selected
from gateway.protocol.pdu import ReadBlock
from gateway.site import Drive, PollGroup

FIRST_WITHIN = 0.5  # seconds after a drive is ready, for values that are read seldom
RECHECK_EVERY = 60.0  # seconds between two looks at F875-F879, which somebody may change at the panel
RECHECK_SOON = 5.0  # the same while a reset is awaited, or while the block carries the display's text
TRIP_REGISTERS = ("trip_code", "status")  # FC90, FD01: what is read at once when a drive trips or no longer does


def phases(drives: Sequence[Drive]) -> dict[str, dict[float, float]]:
    """Return by drive and period which part of the period its polls are shifted by: evenly, whoever else there is."""
    found: dict[str, dict[float, float]] = {drive.name: {} for drive in drives}
    for period in {group.period for drive in drives for group in drive.groups}:
        having = [drive for drive in drives if any(group.period == period for group in drive.groups)]
        for place, drive in enumerate(having):
            found[drive.name][period] = place / len(having)
    return found


class PollJobs:
    """The jobs of one drive, as far as is known what it can do."""

    def __init__(self, reading: Reading) -> None:
        self._reading = reading
        self._drive = reading.drive
        self._planner = reading.planner
        self._phase = reading.place / reading.drives

    # ---- again and again

    def plan(self) -> list[tuple[PollGroup, tuple[PlannedRead, ...]]]:
        """Plan every poll group, the fastest first; what a faster group's block brings is not asked again."""
        planned = []
        brought: set[str] = set()
        for group in sorted(self._drive.groups, key=lambda group: group.period):
            wanted = [r for r in group.registers if r.name not in brought | self._reading.absent]
            reads = self._planner.plan(wanted, self._reading.able) if wanted else ()
            brought |= {register.name for read in reads for register in read.registers}
            planned.append((group, reads))
        return planned

    def polls(self, now: float) -> list[Job[Work]]:
        """Return the jobs of this drive, spread over their periods."""
        jobs = []
        phases = self._reading.phases
        for group, reads in self.plan():
            offsets = spread(len(reads), group.period, phases.get(group.period, self._phase))
            for read, offset in zip(reads, offsets, strict=True):
                due = on_grid(offset, group.period, now) if group.period else now
                work = Work(Task.POLL, read.request, read)
                jobs.append(Job(self._drive.name, work, group.period, due, due + group.period, waits_since=now))
                if due > now + FIRST_WITHIN:  # its place on the grid is far: the first value comes before
                    jobs.append(Job(self._drive.name, work, None, now, now + FIRST_WITHIN))
        return jobs + self._checks(now, jobs)

    def _checks(self, now: float, jobs: Iterable[Job[Work]]) -> list[Job[Work]]:
        """Return the jobs that keep the mapping honest, where the block is in use."""
        reading = self._reading
        blocks = [job.work.read for job in jobs if isinstance(job.work.request, ReadBlock)]
        checks = []
        if blocks and blocks[0] is not None:
            carried = enumerate(blocks[0].carries)
            watched = tuple((i, r) for i, r in carried if r is not None and r.name in self._drive.points)
            proven = {r.name for _, r in watched if reading.proof.singles.get(r.name, 0) & r.mask}
            as_set = reading.as_set or ()
            settled = {r.name for i, r in watched if i < len(as_set) and as_set[i] is r}
            unsettled = frozenset(r.name for _, r in watched) - settled
            reading.audit = selectors.Audit(watched, proven, unsettled)
            checks.append(self._audit_job(reading.audit, now))
        return checks + self._rechecks(now)

    def _rechecks(self, now: float) -> list[Job[Work]]:
        """Return the looks at what somebody else may change: the selectors, FA80, and FA87 while it matters."""
        facts = self._reading.facts
        is_awaited = self._reading.provision.awaits_reset(facts)
        names = [BLOCK_MODE, RESET_MARK] if is_awaited else [BLOCK_MODE]
        registers = [self._drive.model.registers[name] for name in names if name in facts]
        registers += self._reading.selector_registers()
        if not self._planner.has_block or not registers:
            return []
        is_soon = is_awaited or facts.get(BLOCK_MODE) == 1
        every = RECHECK_SOON if is_soon else RECHECK_EVERY
        reads = self._planner.plan(registers, replace(self._reading.able, mapping=None))
        jobs = []
        for read, offset in zip(reads, spread(len(reads), every), strict=True):
            due = now + every + offset
            jobs.append(Job(self._drive.name, Work(Task.RECHECK, read.request, read), every, due, due + every))
        return jobs

    def _audit_job(self, audit: selectors.Audit, now: float) -> Job[Work]:
        read = self._reading.alone(audit.next())
        every = audit.every
        if every >= selectors.UNPROVEN_EVERY:  # nothing disagrees: the checks of all drives keep to their share
            every = max(every, self._reading.drives * self._planner.cost(read.request) / selectors.AUDIT_SHARE)
        due = now + every
        return Job(self._drive.name, Work(Task.AUDIT, read.request, read), None, due, due + every)

    def follow_up(self, work: Work, now: float) -> Job[Work] | None:
        """Return what comes some time after a piece of work: the next audit after an audit."""
        audit = self._reading.audit
        return self._audit_job(audit, now) if work.task is Task.AUDIT and audit is not None else None

    # ---- its exchange

    def exchange(self) -> Form | None:
        """Return the exchange of a block poll with what F870 and F871 select; None where there is none."""
        drive, model, forms = self._drive, self._drive.model, self._drive.codec.forms
        if not (drive.block_write and forms.has_exchange and model.blocks.has_exchange):
            return None
        connector = model.connector()
        codes = [self._reading.facts.get(name) for name in (connector.block_write if connector else ())]
        requests = (read.request for _, reads in self.plan() for read in reads)
        block = next((request for request in requests if isinstance(request, ReadBlock)), None)
        if block is None:
            return None
        return Form(block, model.blocks.indirect_write_address, selected(codes, model.write_selectors))

    # ---- at need

    def on_trip(self) -> Learnt:
        """Return what is to be read at once when the drive has tripped, or no longer is."""
        registers = self._drive.model.registers
        reads = [self._reading.alone(registers[name]) for name in TRIP_REGISTERS if name in registers]
        return Learnt(once=[Work(Task.TRIP, read.request, read) for read in reads])

    def glance(self) -> Work | None:
        """Return a read that is always worth its time, the status; None where the drive does not tell it."""
        status = self._drive.model.registers.get(TRIP_REGISTERS[-1])
        if status is None or status.name in self._reading.absent:
            return None
        read = self._reading.alone(status)
        return Work(Task.TRIP, read.request, read)
