"""One command on its way to a drive: which frame comes next, and what its end is (SAFETY.md H09-H11, H22).

Pure: it is told what was answered, refused or not answered, and asks for nothing itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from gateway.control.admission import EXECUTIVE
from gateway.control.command import Answer, Command, Reason, Result, Status, Verb
from gateway.control.composing import COMMAND, has_bit, runs
from gateway.control.writes import PlannedWrite
from gateway.errors import Refusal, Refused
from gateway.protocol.pdu import ReadWords, Reply, Request, Words

STRONGER = ("coast", "emergency_stop")  # bits of FA00, each a stronger stop than the ones before
READ_BACKS = 2  # reads without an answer, before the outcome is called unknown
SILENT_STOPS = 3  # writes of a stop without an answer in a row: then the drive's own F803 has to act
VAIN_STOPS = 5  # stops that were answered and yet do not read back, or were refused for now
READING_LATER = 1.0  # seconds beyond the deadline in which a write that was sent may still be read back


class Phase(Enum):
    """How far a command is."""

    COMPARING = "comparing"  # reading what a stored parameter holds: an equal value is not written
    RESERVING = "reserving"  # the write to the EEPROM is being counted, for good, before it is sent
    WRITING = "writing"
    VERIFYING = "verifying"
    OVER = "over"


@dataclass(slots=True, eq=False)
class Execution:
    """The frames of one command, one after another: compare and count (EEPROM only), write, read back.

    A write without an answer is not repeated: reading back tells what became of it. `is_stop` is written again
    until it is answered, with no read in between, since a read would keep the drive's F803 from acting; then it is
    read back. `was_announced`: every drive was told by one broadcast, and it may only have to be read back.
    `beside` is what of the words beside a stop is not written, and why: the stop is carried out, and then that told.
    """

    command: Command
    writes: Sequence[PlannedWrite]
    answer: Answer
    is_stop: bool = False
    was_announced: bool = False
    phase: Phase = Phase.WRITING
    was_sent: bool = False
    is_begun: bool = False
    is_reserving: bool = False
    before: dict[str, int] = field(default_factory=dict)
    read_back: dict[str, int] = field(default_factory=dict)
    status: Status | None = None
    joined: list[tuple[Command, Answer]] = field(default_factory=list)  # equal stops that came meanwhile
    beside: tuple[Reason, str] = (Reason.NONE, "")
    is_alone: bool = False  # no frame carries it together with other things
    batch: int = 1  # writes that the frame which is leaving now carries
    _was_sent_before: bool = False  # before that frame
    _place: int = 0
    _on_its_way: int = 0  # writes before this place were sent
    _silent: str = ""
    _silences: int = 0
    _vain: int = 0

    def __post_init__(self) -> None:
        self.phase = Phase.VERIFYING if self.was_announced else self._first_phase

    @property
    def is_over(self) -> bool:
        """Say whether its result has been given."""
        return self.phase is Phase.OVER

    @property
    def is_done(self) -> bool:
        """Say whether it was done, and read back."""
        return self.status is Status.DONE

    @property
    def write(self) -> PlannedWrite:
        """Return the write that it is at."""
        return self.writes[self._place]

    @property
    def ahead(self) -> Sequence[PlannedWrite]:
        """Return the writes that are left, the one that it is at first."""
        return self.writes[self._place :]

    @property
    def _first_phase(self) -> Phase:
        """Return what a write begins with; one that has gone with another in one frame is only read back."""
        if self._place < self._on_its_way:
            return Phase.VERIFYING
        return Phase.COMPARING if self.write.wears_eeprom else Phase.WRITING

    @property
    def is_insistent(self) -> bool:
        """Say whether it is at the stop itself, which is written until it is read back."""
        return self.is_stop and self._place == 0

    @property
    def strength(self) -> int:
        """Return how strong a stop is: 0 slows down, 1 lets the motor coast, 2 trips the drive; -1: it is none."""
        write = next((write for write in self.writes if write.register.name == COMMAND), None)
        if not self.is_stop or write is None:
            return -1
        found = [n for n, name in enumerate(STRONGER, 1) if has_bit(write.register, write.word, name)]
        return max(found, default=0)

    def taken_over(self) -> Sequence[tuple[Command, Answer]]:
        """Give no result any more; return who waits for one."""
        waiting = [(self.command, self.answer), *self.joined]
        self.phase, self.joined = Phase.OVER, []
        return waiting

    @property
    def has_stopped(self) -> bool:
        """Say whether the drive was seen to have taken the stop."""
        return self.is_stop and (self.is_done or self._place > 0)

    @property
    def not_after(self) -> float:
        """Return until when its next frame may be sent, in monotonic seconds: reading back may be later."""
        is_writing = self.phase is Phase.WRITING and not self.is_insistent
        return self.command.deadline if is_writing else math.inf

    @property
    def is_at_motion(self) -> bool:
        """Say whether the frame that is sent may set a motor in motion, or change its speed."""
        is_writing = self.phase is Phase.WRITING and not self.is_stop
        return is_writing and any(write.may_start for write in self.ahead[: self.batch])

    @property
    def is_for_armed(self) -> bool:
        """Say whether it is one that only an armed drive is given."""
        is_run_word = any(w.register.name == COMMAND and runs(w.register, w.word) for w in self.writes)
        return self.command.verb in (*EXECUTIVE, Verb.ARM) or is_run_word

    @property
    def is_to_be_counted(self) -> bool:
        """Say whether its next write has to be counted for good before it may be sent."""
        return self.phase is Phase.RESERVING

    @property
    def is_acknowledged(self) -> bool:
        """Say whether the drive has answered to the write, so that reading it back is next."""
        return self.phase is Phase.VERIFYING

    def plan(self, writes: Sequence[PlannedWrite]) -> None:
        """Take what it comes to now that it is its turn."""
        self.writes, self.is_begun = writes, True
        if not self.is_over:
            self.phase = Phase.VERIFYING if self.was_announced else self._first_phase

    def announced(self) -> None:
        """Take note that a broadcast has told it to the drive already."""
        self.was_announced = True
        self.phase = Phase.VERIFYING

    def next(self, now: float) -> Request | None:
        """Return the next frame; None when it is over, waits to be counted, or is too late."""
        self.look_at(now)
        self.batch = 1
        if self.phase in (Phase.OVER, Phase.RESERVING):
            return None
        if self.phase is Phase.WRITING:
            return self.write.request
        return ReadWords(self.write.request.number, self.write.register.address)

    def look_at(self, now: float) -> None:
        """End it where its deadline has passed: nothing is written later."""
        if self.is_over or self.is_insistent or now <= self.command.deadline:
            return
        if self.phase is Phase.VERIFYING:
            if now > self.command.deadline + READING_LATER:
                self.finish(Status.UNKNOWN, Reason.EXPIRED, "it was not read back in time")
        elif self.was_sent:
            done = ", ".join(write.register.name for write in self.writes[: self._place])
            self.finish(Status.FAILED, Reason.EXPIRED, f"too late for {self.write.register.name}; written: {done}")
        else:
            self.finish(Status.REFUSED, Reason.EXPIRED, "its deadline passed before it could be sent")

    def reserved(self, problem: str = "") -> None:
        """Take note that the write is counted, or why it cannot be."""
        if self.phase is not Phase.RESERVING:
            return
        if problem:
            self.finish(Status.FAILED if self.was_sent else Status.REFUSED, Reason.NO_STORE, problem)
        else:
            self.phase = Phase.WRITING

    def sending(self) -> None:
        """Take note that the frame of `next` leaves now."""
        self._was_sent_before = self.was_sent
        if self.phase is Phase.WRITING:
            self.was_sent, self._on_its_way = True, self._place + self.batch

    def undone(self, now: float) -> None:
        """Take that the frame did nothing: the line was not free in time, or the drive has no such exchange."""
        self.was_sent, self._on_its_way = self._was_sent_before, self._place
        self.look_at(now)

    def on_reply(self, reply: Reply | None) -> None:
        """Take an answer; None where no answer was to be expected."""
        self._silences = 0
        if self.is_over:
            return
        if self.phase is Phase.WRITING:
            self.phase = Phase.VERIFYING
        elif isinstance(reply, Words):
            self._on_word(reply.words[0])

    def _on_word(self, word: int) -> None:
        name = self.write.register.name
        is_equal = self.write.reads_back(word)
        if self.phase is Phase.COMPARING:
            self.before[name] = word & self.write.register.mask
            if is_equal:
                self.read_back[name] = word & self.write.register.mask
                self._next_write()
            else:
                self.phase = Phase.RESERVING
            return
        self.read_back[name] = word & self.write.register.mask
        if is_equal:
            self._next_write()
        elif self.is_insistent:
            self._in_vain(Reason.NOT_READ_BACK, f"{name} reads {word:04X}H")
        elif self._silent:
            text = f"{self._silent}; {name} reads {word:04X}H: not done{self._sent_with_it}"
            self.finish(Status.FAILED, Reason.NO_ANSWER, text)
        else:
            self.finish(Status.FAILED, Reason.NOT_READ_BACK, f"{name} reads {word:04X}H{self._sent_with_it}")

    @property
    def _sent_with_it(self) -> str:
        """Say which writes went in the same frame as the one that it is at, and are not read back any more."""
        others = [write.register.name for write in self.writes[self._place + 1 : self._on_its_way]]
        return f"; {', '.join(others)} was sent with it" if others else ""

    def _in_vain(self, reason: Reason, text: str) -> None:
        """Write a stop again, but not for ever."""
        self._vain += 1
        self.phase = Phase.WRITING
        if self._vain >= VAIN_STOPS:
            self.finish(Status.FAILED, reason, text)

    def _next_write(self) -> None:
        self._silences = 0
        if self._place + 1 < len(self.writes):
            self._place += 1
            self.phase = self._first_phase
            self._silent = self._silent if self._place < self._on_its_way else ""
        else:
            self.finish(Status.DONE)

    def on_tripped(self) -> None:
        """Take that the drive is tripped: an emergency stop has then been obeyed, whatever FA00 reads."""
        if self.is_stop and self.was_sent | self.was_announced and not self.is_over:
            self.finish(Status.DONE, Reason.NONE, "the drive is tripped")

    def on_refused(self, refused: Refused) -> None:
        """Take a refusal."""
        self._silences = 0
        if self.is_over:
            return
        if self.phase is Phase.VERIFYING:  # it can be written but not read
            self._next_write()
        elif self.phase is Phase.COMPARING:
            self.phase = Phase.RESERVING
        elif self.is_insistent and refused.reason is Refusal.UNABLE:
            self._in_vain(Reason.REFUSED_BY_DRIVE, refused.reason.value)
        else:
            self.finish(Status.FAILED, Reason.REFUSED_BY_DRIVE, f"{self.write.register.name}: {refused.reason.value}")

    def on_silence(self, text: str) -> None:
        """Take silence or garbage: a write may have been done, which reading back tells."""
        self._silences += 1
        if self.is_over:
            return
        if self.is_insistent:
            self.phase = Phase.WRITING
            if self._silences >= SILENT_STOPS:
                self.finish(Status.UNKNOWN, Reason.NO_ANSWER, text)
        elif self.phase is Phase.WRITING:
            self._silent, self._silences = text, 0
            self.phase = Phase.VERIFYING
        elif self._silences >= READ_BACKS:
            status = Status.UNKNOWN if self.was_sent else Status.REFUSED
            self.finish(status, Reason.NO_ANSWER, text)

    def finish(self, status: Status, reason: Reason = Reason.NONE, text: str = "") -> None:
        """Give the one result; later calls give none."""
        if self.is_over:
            return
        self.phase, self.status = Phase.OVER, status
        is_told = self.was_sent or self.was_announced
        raw = {write.register.name: write.word for write in self.writes} if is_told else {}
        plain = end = (status, reason, text)
        if status is Status.DONE and any(self.beside):
            end = (Status.DONE if self.beside[0] is Reason.NONE else Status.FAILED, *self.beside)
        for command, answer in [(self.command, self.answer), *self.joined]:
            told = end if command is self.command else plain
            answer(Result(command, *told, raw, dict(self.read_back), dict(self.before)))
