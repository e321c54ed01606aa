"""Resets of one drive: those that the gateway asks for, and those that nobody has seen (SAFETY.md H06, H07, H09).

A fault reset gets no answer, and takes everything in the drive's RAM (E6581657 7.1). FA87 is set to 1 when a drive is
armed; it reads 0 after any reset, however short.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from gateway.control import watchdog
from gateway.control.admission import NotAdmitted
from gateway.control.command import Answer, Command, Reason, Result, Status, Verb
from gateway.control.composing import COMMAND, FREQUENCY, HELD_FREQUENCY
from gateway.control.execution import Execution, Phase
from gateway.control.state import DriveState, Errand, Standing
from gateway.control.writes import BadCommand, plan_write
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.errors import Refusal

RESET_WITHIN = 15.0  # seconds for a drive to come back after a fault reset
MARK = "reset_detection"  # FA87
MARK_EVERY = 1.0  # seconds between two looks at it while the drive is armed
MARK_AGAIN = 0.2  # seconds to the next look where the drive could not tell just now
MARK_FRESH = 0.25  # seconds for which a look at it is believed before a run command
RESET = "the drive was reset"
CLEARED = "the drive is no longer tripped: it was reset"


def worth_a_look(model: Model, *, is_marked: bool) -> list[Register]:
    """Return what is read again before a drive is armed: it may have been reset, and set, while nobody looked."""
    marks = [MARK] if is_marked else []
    names = [name for name in (*marks, COMMAND, FREQUENCY, "trip_code") if name in model.registers]
    return [*(model.registers[name] for name in names), *watchdog.registers(model).values()]


@dataclass(slots=True)
class Resets:
    """The resets of one drive. Times are monotonic seconds."""

    state: DriveState
    is_stop_lost: bool = False  # a stop waited when the drive was reset: it is owed
    is_deaf: bool = False  # it was told to reset itself: it hears nothing while it starts
    _to_observe: list[Register] = field(default_factory=list)  # before it is armed
    _asked: Execution | None = None
    _until: float = 0.0
    _seen: float = float("-inf")
    _again_at: float = float("-inf")  # when a drive that could not tell is looked at once more

    @property
    def is_under_way(self) -> bool:
        """Say whether the drive has been told to reset itself and is not back yet."""
        return self._asked is not None

    def on_reset(self, reason: str = RESET) -> None:
        """Take that the drive was reset: it is set up anew, and armed anew. Whether it stands is seen then."""
        state = self.state
        state.needs_set_up, state.is_marked = True, False
        state.carrying.form = None
        self._to_observe = []
        self.is_stop_lost |= state.queue.has_stop
        state.queue.clear(Reason.OFFLINE, reason)
        state.disarm(reason)

    def sent(self, execution: Execution, now: float) -> None:
        """Take that a fault reset was sent."""
        self.state.queue.remove(execution)
        self._asked, self._until = execution, now + RESET_WITHIN
        self.on_reset()
        self.is_deaf = True
        self.state.is_online = False
        self.state.is_tripped = None

    def came_back(self) -> None:
        """Take that the drive is online, and known to be tripped or not."""
        if self._asked is None or self.state.is_tripped is None:
            return
        execution, self._asked = self._asked, None
        if self.state.is_tripped:
            execution.finish(Status.FAILED, Reason.STILL_TRIPPED, "the drive is still tripped")
        else:
            execution.finish(Status.DONE)

    def tick(self, now: float) -> None:
        """Give a reset up whose drive does not come back."""
        if self._asked is not None and now > self._until:
            execution, self._asked = self._asked, None
            execution.finish(Status.UNKNOWN, Reason.NO_ANSWER, "the drive has not come back after the reset")

    # ---- the mark

    def marking(self, command: Command, answer: Answer, arm: Callable[[], None]) -> Execution | None:
        """Return the write of the mark, after which the drive is armed; None where the model has no mark."""
        state = self.state
        register = state.drive.model.registers.get(MARK)
        if register is None:
            return None

        def marked(result: Result) -> None:
            is_done = result.status is Status.DONE
            if not is_done and result.reason is not Reason.REFUSED_BY_DRIVE:
                answer(result)
                return
            state.is_marked = is_done
            try:
                arm()
            except NotAdmitted as refusal:
                answer(Result(command, Status.REFUSED, refusal.reason, str(refusal)))
            else:
                answer(Result(command, Status.DONE))

        try:
            write = plan_write(state.drive.model, state.drive.codec, state.drive.number, register, 1)
        except BadCommand:  # a catalogue in which it is none to be set
            return None
        if not any(execution.command.verb is Verb.ARM for execution in state.queue.executions):
            self._to_observe = worth_a_look(state.drive.model, is_marked=state.is_marked)
        return Execution(command, (write,), marked)

    @property
    def _is_watched(self) -> bool:
        return self.state.is_marked and self.state.is_online and self.state.standing is Standing.ARMED

    def look_before(self, execution: Execution, now: float) -> Errand | None:
        """Return the look to be made before arming, or before a run command: it may have been reset unseen."""
        if execution.command.verb is Verb.ARM and execution.phase is Phase.WRITING and self._to_observe:
            return self.state.look(self._to_observe[0])
        is_first = execution.phase is Phase.WRITING and not execution.is_stop and execution.is_for_armed
        return self._look if self._is_watched and is_first and now > self._seen + MARK_FRESH else None

    def next_look(self, now: float) -> Errand | None:
        """Return the look that is due."""
        return self._look if self._is_watched and now >= self._due_at else None

    @property
    def _due_at(self) -> float:
        return max(self._seen + MARK_EVERY, self._again_at)

    @property
    def _look(self) -> Errand:
        return self.state.look(self.state.drive.model.registers[MARK])

    def seen(self, register: Register, word: int, now: float) -> None:
        """Take what a look has shown."""
        state = self.state
        if register in self._to_observe:
            self._to_observe.remove(register)
            name = HELD_FREQUENCY if register.name == FREQUENCY else register.name
            state.facts[name] = word & register.mask
        if register.name == MARK:
            self._seen = now
            if word == 0 and state.is_marked:
                self.on_reset()

    def refused(self, register: Register, reason: Refusal, now: float) -> None:
        """Take that the drive does not tell: what it cannot tell just now is asked again, the rest is not known.

        Without its mark nothing is watched, and what it was before is no answer any more.
        """
        if reason is Refusal.UNABLE:
            if register.name == MARK:
                self._again_at = now + MARK_AGAIN
            return
        if register in self._to_observe:
            self._to_observe.remove(register)
            self.state.facts.pop(register.name, None)
        if register.name == MARK:
            self.state.is_marked = False

    def next_time(self) -> float:
        """Return when `tick` or `next_look` has to be called at the latest."""
        times = [self._until] if self._asked is not None else []
        return min([*times, self._due_at] if self._is_watched else times, default=float("inf"))
