"""How one drive is read: who it is, how it is set, then its polls; what an answer means for all of that.

Pure: it is told what was answered or refused, and says what was learnt and what to do next. Before its polls a drive
is set up (`set_up`, `proving`); what is asked of it then is said by `poll_jobs`, and what its answers are worth by
`poll_answers` and `refusals`. They share what is known of the drive (`reading`).
"""

from __future__ import annotations

from collections.abc import Mapping

from gateway.bus.blocks import Planner
from gateway.bus.poll_answers import PollAnswers
from gateway.bus.poll_jobs import PollJobs
from gateway.bus.proving import Proving
from gateway.bus.reading import Reading
from gateway.bus.refusals import Refusals
from gateway.bus.set_up import SetUp
from gateway.bus.work import Learnt, Task, Work
from gateway.control.carrying import Form
from gateway.errors import Refused
from gateway.protocol.pdu import Identity, Reply, Words, Written
from gateway.site import Drive


class DriveReader:
    """The reading of one drive; place, drives and phases are those of `Reading`."""

    def __init__(
        self,
        drive: Drive,
        planner: Planner,
        place: int = 0,
        drives: int = 1,
        phases: Mapping[float, float] | None = None,
    ) -> None:
        self.reading = reading = Reading(drive, planner, place, drives, phases or {})
        self.jobs = PollJobs(reading)
        self._proving = Proving(reading, self.jobs)
        self._set_up = SetUp(reading, self._proving)
        self._answers = PollAnswers(reading, self.jobs, self._proving, self._set_up)
        self._refusals = Refusals(reading, self.jobs, self._proving, self._set_up)

    # ---- what others look at

    @property
    def facts(self) -> Mapping[str, int]:
        """Return words of how the drive is set, by register name."""
        return self.reading.facts

    @property
    def is_set_up(self) -> bool:
        """Say whether it is polled."""
        return self.reading.is_set_up

    @property
    def is_doubtful(self) -> bool:
        """Say whether somebody answers, and what would tell another model is still to be asked."""
        return self._set_up.is_doubtful

    @property
    def is_reset_needed(self) -> bool:
        """Say whether selectors are set that act only after a reset of the drive."""
        return self.reading.is_reset_needed

    @property
    def described(self) -> Mapping[str, str]:
        """Return who the drive is, in words, for people."""
        return self.reading.who.described(self.reading.facts)

    # ---- its exchange

    @property
    def form(self) -> Form | None:
        """Return the exchange by which commands may go with the block; None where none is proven."""
        return self._proving.trial.form

    @property
    def is_on_trial(self) -> bool:
        """Say whether its exchange is being tried."""
        return self._proving.trial.is_under_way

    def on_stop(self, now: float, written: str) -> Learnt:
        """Take that a stop has written a register while its exchange is being tried."""
        return self._proving.disturbed(now, written)

    def give_up_exchange(self) -> None:
        """Take that the drive has refused its exchange, or not written what it should."""
        self._proving.trial.give_up()

    # ---- what is asked

    def identify(self) -> Work:
        """Return the question who is there."""
        return self.reading.who.ask(is_set_up=self.reading.is_set_up)

    def glance(self) -> Work:
        """Return a read that is always worth its time: the status, or the question who is there."""
        return self.jobs.glance() or self.identify()

    # ---- what comes of it

    def on_reply(self, work: Work, reply: Reply, now: float) -> Learnt:
        """Take an answer."""
        match work.task, reply:
            case Task.IDENTIFY, Identity():
                return self._set_up.identified(reply, now)
            case Task.IDENTIFY, Words(words) if work.read is not None:
                return self._set_up.answers(work.read.registers[0], words[0], now)
            case Task.FACT, Words(words) if work.read is not None:
                return self._set_up.fact(work.read, words, now)
            case ((Task.PROVE_BLOCK | Task.PROVE_SINGLE), Words(words)):
                return self._proving.proven(work, words, now)
            case Task.RECHECK, Words(words) if work.read is not None:
                return self._answers.rechecked(work.read, words, now)
            case ((Task.AUDIT | Task.CONFIRM), Words(words)) if work.read is not None:
                return self._answers.checked(work.read, words)
            case Task.POLL, Words(words) if work.read is not None:
                return self._answers.polled(work.read, words, now)
            case Task.TRIP, Words(words) if work.read is not None:
                return Learnt(work.read.values(words))
            case Task.BLOCK_MODE, Words(words):
                return self._answers.block_mode(words[0], now)
            case Task.DISPLAY, Words(words):
                return self._proving.display_seen(words[0], now)
            case Task.PROVISION, Written() if work.register is not None:
                return self._set_up.provisioned(work.register, now)
            case Task.TRIAL, _:
                return self._proving.tried(work, reply, now)
        return Learnt()

    def on_refused(self, work: Work, refused: Refused, now: float) -> Learnt:
        """Take a refusal."""
        return self._refusals.refused(work, refused, now)

    def on_silence(self, work: Work, now: float) -> Learnt:
        """Take that a poll was not answered."""
        return self._refusals.unanswered(work, now)

    def forget(self) -> None:
        """Forget all that a reset or another drive may have changed; the mapping in force stays a candidate."""
        self.reading.forget()
        self._proving.trial.forget()
