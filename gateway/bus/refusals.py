"""What a refusal means to the reading of a drive, or a poll without an answer: the values are served another way."""

from __future__ import annotations

from dataclasses import replace

from gateway.bus.blocks import PlannedRead
from gateway.bus.poll_jobs import PollJobs
from gateway.bus.proving import SILENT_BLOCKS, Proving
from gateway.bus.reading import Reading
from gateway.bus.set_up import SetUp, no_direct
from gateway.bus.work import Learnt, Task, Work
from gateway.drives.register import Register
from gateway.errors import Refusal, Refused
from gateway.protocol.pdu import ReadBlock, ReadWords

BUSY_BLOCKS = 3  # refusals of the block in a row because the drive cannot do it now, before it is given up
REFUSALS = 2  # in a row, before a value is given up


class Refusals:
    """Remembers what a drive refuses."""

    def __init__(self, reading: Reading, jobs: PollJobs, proving: Proving, set_up: SetUp) -> None:
        self._reading = reading
        self._jobs = jobs
        self._proving = proving
        self._set_up = set_up

    def refused(self, work: Work, refused: Refused, now: float) -> Learnt:
        """Take a refusal of what was sent: remember it, and serve the values another way."""
        reading = self._reading
        match work:
            case Work(Task.IDENTIFY):
                reading.who.refused(work, refused.reason)
                return Learnt(is_ready=True) if reading.is_set_up else self._set_up.begin(now)
            case Work(Task.PROVISION, register=Register() as register):
                return self._set_up.not_provisioned(register, refused, now)
            case Work(Task.TRIAL):
                return self._proving.trial_refused(work, refused, now)
            case Work(Task.DISPLAY):
                return self._proving.display_seen(0, now)
            case Work(Task.TRIP | Task.BLOCK_MODE):
                return Learnt()
            case Work(Task.PROVE_BLOCK | Task.PROVE_SINGLE):
                reading.proof.drop()
                return self._proving.next(now)
            case Work(Task.FACT, read=PlannedRead() as read):
                return self._set_up.fact_refused(read, refused, now)
            case Work(request=ReadBlock()):
                return self._block_refused(refused, now)
            case Work(request=ReadWords(count=count)) if count > 1:
                return Learnt(notes=[no_direct(reading, work.request, refused)], jobs=self._jobs.polls(now))
            case Work(Task.POLL, read=PlannedRead() as read) if refused.reason is not Refusal.UNABLE:
                return self._poll_refused(read.registers[0].name, refused, now)
        return Learnt()

    def _block_refused(self, refused: Refused, now: float) -> Learnt:
        """Give the block up; a drive that is only busy is asked again."""
        reading = self._reading
        reading.busy_blocks += 1
        if refused.reason is Refusal.UNABLE and reading.busy_blocks < BUSY_BLOCKS:
            return Learnt()
        reading.able = replace(reading.able, mapping=None)
        return Learnt(jobs=self._jobs.polls(now), notes=[f"indirect block: {refused}"])

    def _poll_refused(self, name: str, refused: Refused, now: float) -> Learnt:
        """Give a value up once it was refused twice in a row: the first may be a request damaged on its way."""
        reading = self._reading
        reading.refusals[name] += 1
        if reading.refusals[name] < REFUSALS:
            return Learnt()
        reading.absent.add(name)
        return Learnt(jobs=self._jobs.polls(now), warnings=[f"{name}: {refused}; it is not read any more"])

    def unanswered(self, work: Work, now: float) -> Learnt:
        """Take that a poll was not answered: a block is given up after some in a row, though the drive is there."""
        reading = self._reading
        if work.task is not Task.POLL or not isinstance(work.request, ReadBlock) or reading.able.mapping is None:
            return Learnt()
        reading.silent_polls += 1
        if reading.silent_polls < SILENT_BLOCKS:
            return Learnt()
        reading.silent_polls = 0
        reading.able = replace(reading.able, mapping=None)
        notes = ["the block is not answered any more; other reads instead"]
        return Learnt(jobs=self._jobs.polls(now), notes=notes)
