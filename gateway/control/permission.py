"""Who may command a drive now, and how that changes: take, arm, release (SAFETY.md H04, H06)."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.control.admission import NotAdmitted, Plan
from gateway.control.command import Answer, Command, Reason, Result, Status, Verb
from gateway.control.loss import Loss
from gateway.control.resets import Resets
from gateway.control.state import DriveState, Standing


@dataclass(slots=True)
class Permission:
    """The permission to command one drive; what does not hold raises NotAdmitted. Times are monotonic seconds."""

    state: DriveState
    loss: Loss
    resets: Resets

    # ---- what must hold

    def check_owner(self, command: Command, now: float) -> None:
        """Refuse whoever does not own the drive."""
        if not self.state.is_own(command.source, now):
            raise NotAdmitted(Reason.NOT_OWNER, self._owner_text(now))

    def _owner_text(self, now: float) -> str:
        state = self.state
        if state.standing is Standing.LOST:
            return f"{state.reason}: the drive is being stopped; take it again afterwards"
        if not state.lease.is_held(now):
            return f"nobody holds the lease of {state.drive.name}: take it first"
        return f"{state.lease.owner} holds the lease"

    def check_reach(self, now: float) -> None:
        """Refuse a stop that must not, or cannot, be sent."""
        state = self.state
        if state.standing is Standing.QUIET:
            raise NotAdmitted(Reason.QUIESCED, f"the drive is left alone, so that its F803 stops it: {state.reason}")
        if not state.is_heard:
            self.loss.owe()
            if state.may_move:  # no read may start its F803 anew before the stop is sent
                self.loss.unverified("a stop came while the drive was not heard", now)
            text = f"{state.drive.name} is not heard; if it comes back running, it is stopped"
            raise NotAdmitted(Reason.OFFLINE, text)

    def check_state(self, plan: Plan) -> None:
        """Refuse what the drive cannot be given as it stands: motion only where it is armed."""
        state = self.state
        if state.standing is Standing.QUIET:
            raise NotAdmitted(Reason.QUIESCED, f"the drive is left alone: {state.reason}")
        if state.standing is Standing.LOST:
            raise NotAdmitted(Reason.NOT_OWNER, f"{state.reason}: the drive is being stopped")
        if self.resets.is_under_way:
            raise NotAdmitted(Reason.BUSY, "the drive is being reset")
        if not state.is_online:
            raise NotAdmitted(Reason.OFFLINE, state.away)
        if plan.is_motion and state.standing is not Standing.ARMED:
            raise NotAdmitted(Reason.NOT_ARMED, f"disarmed: {state.reason}")
        if plan.is_motion and state.unwatched and not state.settings.is_unwatched:
            raise NotAdmitted(Reason.NO_WATCHDOG, state.unwatched)

    # ---- how it changes

    def change(self, command: Command, answer: Answer, now: float) -> None:
        """Take, arm or release."""
        if command.verb is Verb.TAKE:
            self._take(command, now)
        elif command.verb is Verb.RELEASE:
            self.check_owner(command, now)
            self.loss.begin(f"released by {command.source}", now, "released")
        else:
            self.check_owner(command, now)
            self._check_armable()
            self.state.lease.renew(min(now, command.received))
            marking = self.resets.marking(command, answer, self._arm)
            if marking is not None:
                self.state.queue.put(marking)
                return
            self._arm()
        answer(Result(command, Status.DONE))

    def _take(self, command: Command, now: float) -> None:
        state, lease = self.state, self.state.lease
        if not state.settings.is_leased:
            return
        if state.standing in (Standing.LOST, Standing.QUIET):
            raise NotAdmitted(Reason.BUSY, f"the drive is {state.standing.value}: {state.reason}")
        is_new = lease.owner is None
        if not lease.take(command.source, min(now, command.received)):
            raise NotAdmitted(Reason.NOT_OWNER, self._owner_text(now))
        self.loss.taken()
        if is_new:
            state.tell("taken", str(command.source))

    def _check_armable(self) -> None:
        state = self.state
        if state.standing in (Standing.LOST, Standing.QUIET):
            raise NotAdmitted(Reason.QUIESCED, f"the drive is {state.standing.value}: {state.reason}")
        if not state.is_online or self.resets.is_under_way:
            raise NotAdmitted(Reason.OFFLINE, state.away)
        if state.is_tripped:
            raise NotAdmitted(Reason.NOT_ARMED, "the drive is tripped: reset it first")
        if state.queue.is_setting_up:
            raise NotAdmitted(Reason.BUSY, "F803, F804 and F808 are being set")
        if state.unwatched and not state.settings.is_unwatched:
            raise NotAdmitted(Reason.NO_WATCHDOG, state.unwatched)

    def _arm(self) -> None:
        state = self.state
        self._check_armable()
        state.standing, state.reason = Standing.ARMED, ""
        state.tell("armed", str(state.lease.owner or ""))
