"""The last part of a drive's set-up: its block is proved, or given up, and its polls begin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gateway.bus.poll_jobs import PollJobs
from gateway.bus.reading import BLOCK_MODE, DISPLAY_NOTE, Reading
from gateway.bus.trial import Trial
from gateway.bus.work import Learnt, Task, Work
from gateway.errors import Refused
from gateway.protocol.pdu import ReadWords, Reply

SILENT_BLOCKS = 3  # block reads without an answer while other questions have one, before the block is given up
NOT_IN_FORCE = "the block does not carry what F875-F879 say: a changed selector acts only after a reset of the drive"


class Proving:
    """Tries the mappings that may be in force, one step at a time."""

    def __init__(self, reading: Reading, jobs: PollJobs) -> None:
        self._reading = reading
        self._jobs = jobs
        self.trial = Trial(reading, jobs)

    def start(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        """Begin with what the selectors say, or with what was in force before they were written."""
        reading = self._reading
        reading.as_set = as_set = reading.mapping_as_set()
        reading.proof.begin()
        if reading.provision.awaits_reset(reading.facts):  # what is set is known not to be in force
            reading.proof.candidates.clear()
            reading.proof.propose(reading.before)
        else:
            reading.proof.propose(as_set)
        if reading.facts.get(BLOCK_MODE) == 1:
            reading.proof.candidates.clear()
            learnt = self.start_polls(now, [*notes, DISPLAY_NOTE])
        else:
            learnt = self.next(now, notes)
        if reading.is_reset_needed:
            learnt.warnings.append("reset needed: F875-F879 were set and act after a reset (switch it off and on)")
        return learnt

    def next(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        """Try the next mapping that may be in force."""
        step = self._reading.proof.next(self._reading.able)
        if step is None:
            return self.start_polls(now, notes)
        return Learnt(jobs=[self._reading.at_once(step, now)], notes=list(notes))

    def proven(self, work: Work, words: Sequence[int], now: float) -> Learnt:
        """Take the words of a step."""
        reading = self._reading
        is_right = reading.proof.take(work, words)
        reading.silent_blocks = 0
        if is_right:
            reading.able = replace(reading.able, mapping=reading.proof.proven)
            if reading.able.mapping == reading.as_set:
                reading.provision.in_force()
        if is_right is False and BLOCK_MODE in reading.drive.model.registers:
            address = reading.drive.model.registers[BLOCK_MODE].address
            look = Work(Task.DISPLAY, ReadWords(reading.drive.number, address))
            return Learnt(jobs=[reading.at_once(look, now)])
        learnt = self.next(now)
        if is_right is False:
            learnt.warnings.append(NOT_IN_FORCE)
        return learnt

    def display_seen(self, word: int, now: float) -> Learnt:
        """Judge a block that did not agree: it may have carried the display's text (FA80 = 1)."""
        if word != 1:
            learnt = self.next(now)
            learnt.warnings.append(NOT_IN_FORCE)
            return learnt
        self._reading.facts[BLOCK_MODE] = 1
        self._reading.proof.begin()
        self._reading.proof.candidates.clear()
        return self.start_polls(now, [DISPLAY_NOTE])

    def unanswered(self, now: float) -> Learnt | None:
        """Take that its block read had no answer, though the drive is there: given up after some; None before."""
        self._reading.silent_blocks += 1
        if self._reading.silent_blocks < SILENT_BLOCKS:
            return None
        self._reading.proof.candidates.clear()  # the TOSHIBA protocol has no other way to say that X is unknown
        return self.start_polls(now, ["the block is not answered; other reads instead"])

    def start_polls(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        """End the set-up: once the exchange is tried, where commands are to go by it, the drive is ready."""
        said = self.trial.begin()
        return self._go_on([*notes, said] if said else notes, now)

    def _go_on(self, notes: Sequence[str], now: float) -> Learnt:
        was_tried, step = self.trial.is_under_way, self.trial.next()
        if step is not None:
            return Learnt(jobs=[self._reading.at_once(step, now)], notes=list(notes))
        self._reading.is_set_up = True
        self._reading.pending = None
        warnings = [self.trial.said] if was_tried and self.trial.said else []
        return Learnt(jobs=self._jobs.polls(now), is_ready=True, notes=list(notes), warnings=warnings)

    # ---- the trial of its exchange

    def tried(self, work: Work, reply: Reply, now: float) -> Learnt:
        """Take the answer to a frame of the trial."""
        self.trial.answered(work, reply)
        return self._after(now)

    def trial_refused(self, work: Work, refused: Refused, now: float) -> Learnt:
        """Take a refusal of such a frame."""
        self.trial.refused(work, refused)
        return self._after(now)

    def trial_unanswered(self, now: float) -> Learnt:
        """Take that such a frame had no answer, though the drive is there."""
        self.trial.unanswered()
        return self._after(now)

    def disturbed(self, now: float, written: str) -> Learnt:
        """Take that a stop has written a register while the exchange was tried."""
        self.trial.disturbed(written)
        return self._after(now)

    def _after(self, now: float) -> Learnt:
        """Go on with the trial, or say what came of it."""
        learnt = self._go_on((), now)
        if learnt.is_ready and self.trial.said:
            learnt.warnings = [self.trial.said]
        return learnt
