"""What is done when the permission to command a drive ends: `on_loss`, verified, or no frame at all (SAFETY.md H05).

Pure. A stop that is not answered is only written again, never read back: every read that the drive acknowledges
would start its F803 anew (E6581657 6.3). When it is still not verified, the drive is left alone, so that F803 acts.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal

from gateway.control.admission import NotAdmitted
from gateway.control.command import GATEWAY, Command, Reason, Result, Status, Verb
from gateway.control.execution import Execution
from gateway.control.following import Following
from gateway.control.settings import OnLoss
from gateway.control.state import DriveState, Errand, Standing
from gateway.drives.register import Register

STOP_WITHIN = 1.0  # seconds for a stop to be read back, before the drive is left to its own F803
QUIET_BEYOND = 1.0  # seconds beyond F803 that a drive is left alone, so that it surely acts

VERBS = {
    OnLoss.STOP: Verb.STOP,
    OnLoss.COAST: Verb.COAST,
    OnLoss.EMERGENCY_STOP: Verb.EMERGENCY_STOP,
    OnLoss.FREQUENCY: Verb.FREQUENCY,
}
STRENGTHS = {OnLoss.COAST: 1, OnLoss.EMERGENCY_STOP: 2}  # that a stop under way has to have to do instead


@dataclass(slots=True)
class Loss:
    """The loss of permission of one drive. Times are monotonic seconds."""

    state: DriveState
    following: Following | None = None
    _kind: OnLoss = OnLoss.STOP
    _since: float = 0.0
    quiet_until: float = 0.0  # the end of leaving the drive alone
    _owes_stop: bool = False  # a stop could not be verified, and F803 may not have acted
    _stop_again_at: float = 0.0
    _unowned_since: float | None = None  # the drive was found running, and nobody has the lease

    # ---- how it begins

    def begin(self, reason: str, now: float, event: str = "lease_lost") -> None:
        """End the permission, and do what is configured for that."""
        state, kind = self.state, self.state.settings.on_loss
        state.lease.end()
        state.queue.clear_but_stops(Reason.NOT_OWNER, reason)
        state.tell(event, reason)
        state.disarm(reason)
        if kind is OnLoss.HOLD or not state.may_move or state.standing is not Standing.DISARMED:
            return
        if state.queue.has_stop and state.queue.head.strength >= STRENGTHS.get(kind, 0):
            self._adopt(reason, now)
        elif not state.is_heard or kind is OnLoss.QUIESCE:
            self.unverified(reason, now)
        else:
            self._do(kind, reason, now)

    def leave(self, now: float) -> None:
        """Stop the drive since the gateway ends, where it was set in motion and is heard (SAFETY.md H13)."""
        state = self.state
        state.lease.end()
        state.queue.clear_but_stops(Reason.ENDING, "the gateway ends")
        state.disarm("the gateway ends")
        if state.standing is not Standing.DISARMED:
            return  # it is being stopped already, or left alone
        if state.queue.has_stop:
            self._adopt("the gateway ends", now)
        elif state.settings.stops_on_exit and state.may_move and state.is_heard:
            self._do(OnLoss.STOP, "the gateway ends", now)

    def _adopt(self, reason: str, now: float) -> None:
        """See a stop through that somebody else has asked for, and that waits already."""
        self.state.standing, self.state.reason = Standing.LOST, reason
        self._kind, self._since = OnLoss.STOP, now

    def found_running(self, now: float) -> None:
        """Take that a drive came that runs by command: it is stopped where that is owed, else it wants an owner."""
        state = self.state
        if self._owes_stop:
            self._stop_owed(now)
        elif not state.settings.is_leased or state.lease.is_held(now):
            state.may_move = True
        else:
            self._unowned_since = now
            state.tell("unowned", "it runs by command, and nobody holds the lease")

    def heard(self, now: float) -> None:
        """Stop a drive that is heard again, where that is owed: before anything is read that starts its F803 anew."""
        if self._owes_stop and self.state.standing is Standing.DISARMED:
            self._stop_owed(now)

    def _stop_owed(self, now: float) -> None:
        self._owes_stop = False
        kind = self.state.settings.on_loss
        kind = kind if kind in (OnLoss.COAST, OnLoss.EMERGENCY_STOP) else OnLoss.STOP
        self._do(kind, "a stop was not verified before", now)

    def found_standing(self) -> None:
        """Take that a drive came that does not run by command."""
        self.state.may_move = self._owes_stop = False

    def taken(self) -> None:
        """Take that somebody has the lease now: what was found running is his."""
        if self._unowned_since is not None:
            self._unowned_since, self.state.may_move = None, True

    def owe(self) -> None:
        """Stop the drive when it is heard again, should it run then."""
        self._owes_stop = True

    def link_lost(self, *, is_stop_pending: bool, reason: str, now: float) -> None:
        """Take that the drive is not heard any more."""
        self._unowned_since = self.following = None
        if is_stop_pending and self.state.standing is not Standing.QUIET:
            self.unverified(f"a stop was not verified: {reason}", now)

    # ---- what is done

    def _do(self, kind: OnLoss, reason: str, now: float) -> None:
        """Queue the gateway's own stop, or the fallback frequency, ahead of everything; nobody goes on jogging."""
        state = self.state
        kind = OnLoss.STOP if kind is OnLoss.FREQUENCY and state.is_jogging else kind
        state.disarm(reason)
        state.standing, state.reason = Standing.LOST, reason
        self._kind, self._since = kind, now
        verb = VERBS.get(kind, Verb.STOP)
        value: Decimal | None = state.settings.fallback if verb is Verb.FREQUENCY else None
        command = Command(state.drive.name, verb, GATEWAY, now, now + STOP_WITHIN, value=value)
        try:
            plan = state.admission.plan(command, state.facts, is_own=True)
        except NotAdmitted as refusal:
            self.unverified(str(refusal), now)
            return
        state.queue.put(Execution(command, plan.writes, self._done, is_stop=True))

    def _done(self, result: Result) -> None:
        """Take the end of the stop: it is read back, and now the motor has to follow."""
        state = self.state
        if state.standing is not Standing.LOST or result.status is not Status.DONE:
            return
        if self._kind is OnLoss.FREQUENCY:
            self._settle()
        else:
            self.stopped()

    def stopped(self) -> None:
        """Take that a stop, whoever's, was read back: its motor has to be seen to follow."""
        state = self.state
        if state.standing is Standing.LOST and self.following is None:
            self.following = Following(state.drive.model, self._since)
            self.following.is_seen |= state.is_tripped is True

    def next_look(self, now: float) -> Errand | None:
        """Return the next look at a motor that has to stop."""
        register = self.following.next(now) if self.following is not None else None
        return self.state.look(register) if register is not None else None

    def seen(self, register: Register, word: int, now: float) -> None:
        """Take what a look has shown."""
        if self.following is not None:
            self.following.take(register, word)
            self.tick(now)

    def tripped(self) -> None:
        """Take that the drive is tripped: its motor gets no current."""
        if self.following is not None:
            self.following.is_seen = True

    def _settle(self) -> None:
        self.following = None
        self.state.standing = Standing.DISARMED
        self.state.tell("on_loss", f"{self._kind.value}: done")

    def unverified(self, reason: str, now: float) -> None:
        """Leave a drive alone that could not be seen to stop; tell it again and again where that is no help."""
        state = self.state
        self.following = None
        self._owes_stop, self._stop_again_at = True, now + STOP_WITHIN
        if state.timeout > 0 and not state.unwatched:
            self._quiesce(reason, now)
        elif state.standing is Standing.LOST:
            state.standing, state.reason = Standing.DISARMED, reason
            state.tell("not_stopped", reason)

    def _quiesce(self, reason: str, now: float) -> None:
        """Send the drive no frame any more, so that its own F803 acts."""
        state = self.state
        state.disarm(reason)
        state.standing, state.reason = Standing.QUIET, reason
        self.quiet_until = now + state.timeout + QUIET_BEYOND
        state.queue.clear(Reason.QUIESCED, reason)
        state.tell("quiesced", reason)

    # ---- time

    def tick(self, now: float) -> None:
        """Look at the time: leases that ran out, and what they leave to be done."""
        state = self.state
        if state.settings.is_leased and state.lease.is_over(now):
            self.begin(f"the lease of {state.lease.owner} has ended", now)
        if state.standing is Standing.LOST:
            self._look_at_stop(now)
        if self._unowned_since is not None and now >= self._unowned_since + self._grace:
            self._unowned_since = None
            if state.timeout > 0 and not state.unwatched:
                self._quiesce("it runs, and nobody holds the lease", now)
        if state.standing is Standing.QUIET and now >= self.quiet_until:
            state.standing = Standing.DISARMED
            state.tell("awake", state.reason)
        if self._is_stop_again and now >= self._stop_again_at:
            self._stop_owed(now)

    def _look_at_stop(self, now: float) -> None:
        """End the loss when the motor was seen to stop, or leave the drive to its F803 when it was not."""
        if self.following is not None:
            if self.following.is_seen:
                self._settle()
            elif self.following.is_late(now):
                self.unverified("its motor was not seen to stop", now)
        elif not self.state.queue or now > self._since + STOP_WITHIN:
            self.state.queue.clear(Reason.NOT_READ_BACK, "the drive was not seen to stop")
            self.unverified("it could not be stopped", now)

    @property
    def _grace(self) -> float:
        """Return how long a drive that was found running may wait for an owner: only where `hold` is wanted."""
        settings = self.state.settings
        return 0.0 if settings.stops_on_exit else settings.lease

    @property
    def _is_stop_again(self) -> bool:
        """Say whether a drive that has no F803 to stop it is to be told once more."""
        return self._owes_stop and self.state.is_online and self.state.standing is Standing.DISARMED

    def next_time(self) -> float:
        """Return when `tick` or `next_look` has to be called at the latest."""
        state = self.state
        times = [state.lease.until] if state.lease.owner is not None else []
        if self._unowned_since is not None:
            times.append(self._unowned_since + self._grace)
        if state.standing is Standing.QUIET:
            times.append(self.quiet_until)
        if state.standing is Standing.LOST:
            times.append(self.following.due if self.following is not None else self._since + STOP_WITHIN)
        if self._is_stop_again:
            times.append(self._stop_again_at)
        return min(times, default=float("inf"))
