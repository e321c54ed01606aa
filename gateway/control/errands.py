"""What goes from a drive's control to the line: which frame is next, and what came of it (SAFETY.md H09-H12)."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.control.admission import NotAdmitted
from gateway.control.command import Status, Verb
from gateway.control.execution import Execution
from gateway.control.loss import Loss
from gateway.control.permission import Permission
from gateway.control.presence import Presence
from gateway.control.resets import Resets
from gateway.control.settling import settle
from gateway.control.state import DriveState, Errand, Standing
from gateway.control.stored import StoredWrites
from gateway.control.timeout_looks import TimeoutLooks
from gateway.errors import Refused
from gateway.protocol.pdu import Reply, Words


@dataclass(slots=True)
class Errands:
    """The frames of one drive's commands, and its looks. Times are monotonic seconds."""

    state: DriveState
    stored: StoredWrites
    loss: Loss
    resets: Resets
    timeout_looks: TimeoutLooks
    permission: Permission
    presence: Presence

    # ---- which is next

    def next(self, now: float) -> Errand | None:
        """Return the next frame for this drive; None where none waits."""
        state = self.state
        if state.standing is Standing.QUIET:
            return None
        while state.queue:
            head = state.queue.head
            if not (head.is_begun or head.is_stop) and (look := self._next_look(now)) is not None:
                return look  # a queue that never empties does not keep a reset from being seen
            errand = self._next_of(head, now)
            if errand is not None:
                return errand
            if state.queue and state.queue.head.is_to_be_counted:
                break
        return self.loss.next_look(now) or self._next_look(now)

    def _next_look(self, now: float) -> Errand | None:
        """Return the next look at an armed drive: was it reset, has it still its time-out."""
        return self.resets.next_look(now) or self.timeout_looks.next(now)

    def _next_of(self, execution: Execution, now: float) -> Errand | None:
        """Return the next frame of the command whose turn it is; None where it is over, or waits for the store."""
        if not execution.is_begun and not self._begin(execution, now):
            return None
        if execution.is_to_be_counted:
            execution.look_at(now)
            if not execution.is_over:
                self.stored.reserve(execution, now)
            self._settle(execution)
            if not execution.is_to_be_counted and not execution.is_over:
                return self._next_of(execution, now)
            return None
        look = self.resets.look_before(execution, now)
        if look is not None and now <= execution.command.deadline:
            return look
        request = execution.next(now)
        if request is None:
            self._settle(execution)
            return None
        return Errand(request, execution)

    def _begin(self, execution: Execution, now: float) -> bool:
        """Make up the writes of a command from what the drive holds now; say whether it may be sent."""
        command, state = execution.command, self.state
        if command.verb is Verb.ARM:
            execution.plan(execution.writes)
            return True
        try:
            plan = state.admission.plan(command, state.facts, is_own=state.is_own(command.source, now))
            if not execution.is_stop:
                self.permission.check_state(plan)
        except NotAdmitted as refusal:
            state.queue.remove(execution)
            execution.finish(Status.REFUSED, refusal.reason, str(refusal))
            return False
        execution.plan(plan.writes)
        execution.beside = plan.beside
        if plan.is_reset:
            state.disarm("the drive is being reset")
        return True

    # ---- what came of it

    def sending(self, errand: Errand) -> None:
        """Take note that the frame leaves now."""
        execution = errand.execution
        if execution is None:
            return
        execution.sending()
        self.state.may_move |= execution.is_at_motion

    def on_too_late(self, errand: Errand, now: float) -> None:
        """Take that the frame did not leave: its deadline passed while the line was busy (SAFETY.md H11)."""
        if errand.execution is not None:
            errand.execution.undone(now)
            self._settle(errand.execution)

    def on_reply(self, errand: Errand, reply: Reply | None, now: float) -> None:
        """Take an answer; None where none was to be expected."""
        execution = errand.execution
        if errand.look is not None and isinstance(reply, Words):
            self.timeout_looks.looked(errand.look, now)
            self.timeout_looks.seen(errand.look, reply.words[0], now)
            self.loss.seen(errand.look, reply.words[0], now)
            self.resets.seen(errand.look, reply.words[0], now)
            if errand.look.name == "trip_code" and reply.words[0]:
                self.presence.on_trip(is_tripped=True)
        elif execution is not None and not execution.write.is_answered:
            self.resets.sent(execution, now)
        elif execution is not None:
            execution.on_reply(reply)
            self._settle(execution)

    def on_refused(self, errand: Errand, refused: Refused, now: float) -> None:
        """Take a refusal."""
        if errand.look is not None:
            self.timeout_looks.looked(errand.look, now)
            self.resets.refused(errand.look, refused.reason, now)
        if errand.execution is not None:
            errand.execution.on_refused(refused)
            self._settle(errand.execution)

    def on_silence(self, errand: Errand, text: str, now: float) -> None:
        """Take silence, or bytes that are no answer."""
        execution = errand.execution
        if errand.look is not None:
            self.timeout_looks.looked(errand.look, now)
        if execution is None or execution.is_over:
            return
        if not execution.write.is_answered:  # noise where silence was expected
            self.resets.sent(execution, now)
            return
        execution.on_silence(text)
        self._settle(execution)
        if execution.is_stop and execution.status is Status.UNKNOWN:
            self.loss.unverified(f"a stop was not answered: {text}", now)

    def _settle(self, execution: Execution) -> None:
        settle(execution, self.state, self.loss)
