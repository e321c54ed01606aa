"""One command on its way to a drive: which frame comes next, and what its end is (SAFETY.md H09-H11, H22).

Pure: it is told what was answered, refused or not answered, and asks for nothing itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from gateway.control.command import Answer, Command, Reason, Result, Status
from gateway.control.writes import PlannedWrite
from gateway.errors import Refused
from gateway.protocol.pdu import ReadWords, Reply, Request, Words, WriteStored


class Phase(Enum):
    """How far a command is."""

    COMPARING = "comparing"  # reading what a stored parameter holds: an equal value is not written
    WRITING = "writing"
    VERIFYING = "verifying"
    OVER = "over"


@dataclass(slots=True)
class Execution:
    """The frames of one command, one after another: compare (EEPROM only), write, read back.

    A write without an answer is not repeated; reading back tells what became of it. `is_persistent` is for
    stopping: it is written again until it is read back, however late.
    """

    command: Command
    writes: Sequence[PlannedWrite]
    answer: Answer
    is_persistent: bool = False
    phase: Phase = Phase.WRITING
    was_sent: bool = False
    wore: list[int] = field(default_factory=list)
    read_back: dict[str, int] = field(default_factory=dict)
    is_done: bool = False
    _place: int = 0
    _silent: str = ""
    _is_told: bool = False

    def __post_init__(self) -> None:
        self._begin_write()

    @property
    def is_over(self) -> bool:
        """Say whether its result has been given."""
        return self.phase is Phase.OVER

    @property
    def _write(self) -> PlannedWrite:
        return self.writes[self._place]

    def _begin_write(self) -> None:
        self.phase = Phase.COMPARING if self._write.wears_eeprom else Phase.WRITING

    def next(self, now: float) -> Request | None:
        """Return the next frame; None when it is over, or its deadline has passed before anything was sent."""
        if self.phase is not Phase.OVER and not self.is_persistent and now > self.command.deadline:
            self._late()
        if self.phase is Phase.OVER:
            return None
        if self.phase is Phase.WRITING:
            return self._write.request
        return ReadWords(self._write.request.number, self._write.register.address)

    def _late(self) -> None:
        if self.was_sent:
            self.finish(Status.UNKNOWN, Reason.EXPIRED, "its deadline passed before it was read back")
        else:
            self.finish(Status.REFUSED, Reason.EXPIRED, "its deadline passed before it could be sent")

    def sending(self) -> None:
        """Take note that the frame of `next` leaves now."""
        self.was_sent |= self.phase is Phase.WRITING

    def on_reply(self, reply: Reply | None) -> None:
        """Take an answer; None where no answer was to be expected."""
        if self.phase is Phase.WRITING:
            if isinstance(self._write.request, WriteStored):
                self.wore.append(self._write.register.address)
            self.phase = Phase.VERIFYING if self._write.is_answered else Phase.OVER
            if self.phase is Phase.OVER:
                self.finish(Status.DONE, Reason.NONE, "a reset is not answered")
        elif isinstance(reply, Words):
            self._on_word(reply.words[0])

    def _on_word(self, word: int) -> None:
        write = self._write
        self.read_back[write.register.name] = word & write.register.mask
        is_equal = write.reads_back(word)
        if self.phase is Phase.COMPARING:
            if is_equal:
                self._next_write()
            else:
                self.phase = Phase.WRITING
        elif is_equal:
            self._next_write()
        elif self.is_persistent:
            self._begin_write()
        elif self._silent:
            self.finish(Status.FAILED, Reason.NO_ANSWER, f"{self._silent}; it was not done")
        else:
            self.finish(Status.FAILED, Reason.NOT_READ_BACK, f"{write.register.name} reads {word:04X}H")

    def _next_write(self) -> None:
        self._silent = ""
        if self._place + 1 < len(self.writes):
            self._place += 1
            self._begin_write()
        else:
            self.finish(Status.DONE)

    def on_refused(self, refused: Refused) -> None:
        """Take a refusal."""
        if self.phase is Phase.VERIFYING:  # it can be written but not read
            self._next_write()
        elif self.phase is Phase.COMPARING:
            self.phase = Phase.WRITING
        else:
            self.finish(Status.FAILED, Reason.REFUSED_BY_DRIVE, refused.reason.value)

    def on_silence(self, text: str) -> None:
        """Take silence or garbage: a write may have been done, which reading back tells."""
        if self.phase is Phase.WRITING:
            self._silent = text
            self.phase = Phase.VERIFYING
        elif self.is_persistent:
            self._begin_write()
        elif self.was_sent:
            self.finish(Status.UNKNOWN, Reason.NO_ANSWER, text)
        else:
            self.finish(Status.FAILED, Reason.NO_ANSWER, text)

    def finish(self, status: Status, reason: Reason = Reason.NONE, text: str = "") -> None:
        """Give the one result."""
        if self._is_told:
            return
        self.phase = Phase.OVER
        self._is_told = True
        self.is_done = status is Status.DONE
        raw = {write.register.name: write.word for write in self.writes}
        self.answer(Result(self.command, status, reason, text, raw, dict(self.read_back)))
