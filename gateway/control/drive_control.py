"""The control of one drive: who may command it, what waits for it, and when it is stopped or left alone.

Pure: it is told what happened and what time it is, and says which frame is next. The line asks it before each
exchange; whatever it is asked to do ends in exactly one result (SAFETY.md H03-H12).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from enum import Enum

from gateway.control import watchdog
from gateway.control.admission import EXECUTIVE, SETPOINTS, Admission, NotAdmitted, Plan
from gateway.control.command import GATEWAY, Answer, Command, Reason, Result, Source, Status, Verb
from gateway.control.composing import COMMAND, FREQUENCY, runs
from gateway.control.execution import Execution, Phase
from gateway.control.following import Following
from gateway.control.lease import Lease
from gateway.control.results import Results
from gateway.control.settings import ControlSettings, OnLoss
from gateway.control.stored import StoredWrites
from gateway.control.writes import Allowed, BadCommand, plan_write
from gateway.drives.register import Register
from gateway.errors import Refused
from gateway.protocol.pdu import ReadWords, Reply, Request, Words
from gateway.site import Drive

WAITING = 16  # commands of one drive that may wait
WATCHDOG_WITHIN = 10.0  # seconds for F803, F804 and F808 to be written after a drive has come
STOP_WITHIN = 1.0  # seconds for a stop after a lost lease to be read back, before the drive is left to its own F803
QUIET_BEYOND = 1.0  # seconds beyond F803 that a drive is left alone, so that it surely acts
RESET_WITHIN = 15.0  # seconds for a drive to come back after a fault reset
MARK = "reset_detection"  # FA87: set to 1 when a drive is armed; 0 after any reset (E6581657 7.1)
MARK_EVERY = 1.0  # seconds between two looks at it while the drive is armed
MARK_FRESH = 0.25  # seconds for which a look at it is believed before a run command


class Standing(Enum):
    """Whether the drive may be set in motion, and why not."""

    ARMED = "armed"
    DISARMED = "disarmed"
    LOST = "lost"  # permission has ended; on_loss is being done
    QUIET = "quiet"  # no frame is sent, so that the drive's own F803 acts


Telling = Callable[[str, str], None]  # an event and its reason, for whoever publishes them


@dataclass(frozen=True, slots=True, eq=False)
class Errand:
    """One frame for the drive: of a command, or a look at a register."""

    request: Request
    execution: Execution | None = None
    look: Register | None = None

    @property
    def is_stop(self) -> bool:
        """Say whether it goes ahead of everything on the line."""
        return self.execution is not None and self.execution.is_stop


@dataclass(slots=True)
class DriveControl:
    """One controlled drive. Times are monotonic seconds."""

    drive: Drive
    settings: ControlSettings
    tell: Telling
    stored: StoredWrites
    standing: Standing = Standing.DISARMED
    reason: str = "the gateway has started"
    is_online: bool = False
    is_heard: bool = False
    is_tripped: bool | None = None
    needs_set_up: bool = False  # the drive was reset: whoever reads it has to begin anew
    facts: dict[str, int] = field(default_factory=dict)
    lease: Lease = field(init=False)
    admission: Admission = field(init=False)
    _waiting: deque[Execution] = field(default_factory=deque)
    _results: Results = field(default_factory=Results)
    _quiet_until: float = 0.0
    _lost_at: float = 0.0
    _loss: OnLoss = OnLoss.STOP  # what is being done
    _following: Following | None = None
    _may_move: bool = False  # a run command was sent, and no stop was seen since
    _stop_again_at: float = 0.0
    _owes_stop: bool = False  # a stop could not be verified before the link was lost
    _unowned_since: float | None = None  # the drive was found running, and nobody has the lease
    _resetting: Execution | None = None
    _reset_by: float = 0.0
    _is_marked: bool = False
    _mark_seen: float = float("-inf")
    _is_ending: bool = False

    def __post_init__(self) -> None:
        self.lease = Lease(self.settings.lease)
        self.admission = Admission(self.drive, self.settings)

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

    def beat(self, source: Source, beat: object, now: float) -> bool:
        """Take a heartbeat; say whether it renewed the lease."""
        self.tick(now)
        return self.settings.may_write(source) and self.lease.beat(source, beat, now)

    def is_own(self, source: Source, now: float) -> bool:
        """Say whether a source may command more than stops."""
        return not self.settings.is_leased or (self.lease.is_held(now) and self.lease.owner == source)

    def _admit(self, command: Command, answer: Answer, now: float) -> None:
        self.admission.check_right(command)
        if now > command.deadline:
            raise NotAdmitted(Reason.EXPIRED, "it came too late")
        if self._is_ending:
            raise NotAdmitted(Reason.ENDING, "the gateway ends")
        if command.verb.is_about_permission:
            self._change_permission(command, answer, now)
            return
        plan = self.admission.plan(command, self.facts, is_own=self.is_own(command.source, now))
        if plan.is_stop:
            self._check_reach(command)
        else:
            self._check_owner(command, now)
            self._check_state(plan)
        if command.source == self.lease.owner:
            self.lease.renew(now)
        self._queue(command, plan, answer)

    def _check_owner(self, command: Command, now: float) -> None:
        if not self.is_own(command.source, now):
            raise NotAdmitted(Reason.NOT_OWNER, self._owner_text(now))

    def _owner_text(self, now: float) -> str:
        if self.standing is Standing.LOST:
            return f"{self.reason}: the drive is being stopped; take it again afterwards"
        if not self.lease.is_held(now):
            return f"nobody holds the lease of {self.drive.name}: take it first"
        return f"{self.lease.owner} holds the lease"

    def _check_reach(self, command: Command) -> None:
        """Refuse a stop that must not, or cannot, be sent."""
        if self.standing is Standing.QUIET:
            raise NotAdmitted(Reason.QUIESCED, f"the drive is left alone, so that its F803 stops it: {self.reason}")
        if not self.is_heard:
            self._owes_stop = True
            text = f"{self.drive.name} is not heard; if it comes back running, it is stopped"
            raise NotAdmitted(Reason.OFFLINE, text)

    def _check_state(self, plan: Plan) -> None:
        if self.standing is Standing.QUIET:
            raise NotAdmitted(Reason.QUIESCED, f"the drive is left alone: {self.reason}")
        if self.standing is Standing.LOST:
            raise NotAdmitted(Reason.NOT_OWNER, f"{self.reason}: the drive is being stopped")
        if self._resetting is not None:
            raise NotAdmitted(Reason.BUSY, "the drive is being reset")
        if not self.is_online:
            raise NotAdmitted(Reason.OFFLINE, f"{self.drive.name} is not online")
        if plan.is_motion and self.standing is not Standing.ARMED:
            raise NotAdmitted(Reason.NOT_ARMED, f"disarmed: {self.reason}")

    def _queue(self, command: Command, plan: Plan, answer: Answer) -> None:
        execution = Execution(command, plan.writes, answer, is_stop=plan.is_stop)
        if plan.is_stop:
            self._clear(Reason.STOPPED, f"{command.verb} came from {command.source}")
            self._waiting.appendleft(execution)
            return
        self._coalesce(command)
        if len(self._waiting) >= WAITING:
            raise NotAdmitted(Reason.BUSY, f"{WAITING} commands wait for this drive already")
        if plan.is_reset:
            self._disarm("the drive is reset")
        self._waiting.append(execution)

    def _coalesce(self, command: Command) -> None:
        """Let a newer setpoint take the place of one that still waits; run and stop keep their order."""
        if command.verb not in SETPOINTS:
            return
        same = [e for e in self._waiting if e.command.verb is command.verb and not e.was_sent and not e.is_begun]
        for execution in same:
            self._waiting.remove(execution)
            execution.finish(Status.REFUSED, Reason.SUPERSEDED, "a newer value came before it was sent")

    def announce(self, command: Command, answer: Answer, now: float) -> None:
        """Take a stop that every drive was told by one broadcast: it only has to be read back, else written."""
        self.submit(command, answer, now)
        if self._waiting and self._waiting[0].command is command:
            self._waiting[0].announced()

    # ---- permission

    def _change_permission(self, command: Command, answer: Answer, now: float) -> None:
        """Take, arm or release."""
        if command.verb is Verb.TAKE:
            self._take(command, now)
        elif command.verb is Verb.ARM:
            self._check_owner(command, now)
            self._check_armable()
            self.lease.renew(now)
            if self._mark_write(command, answer):
                return
            self._armed()
        else:
            self._check_owner(command, now)
            self._lose(f"released by {command.source}", now)
        answer(Result(command, Status.DONE))

    def _take(self, command: Command, now: float) -> None:
        if not self.settings.is_leased:
            return
        if self.standing in (Standing.LOST, Standing.QUIET):
            raise NotAdmitted(Reason.BUSY, f"the drive is {self.standing.value}: {self.reason}")
        if not self.lease.take(command.source, now):
            raise NotAdmitted(Reason.NOT_OWNER, self._owner_text(now))
        if self._unowned_since is not None:
            self._unowned_since, self._may_move = None, True
        self.tell("taken", str(command.source))

    def _check_armable(self) -> None:
        if self.standing in (Standing.LOST, Standing.QUIET):
            raise NotAdmitted(Reason.QUIESCED, f"the drive is {self.standing.value}: {self.reason}")
        if not self.is_online or self._resetting is not None:
            raise NotAdmitted(Reason.OFFLINE, f"{self.drive.name} is not online")
        if self.is_tripped:
            raise NotAdmitted(Reason.NOT_ARMED, "the drive is tripped: reset it first")
        if any(execution.command.source == GATEWAY for execution in self._waiting):
            raise NotAdmitted(Reason.BUSY, "F803, F804 and F808 are being set")
        if missing := self.unwatched():
            raise NotAdmitted(Reason.NO_WATCHDOG, missing)

    def _mark_write(self, command: Command, answer: Answer) -> bool:
        """Queue the mark that tells of a reset, where the model has it; say whether it has."""
        register = self.drive.model.registers.get(MARK)
        if register is None:
            return False
        write = plan_write(self.drive.model, self.drive.codec, self.drive.number, register, 1)

        def marked(result: Result) -> None:
            if result.status is not Status.DONE and result.reason is not Reason.REFUSED_BY_DRIVE:
                answer(result)
                return
            self._is_marked = result.status is Status.DONE
            try:
                self._check_armable()
            except NotAdmitted as refusal:
                answer(Result(command, Status.REFUSED, refusal.reason, str(refusal)))
                return
            self._armed()
            answer(Result(command, Status.DONE))

        self._waiting.append(Execution(command, (write,), marked))
        return True

    def _armed(self) -> None:
        self.standing, self.reason = Standing.ARMED, ""
        self.tell("armed", str(self.lease.owner or ""))

    def unwatched(self) -> str:
        """Say why the drive would go on running without a gateway; "" where it would not, or where that is waived."""
        return "" if self.settings.is_unwatched else watchdog.missing(self.drive.model, self.facts)

    def _disarm(self, reason: str) -> None:
        self._is_marked = False
        for execution in [e for e in self._waiting if not e.is_stop and _is_for_armed(e)]:
            self._end(execution, Reason.NOT_ARMED, f"disarmed: {reason}")
        if self.standing is Standing.ARMED:
            self.standing, self.reason = Standing.DISARMED, reason
            self.tell("disarmed", reason)
        elif self.standing is Standing.DISARMED:
            self.reason = reason

    def _clear(self, reason: Reason, text: str) -> None:
        """End everything that waits."""
        for execution in tuple(self._waiting):
            self._end(execution, reason, text)

    def _end(self, execution: Execution, reason: Reason, text: str) -> None:
        self._waiting.remove(execution)
        execution.finish(Status.UNKNOWN if execution.was_sent else Status.REFUSED, reason, text)

    # ---- what happens to the drive

    def on_heard(self, *, is_heard: bool) -> None:
        """Take whether the drive is there at all, whoever it is: stops may then be sent."""
        self.is_heard = is_heard

    def on_online(self, facts: Mapping[str, int], signs: Mapping[str, bool], now: float) -> None:
        """Take that the drive is identified and observed: how it is set, and whether it is tripped."""
        if self.is_online:
            return
        self.is_online, self.is_heard, self.needs_set_up = True, True, False
        self.facts = dict(facts)
        self._is_marked = False
        if signs:
            self.on_trip(any(signs.values()))
        self._finish_reset()
        self._set_watchdog(now)
        command = self.drive.model.registers.get(COMMAND)
        is_running = command is not None and runs(command, self.facts.get(COMMAND, 0)) and not self.is_tripped
        owed, self._owes_stop = self._owes_stop, False
        if not is_running:
            self._may_move = False
        elif owed:
            self._stop_for_loss("a stop was not verified before the link was lost", now)
        elif not self.settings.is_leased or self.lease.is_held(now):
            self._may_move = True
        else:
            self._unowned_since = now
            self.tell("unowned", "it runs by command, and nobody holds the lease")

    def on_offline(self, reason: str, now: float) -> None:
        """Take that the link is lost: the drive is disarmed, and nothing that waited is sent later."""
        is_stop_pending = any(e.is_stop for e in self._waiting) or self.standing is Standing.LOST
        was_online, self.is_online, self.is_heard = self.is_online, False, False
        self.is_tripped = None
        self._unowned_since = None
        self._clear(Reason.OFFLINE, reason)
        self._following = None
        if is_stop_pending and self.standing is not Standing.QUIET:
            self._unverified(f"a stop was not verified: {reason}", now)
        if was_online:
            self._disarm(f"the link was lost: {reason}")

    def _unverified(self, reason: str, now: float) -> None:
        """Leave a drive alone that could not be seen to stop; stop it when it comes back where that is no help."""
        self._owes_stop, self._stop_again_at = True, now + STOP_WITHIN
        if self._timeout() > 0 and not watchdog.missing(self.drive.model, self.facts):
            self._quiesce(reason, now)
        elif self.standing is Standing.LOST:
            self.standing, self.reason = Standing.DISARMED, reason
            self.tell("not_stopped", reason)

    def on_trip(self, is_tripped: bool | None) -> None:
        """Take whether the drive is tripped."""
        if is_tripped is None:
            return
        if is_tripped:
            for execution in tuple(self._waiting):
                execution.on_tripped()
                self._settle(execution)
            if self._following is not None:
                self._following.is_seen = True
            if not self.is_tripped:
                self._disarm("the drive has tripped")
            self._may_move = False
        self.is_tripped = is_tripped

    def on_reset(self, reason: str) -> None:
        """Take a reset of the drive that it was not seen to vanish for: its RAM is gone, so it is set up anew."""
        self.needs_set_up = True
        self._may_move = False
        self._clear(Reason.OFFLINE, reason)
        self._disarm(reason)

    def _set_watchdog(self, now: float) -> None:
        """Set F804, F808 and F803 as configured where they read otherwise: nobody has to ask for that."""
        model = self.drive.model
        for register, word in watchdog.wanted(self.settings, model, self.facts):
            command = Command(self.drive.name, Verb.SET, GATEWAY, now, now + WATCHDOG_WITHIN, name=register.name)
            allowed = Allowed(stored=not self.drive.codec.forms.has_ram_write)
            try:
                write = plan_write(model, self.drive.codec, self.drive.number, register, word, allowed, self.facts)
            except BadCommand as error:
                self.tell("watchdog", str(error))
                return
            self._waiting.append(Execution(command, (write,), self._after_watchdog))

    def _after_watchdog(self, result: Result) -> None:
        name = result.command.name
        if result.status is not Status.DONE:
            self.tell("watchdog", f"{name} could not be set: {result.text or result.reason}")

    # ---- the end of permission

    def tick(self, now: float) -> None:
        """Look at the time: end leases that ran out, and what they leave to be done."""
        if self.settings.is_leased and self.lease.is_over(now):
            self._lose(f"the lease of {self.lease.owner} has ended", now)
        if self.standing is Standing.LOST:
            self._look_at_stop(now)
        if self._unowned_since is not None and now >= self._unowned_since + self._grace:
            self._unowned_since = None
            if not watchdog.missing(self.drive.model, self.facts):
                self._owes_stop = False
                self._quiesce("it runs, and nobody holds the lease", now)
        if self.standing is Standing.QUIET and now >= self._quiet_until:
            self.standing = Standing.DISARMED
            self.tell("awake", self.reason)
        if self._owes_stop and self._is_stop_again(now):
            self._owes_stop = False
            self._stop_for_loss(self.reason, now)
        self._give_up_reset(now)

    def _is_stop_again(self, now: float) -> bool:
        """Say whether a drive that has no F803 to stop it is to be told once more."""
        return self.is_online and self.standing is Standing.DISARMED and now >= self._stop_again_at

    @property
    def _grace(self) -> float:
        """Return how long a drive that was found running may wait for an owner: only where `hold` is wanted."""
        return 0.0 if self.settings.stops_on_exit else self.settings.lease

    def _lose(self, reason: str, now: float) -> None:
        """End the permission, and do what is configured for that."""
        self.lease.end()
        self._clear(Reason.NOT_OWNER, reason)
        self.tell("lease_lost", reason)
        loss = self.settings.on_loss
        if loss is OnLoss.HOLD or not self._may_move:
            self._disarm(reason)
            return
        if self.standing is Standing.QUIET:
            return
        if not self.is_heard or loss is OnLoss.QUIESCE:
            self._disarm(reason)
            self._unverified(reason, now)
            return
        self._stop_for_loss(reason, now)

    def _stop_for_loss(self, reason: str, now: float) -> None:
        self._disarm(reason)
        self.standing, self.reason, self._lost_at = Standing.LOST, reason, now
        self._loss = self.settings.on_loss
        self._command_by_gateway(_VERBS.get(self._loss, Verb.STOP), now, self.settings.fallback)

    def _command_by_gateway(self, verb: Verb, now: float, value: Decimal | None = None) -> None:
        """Queue a stop, or the fallback frequency, of the gateway itself: ahead of everything."""
        command = Command(self.drive.name, verb, GATEWAY, now, now + STOP_WITHIN, value=value)
        try:
            plan = self.admission.plan(command, self.facts, is_own=True)
        except NotAdmitted as refusal:
            self._unverified(str(refusal), now)
            return
        self._clear(Reason.STOPPED, self.reason)
        self._waiting.appendleft(Execution(command, plan.writes, self._after_loss, is_stop=True))

    def _after_loss(self, result: Result) -> None:
        """Take the end of what was done for a lost lease."""
        if self.standing is not Standing.LOST:
            return
        if result.status is Status.DONE and self._loss is not OnLoss.FREQUENCY:
            self._following = Following(self.drive.model, self._lost_at)
            self._following.is_seen |= self.is_tripped is True
        elif result.status is Status.DONE:
            self._settled()

    def _look_at_stop(self, now: float) -> None:
        """End the loss when the motor was seen to stop, or leave the drive to its F803 when it was not."""
        if self._following is not None and self._following.is_seen:
            self._settled()
        elif self._following is not None:
            if self._following.is_late(now):
                self._following = None
                self._unverified("its motor was not seen to stop", now)
        elif not self._waiting or now > self._lost_at + STOP_WITHIN:
            self._clear(Reason.NOT_READ_BACK, "the drive was not seen to stop")
            self._unverified("it could not be stopped", now)

    def _settled(self) -> None:
        self._following = None
        self.standing = Standing.DISARMED
        self.tell("on_loss", f"{self._loss.value}: done")

    def _quiesce(self, reason: str, now: float) -> None:
        """Send the drive no frame any more, so that its own F803 acts (SAFETY.md H05)."""
        self._disarm(reason)
        self.standing, self.reason = Standing.QUIET, reason
        self._quiet_until = now + self._timeout() + QUIET_BEYOND
        self._clear(Reason.QUIESCED, reason)
        self.tell("quiesced", reason)

    def _timeout(self) -> float:
        return watchdog.seconds(self.drive.model, self.facts)

    def leave(self, now: float) -> None:
        """End all permission, since the gateway ends; `on_exit` says whether the drive is stopped (SAFETY.md H13)."""
        self._is_ending = True
        self.lease.end()
        self._clear(Reason.ENDING, "the gateway ends")
        if self.settings.stops_on_exit and self._may_move and self.standing in (Standing.ARMED, Standing.DISARMED):
            if self.is_heard:
                self._disarm("the gateway ends")
                self.standing, self.reason, self._lost_at = Standing.LOST, "the gateway ends", now
                self._loss = OnLoss.STOP
                self._command_by_gateway(Verb.STOP, now)
        else:
            self._disarm("the gateway ends")

    @property
    def is_settled(self) -> bool:
        """Say whether nothing is left to be done for it."""
        return self.standing is not Standing.LOST and not self._waiting

    # ---- a fault reset

    def _begin_reset(self, execution: Execution, now: float) -> None:
        """Take that a fault reset was sent: the drive is silent, and comes back with its RAM gone (E6581657 7.1)."""
        self._waiting.remove(execution)
        self._resetting, self._reset_by = execution, now + RESET_WITHIN
        self.on_reset("the drive was reset")
        self.is_online = False
        self.is_tripped = None

    def _finish_reset(self) -> None:
        execution = self._resetting
        if execution is None or self.is_tripped is None:
            return
        self._resetting = None
        if self.is_tripped:
            execution.finish(Status.FAILED, Reason.STILL_TRIPPED, "the drive is still tripped")
        else:
            execution.finish(Status.DONE)

    def _give_up_reset(self, now: float) -> None:
        if self._resetting is not None and now > self._reset_by:
            execution, self._resetting = self._resetting, None
            execution.finish(Status.UNKNOWN, Reason.NO_ANSWER, "the drive has not come back after the reset")

    # ---- towards the line

    @property
    def is_quiet(self) -> bool:
        """Say whether nothing at all is to be sent to the drive."""
        return self.standing is Standing.QUIET

    @property
    def is_exclusive(self) -> bool:
        """Say whether the drive is to be sent nothing but its stop: a read would keep its F803 from acting."""
        return self.standing is Standing.LOST and self._following is None

    @property
    def has_stop(self) -> bool:
        """Say whether a stop waits."""
        return bool(self._waiting) and self._waiting[0].is_stop

    def next_time(self) -> float:
        """Return when `tick` or `next` has to be asked again at the latest."""
        times = [self.lease.until] if self.lease.owner is not None else []
        if self._unowned_since is not None:
            times.append(self._unowned_since + self._grace)
        if self.standing is Standing.QUIET:
            times.append(self._quiet_until)
        if self.standing is Standing.LOST:
            times.append(self._following.due if self._following is not None else self._lost_at + STOP_WITHIN)
        if self._resetting is not None:
            times.append(self._reset_by)
        if self._owes_stop and self.is_online:
            times.append(self._stop_again_at)
        if self._watches_mark:
            times.append(self._mark_seen + MARK_EVERY)
        return min(times, default=float("inf"))

    @property
    def _watches_mark(self) -> bool:
        return self._is_marked and self.is_online and self.standing is Standing.ARMED

    def next(self, now: float) -> Errand | None:
        """Return the next frame for this drive; None where none waits."""
        if self.standing is Standing.QUIET:
            return None
        while self._waiting:
            errand = self._next_of(self._waiting[0], now)
            if errand is not None:
                return errand
            if self._waiting and self._waiting[0].is_reserving:
                break
        return self._next_look(now)

    def _next_of(self, execution: Execution, now: float) -> Errand | None:
        """Return the next frame of the command whose turn it is; it is made up when it begins."""
        if not execution.is_begun and not self._begin(execution, now):
            return None
        if execution.is_to_be_counted:
            self.stored.reserve(execution, now)
            return None
        if self._is_mark_old(execution, now):
            return self._look(self.drive.model.registers[MARK])
        request = execution.next(now)
        if request is None:
            self._settle(execution)
            return None
        return Errand(request, execution)

    def _begin(self, execution: Execution, now: float) -> bool:
        """Make up the writes of a command from what the drive holds now; say whether it may be sent."""
        command = execution.command
        if command.verb is Verb.ARM or (command.source == GATEWAY and command.verb is Verb.SET):
            execution.plan(execution.writes)
            return True
        try:
            is_own = command.source == GATEWAY or self.is_own(command.source, now)
            plan = self.admission.plan(command, self.facts, is_own=is_own)
            if not plan.is_stop and not execution.is_stop:
                self._check_state(plan)
        except NotAdmitted as refusal:
            self._waiting.remove(execution)
            execution.finish(Status.REFUSED, refusal.reason, str(refusal))
            return False
        execution.plan(plan.writes)
        return True

    def _is_mark_old(self, execution: Execution, now: float) -> bool:
        """Say whether the drive may have been reset unseen, and a run command has to wait for a look at FA87."""
        is_first = execution.phase is Phase.WRITING and not execution.is_stop and _is_for_armed(execution)
        return self._watches_mark and is_first and now > self._mark_seen + MARK_FRESH

    def _next_look(self, now: float) -> Errand | None:
        if self._following is not None:
            register = self._following.next(now)
            return self._look(register) if register is not None else None
        if self._watches_mark and now >= self._mark_seen + MARK_EVERY and not self._waiting:
            return self._look(self.drive.model.registers[MARK])
        return None

    def _look(self, register: Register) -> Errand:
        return Errand(ReadWords(self.drive.number, register.address), look=register)

    def sending(self, errand: Errand) -> None:
        """Take note that the frame leaves now."""
        execution = errand.execution
        if execution is None:
            return
        execution.sending()
        if execution.phase is Phase.WRITING and execution.write.may_start and not execution.is_stop:
            self._may_move = True

    def on_reply(self, errand: Errand, reply: Reply | None, now: float) -> None:
        """Take an answer; None where none was to be expected."""
        if errand.look is not None:
            if isinstance(reply, Words):
                self._seen(errand.look, reply.words[0], now)
            return
        execution = errand.execution
        if execution is None:
            return
        if reply is None and not execution.write.is_answered:
            self._begin_reset(execution, now)
            return
        execution.on_reply(reply)
        self._settle(execution)

    def _seen(self, register: Register, word: int, now: float) -> None:
        if self._following is not None:
            self._following.take(register, word)
            self._look_at_stop(now)
        if register.name == MARK:
            self._mark_seen = now
            if word == 0 and self._is_marked:
                self.on_reset("the drive was reset")

    def on_refused(self, errand: Errand, refused: Refused) -> None:
        """Take a refusal."""
        if errand.look is not None and errand.look.name == MARK:
            self._is_marked = False
        if errand.execution is not None:
            errand.execution.on_refused(refused)
            self._settle(errand.execution)

    def on_silence(self, errand: Errand, text: str, now: float) -> None:
        """Take silence, or bytes that are no answer."""
        if errand.execution is not None:
            if not errand.execution.write.is_answered and errand.execution in self._waiting:
                self._begin_reset(errand.execution, now)  # bytes of noise where silence was expected
                return
            errand.execution.on_silence(text)
            self._settle(errand.execution)
            if errand.execution.is_stop and errand.execution.status is Status.UNKNOWN:
                self._unverified(f"a stop was not answered: {text}", now)

    def _settle(self, execution: Execution) -> None:
        """Drop what is over, and remember what the drive holds now."""
        self.facts.update(execution.read_back)
        if execution.is_over and execution in self._waiting:
            self._waiting.remove(execution)
        if execution.has_stopped and _is_stop_of_motion(execution):
            self._may_move = False


def _is_for_armed(execution: Execution) -> bool:
    """Say whether a waiting command is one that only an armed drive is given."""
    is_run_word = any(w.register.name == COMMAND and runs(w.register, w.word) for w in execution.writes)
    return execution.command.verb in (*EXECUTIVE, Verb.ARM) or is_run_word


def _is_stop_of_motion(execution: Execution) -> bool:
    """Say whether it ends the motion: the fallback frequency does not."""
    return execution.writes[0].register.name != FREQUENCY


_VERBS = {
    OnLoss.STOP: Verb.STOP,
    OnLoss.COAST: Verb.COAST,
    OnLoss.EMERGENCY_STOP: Verb.EMERGENCY_STOP,
    OnLoss.FREQUENCY: Verb.FREQUENCY,
}
