"""The control of one drive: takes commands, and shows how it stands.

Pure: it is told what happened and what time it is; whatever it is asked to do ends in exactly one result (SAFETY.md
H03-H12). Who may command is said by `permission`; the line asks `errands` before each exchange, and tells `presence`
what happens to the drive; what is done when permission ends is `loss`. They share the `state`.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.control.admission import NotAdmitted
from gateway.control.command import Answer, Channel, Command, Reason, Result, Source, Status
from gateway.control.errands import Errands
from gateway.control.execution import Execution
from gateway.control.lease import Lease
from gateway.control.loss import Loss
from gateway.control.permission import Permission
from gateway.control.presence import Presence
from gateway.control.resets import Resets
from gateway.control.results import Results
from gateway.control.settings import ControlSettings
from gateway.control.state import DriveState, Standing
from gateway.control.stored import StoredWrites
from gateway.control.timeout_looks import TimeoutLooks
from gateway.control.writes import BadCommand
from gateway.site import Drive

log = logging.getLogger("gateway.control")


@dataclass(slots=True)
class DriveControl:
    """One controlled drive. Times are monotonic seconds."""

    state: DriveState
    stored: StoredWrites
    loss: Loss = field(init=False)
    resets: Resets = field(init=False)
    presence: Presence = field(init=False)
    timeout_looks: TimeoutLooks = field(init=False)
    errands: Errands = field(init=False)
    _permission: Permission = field(init=False)
    _results: Results = field(default_factory=Results)

    def __post_init__(self) -> None:
        self.loss = Loss(self.state)
        self.resets = Resets(self.state)
        self.presence = Presence(self.state, self.loss, self.resets)
        self.timeout_looks = TimeoutLooks(self.state, self.presence.set_watchdog)
        self._permission = permission = Permission(self.state, self.loss, self.resets)
        self.errands = Errands(
            self.state, self.stored, self.loss, self.resets, self.timeout_looks, permission, self.presence
        )

    # ---- what others look at

    @property
    def drive(self) -> Drive:
        """Return the drive."""
        return self.state.drive

    @property
    def settings(self) -> ControlSettings:
        """Return how it may be commanded."""
        return self.state.settings

    @property
    def standing(self) -> Standing:
        """Return whether it may be set in motion."""
        return self.state.standing

    @property
    def reason(self) -> str:
        """Return why it may not."""
        return self.state.reason

    @property
    def lease(self) -> Lease:
        """Return its lease."""
        return self.state.lease

    @property
    def facts(self) -> Mapping[str, int]:
        """Return words as the drive has them, by register name."""
        return self.state.facts

    @property
    def is_quiet(self) -> bool:
        """Say whether nothing at all is to be sent to the drive."""
        return self.standing is Standing.QUIET

    @property
    def is_exclusive(self) -> bool:
        """Say whether the drive is to be sent nothing but its stop: a read would keep its F803 from acting."""
        return self.standing is Standing.LOST and self.loss.following is None

    @property
    def has_stop(self) -> bool:
        """Say whether a stop waits."""
        return self.state.queue.has_stop

    @property
    def has_command(self) -> bool:
        """Say whether a command waits, or is under way."""
        return bool(self.state.queue)

    def urgency(self, soon: float) -> tuple[float, bool, float]:
        """Return what says whose command goes first, the least: its deadline, `soon` after it came at the latest.

        Of equal ones that which is begun goes on, so that some are sent in time where not all can be.
        """
        if not self.state.queue:
            return float("inf"), True, float("inf")
        head = self.state.queue.head
        return min(head.command.deadline, head.command.received + soon), not head.is_begun, head.command.deadline

    @property
    def is_settled(self) -> bool:
        """Say whether nothing is left to be done for it."""
        return self.standing is not Standing.LOST and not self.state.queue

    # ---- time

    def tick(self, now: float) -> None:
        """Look at the time: leases that ran out, stops that were not seen, resets that take too long."""
        self.loss.tick(now)
        self.resets.tick(now)

    def next_time(self) -> float:
        """Return when `tick` or `errands.next` has to be asked again at the latest."""
        waiting = self.state.queue.head.command.deadline if self.state.queue else float("inf")
        return min(self.loss.next_time(), self.resets.next_time(), self.timeout_looks.next_time(), waiting)

    # ---- northbound

    def submit(self, command: Command, answer: Answer, now: float) -> None:
        """Take a command; its result comes by `answer`, at once where it is refused."""
        self.tick(now)
        if self._results.is_known(command, answer):
            return
        told = self._results.remembering(command, answer)
        try:
            self._admit(command, told, now)
        except NotAdmitted as refusal:
            told(Result(command, Status.REFUSED, refusal.reason, str(refusal)))
        except (ArithmeticError, LookupError, ValueError, BadCommand) as error:  # no command ends the gateway
            log.exception("%s: %s cannot be understood", command.drive, command.verb)
            told(Result(command, Status.REFUSED, Reason.MALFORMED, f"{type(error).__name__}: {error}"))

    def announce(self, command: Command, answer: Answer, now: float) -> None:
        """Take a stop that every drive was told by one broadcast: it only has to be read back, else written."""
        self.submit(command, answer, now)
        if self.state.queue and self.state.queue.head.command is command:
            self.state.queue.head.announced()

    def beat(self, source: Source, beat: object, now: float) -> bool:
        """Take a heartbeat; say whether it renewed the lease."""
        return self.settings.may_write(source) and self.lease.beat(source, beat, now)

    def end_lease(self, channel: Channel, reason: str, now: float) -> None:
        """End the lease of an owner who is known to be gone, whatever its heartbeats said (SAFETY.md H05)."""
        self.tick(now)
        owner = self.lease.owner
        if owner is not None and owner.channel is channel:
            self.loss.begin(reason, now)

    def leave(self, now: float) -> None:
        """End all permission, since the gateway ends; `on_exit` says whether the drive is stopped (SAFETY.md H13)."""
        self.state.is_ending = True
        self.loss.leave(now)

    def _admit(self, command: Command, answer: Answer, now: float) -> None:
        state, permission = self.state, self._permission
        state.admission.check_right(command)
        if now > command.deadline:
            raise NotAdmitted(Reason.EXPIRED, "it came too late")
        if state.is_ending and not command.verb.is_stopping:
            raise NotAdmitted(Reason.ENDING, "the gateway ends")
        if command.verb.is_about_permission:
            permission.change(command, answer, now)
            return
        plan = state.admission.plan(command, state.facts, is_own=state.is_own(command.source, now))
        if plan.is_stop:
            permission.check_reach(now)
        else:
            permission.check_owner(command, now)
            permission.check_state(plan)
        if not state.queue.joins(command, answer):
            state.queue.put(Execution(command, plan.writes, answer, is_stop=plan.is_stop))
        if command.source == self.lease.owner:
            self.lease.renew(min(now, command.received))
