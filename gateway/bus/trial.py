"""Whether the exchange of a drive writes what F870 and F871 say: tried once, at the end of a set-up, harmlessly.

What is set may not be in force until a reset, and a frequency in the place of the command would be obeyed as one. So
words that move nothing wherever they arrive are written by the exchange while nobody can command the drive yet, FA00
is 0 and FD01 says that the motor stands. Everything that F870 and F871 can select is read before and afterwards, and
whatever has changed is written as it was, one by one.

Pure: it is told what was answered, and says what is to be done next.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

from gateway.bus.poll_jobs import PollJobs
from gateway.bus.provision import RESET_MARK
from gateway.bus.reading import Reading
from gateway.bus.work import Task, Work
from gateway.control.carrying import Form
from gateway.control.composing import COMMAND, FREQUENCY, has_bit, runs
from gateway.drives.register import Register
from gateway.errors import Refusal, Refused
from gateway.protocol.pdu import Exchanged, Reply, Words, WriteRam, Written

STATUS, RUNNING = "status", "running"  # FD01
# In FA00 preset speeds, without priority and run; in FA20 and FA50 nothing (E6581657 7.1, 7.2).
COMMAND_WORD, FREQUENCY_WORDS = 4, (8, 12)  # the second where FA01 has the first
TRIES = 3  # of one frame that is not answered


class Stage(Enum):
    """How far it is."""

    LOOKING = "reading what F870 and F871 can select"
    STANDING = "looking whether the motor stands"
    TRYING = "writing harmless words"
    CHECKING = "reading all that again"
    RESTORING = "writing as it was what has changed"
    RESTORED = "reading that back"
    OVER = "over"


class Trial:
    """The trial of one drive's exchange, and what came of the last one. It may be held while the drive is lost."""

    def __init__(self, reading: Reading, jobs: PollJobs) -> None:
        self._reading = reading
        self._jobs = jobs
        self._drive = reading.drive
        self._stage = Stage.OVER
        self._form: Form | None = None  # that is being tried
        self._proven: Form | None = None
        self._is_fresh = True  # nobody can command the drive before its set-up is over
        self._before: dict[str, int] = {}
        self._after: dict[str, int] = {}
        self._left: list[Register] = []
        self._unanswered = 0
        self._unread: dict[str, int] = {}  # what an earlier trial has overwritten, and did not tell at this set-up
        self._problem = ""

    # ---- what others look at

    @property
    def form(self) -> Form | None:
        """Return the exchange by which commands may go; None where none is proven."""
        return self._proven if self._proven == self._offered else None

    @property
    def is_under_way(self) -> bool:
        """Say whether it is under way."""
        return self._stage is not Stage.OVER

    @property
    def _offered(self) -> Form | None:
        """Return the exchange as the drive is set and polled; None where commands cannot go by it."""
        form = self._jobs.exchange()
        return form if form is not None and form.is_usable(self._drive.codec) else None

    # ---- when it is made

    def forget(self) -> None:
        """Take that the drive was lost; a trial that was broken off is made good at the next set-up."""
        self._stage, self._is_fresh = Stage.OVER, True

    def give_up(self) -> None:
        """Take that the drive has refused the exchange, or not written what it should."""
        self._proven = None

    def begin(self) -> str:
        """Begin at the end of a set-up, if that is called for; return what is to be said, "" where nothing is."""
        is_fresh, self._is_fresh = self._is_fresh, False
        offered, facts = self._offered, self._reading.facts
        if self._before and is_fresh:  # broken off: what it changed is put right, whatever comes of it
            self._start(None)
            return ""
        if offered is not None and offered == self._proven and (not is_fresh or facts.get(RESET_MARK) == 1):
            return ""
        had, self._proven = self._proven, None
        if is_fresh and offered is not None:
            self._start(offered)
        elif not is_fresh and had is not None:
            return "commands go in frames of their own until the drive was away: F870 or F871 have changed"
        return ""

    def _start(self, form: Form | None) -> None:
        """Look at everything that a block write can reach; `form` is None where something is only to be put right."""
        names = dict.fromkeys(name for name in self._drive.model.write_selectors.values() if name)
        self._form, self._stage, self._problem, self._unanswered = form, Stage.LOOKING, "", 0
        self._after = {}
        self._left = [self._drive.model.registers[name] for name in names if name in self._drive.model.registers]

    # ---- its frames

    def next(self) -> Work | None:
        """Return the next frame; None when it is over."""
        while self._stage is not Stage.OVER and not self._has_more:
            self._advance()
        match self._stage:
            case Stage.OVER:
                return None
            case Stage.STANDING:
                return self._read(self._drive.model.registers[STATUS])
            case Stage.TRYING if self._form is not None:
                return Work(Task.TRIAL, self._form.exchange(self._words))
            case Stage.RESTORING:
                register = self._left[0]
                return Work(Task.TRIAL, WriteRam(self._drive.number, register.address, self._before[register.name]))
        return self._read(self._left[0])

    @property
    def _has_more(self) -> bool:
        return self._stage in (Stage.STANDING, Stage.TRYING) or bool(self._left)

    @property
    def _words(self) -> dict[str, int]:
        """Return the harmless words: each differs from what stood there, and from the other."""
        held = self._before.get(FREQUENCY)
        return {COMMAND: COMMAND_WORD, FREQUENCY: next(word for word in FREQUENCY_WORDS if word != held)}

    def _read(self, register: Register) -> Work:
        read = self._reading.alone(register)
        return Work(Task.TRIAL, read.request, read, register)

    def _advance(self) -> None:
        """Go on where everything of a stage is done."""
        self._unanswered = 0
        if self._stage is Stage.LOOKING:
            self._looked()
        elif self._stage is Stage.CHECKING:
            self._compare()
            self._stage, self._left = Stage.RESTORING, [
                self._drive.model.registers[name]
                for name, word in self._before.items()
                if self._is_tried(name, self._after.get(name, self._wrote(name))) and self._after.get(name) != word
            ]
        elif self._stage is Stage.RESTORING:
            changed = [name for name, word in self._before.items() if self._after.get(name, word) != word]
            self._stage, self._left = Stage.RESTORED, [self._drive.model.registers[name] for name in changed]
        else:
            self._end()

    def _is_tried(self, name: str, word: int | None) -> bool:
        """Say whether a register reads as a trial writes it: anything else is somebody's own, as a stop's FA00."""
        mask = self._drive.model.registers[name].mask
        return word in {each & mask for each in (COMMAND_WORD, *FREQUENCY_WORDS)}

    def _wrote(self, name: str) -> int | None:
        """Return what was written to a register, should it not tell; None for those that nothing should reach."""
        return self._words[name] if self._form is not None and name in self._form.written else None

    def _compare(self) -> None:
        """Judge what was read after the trial: the words are where they should be, and nowhere else."""
        tried = {name: self._words[name] for name in (self._form.written if self._form is not None else ())}
        wrong = [name for name, word in (self._before | tried).items() if self._after.get(name, word) != word]
        if wrong and not self._problem:
            read = ", ".join(f"{name} reads {self._after[name]:04X}H" for name in wrong)
            self._problem = f"{read}; F870 and F871 may not be in force until the drive is reset"

    def _looked(self) -> None:
        """Judge what was read before anything is tried; or put right what an earlier trial has left behind."""
        if self._form is None:
            self._left_behind()
            return
        self._before, self._after = self._after, {}
        register = self._drive.model.registers[COMMAND]
        missing = [name for name in self._form.written if name not in self._before]
        if missing or self._before[COMMAND] & register.mask or STATUS not in self._drive.model.registers:
            held = f"{COMMAND} reads {self._before.get(COMMAND, 0):04X}H"
            self._call_off(f"it is tried only where nothing is commanded, and {held}")
        else:
            self._stage = Stage.STANDING

    def _left_behind(self) -> None:
        """Find what reads as a trial has written it: unless it was reset, or set meanwhile, that is the trial's."""
        names = [n for n, w in self._after.items() if self._is_tried(n, w) and self._before.get(n, w) != w]
        if runs(self._drive.model.registers[COMMAND], self._after.get(COMMAND, 0)):  # somebody has taken it over
            names = []
        self._unread = {n: w for n, w in self._before.items() if n not in self._after}
        self._before = {name: self._before[name] for name in names}
        self._problem = "a trial was broken off"
        self._stage, self._left = Stage.RESTORING, [self._drive.model.registers[name] for name in names]

    # ---- its answers

    def answered(self, work: Work, reply: Reply) -> None:
        """Take an answer."""
        self._unanswered = 0
        match work.request, reply:
            case WriteRam(), Written():
                self._left.pop(0)
            case _, Exchanged(_, failed):
                self._problem = "the drive does not write what F870 and F871 select" if failed else ""
                self._check()
            case _, Words(words) if work.register is not None:
                self._seen(work.register, words)

    def _seen(self, register: Register, words: Sequence[int]) -> None:
        word = words[0] & register.mask
        if self._stage is Stage.STANDING:
            if has_bit(register, words[0], RUNNING):
                self._call_off("it is tried only where the motor stands")
            else:
                self._stage = Stage.TRYING
            return
        self._after[register.name] = word
        self._left.pop(0)

    def _check(self) -> None:
        self._stage = Stage.CHECKING
        self._left = [self._drive.model.registers[name] for name in self._before]

    def refused(self, work: Work, refused: Refused) -> None:
        """Take a refusal: a register that is not there cannot be written by accident; no exchange, no trial."""
        if self._stage is Stage.TRYING:
            self._problem = str(refused)
            self._check()
        elif self._left:
            if self._stage is not Stage.LOOKING or refused.reason is Refusal.UNABLE:
                self._problem = str(refused)
            self._left.pop(0)
        else:
            self._call_off(str(refused))

    def unanswered(self) -> None:
        """Take that a frame was not answered: it is sent again, some times; the exchange never, by an old look."""
        self._unanswered += 1
        if self._stage is Stage.TRYING:
            self._problem = "no answer"
            self._check()
            return
        if self._unanswered < TRIES:
            return
        self._unanswered = 0
        if self._left:
            self._problem = "no answer"
            self._left.pop(0)
        else:
            self._call_off("no answer")

    def disturbed(self, written: str) -> None:
        """Take that a stop has written a register meanwhile: what stands there now is its own."""
        if self.is_under_way:
            self._problem = "a stop came"
            self._before.pop(written, None)
            if self._form is not None and self._stage in (Stage.LOOKING, Stage.STANDING):
                self._before, self._stage = {}, Stage.RESTORED
                self._left = [self._drive.model.registers[COMMAND]]
            elif self._stage is not Stage.LOOKING:
                self._check()

    def _call_off(self, problem: str) -> None:
        """End it before anything was written."""
        self._before, self._left = {}, []
        self._problem = problem
        self._stage = Stage.OVER

    def _end(self) -> None:
        """Judge: all that was tried arrived where it should, nothing else changed, and all is as it was."""
        self._stage = Stage.OVER
        wrong = [name for name, word in self._before.items() if self._after.get(name, word) != word]
        self._before = {name: self._before[name] for name in wrong}  # put right at the next set-up
        if self._form is None:
            self._before |= self._unread
            if not self._before and (offered := self._offered) is not None:
                self._start(offered)
            return
        if wrong and not self._problem:
            self._problem = f"{', '.join(wrong)} could not be written as it was"
        if not self._problem:
            self._proven = self._form

    @property
    def said(self) -> str:
        """Return why commands go in frames of their own, once it is over; "" where they do not."""
        return f"commands go in frames of their own: {self._problem}" if self._problem else ""
