"""The control of one drive: who may command it, what waits for it, and which frame is next.

Pure: it is told what happened and what time it is. The line asks it before each exchange; whatever it is asked to do
ends in exactly one result (SAFETY.md H03-H12).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.control import watchdog
from gateway.control.admission import NotAdmitted, Plan
from gateway.control.command import GATEWAY, Answer, Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.composing import FREQUENCY
from gateway.control.execution import Execution
from gateway.control.lease import Lease
from gateway.control.loss import Loss
from gateway.control.resets import CLEARED, Resets
from gateway.control.results import Results
from gateway.control.settings import ControlSettings
from gateway.control.state import DriveState, Errand, Standing
from gateway.control.stored import StoredWrites
from gateway.control.writes import Allowed, BadCommand, plan_write
from gateway.errors import Refused
from gateway.protocol.pdu import Reply, Words
from gateway.site import Drive

log = logging.getLogger("gateway.control")

WATCHDOG_WITHIN = 10.0  # seconds for F803, F804 and F808 to be written after a drive has come


@dataclass(slots=True)
class DriveControl:
    """One controlled drive. Times are monotonic seconds."""

    state: DriveState
    stored: StoredWrites
    loss: Loss = field(init=False)
    resets: Resets = field(init=False)
    _results: Results = field(default_factory=Results)

    def __post_init__(self) -> None:
        self.loss = Loss(self.state)
        self.resets = Resets(self.state)

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
    def is_settled(self) -> bool:
        """Say whether nothing is left to be done for it."""
        return self.standing is not Standing.LOST and not self.state.queue

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

    def _admit(self, command: Command, answer: Answer, now: float) -> None:
        state = self.state
        state.admission.check_right(command)
        if now > command.deadline:
            raise NotAdmitted(Reason.EXPIRED, "it came too late")
        if state.is_ending and not command.verb.is_stopping:
            raise NotAdmitted(Reason.ENDING, "the gateway ends")
        if command.verb.is_about_permission:
            self._change_permission(command, answer, now)
            return
        plan = state.admission.plan(command, state.facts, is_own=state.is_own(command.source, now))
        if plan.is_stop:
            self._check_reach(now)
        else:
            self._check_owner(command, now)
            self._check_state(plan)
        if not state.queue.joins(command, answer):
            state.queue.put(Execution(command, plan.writes, answer, is_stop=plan.is_stop))
        if command.source == self.lease.owner:
            self.lease.renew(min(now, command.received))

    def _check_owner(self, command: Command, now: float) -> None:
        if not self.state.is_own(command.source, now):
            raise NotAdmitted(Reason.NOT_OWNER, self._owner_text(now))

    def _owner_text(self, now: float) -> str:
        if self.standing is Standing.LOST:
            return f"{self.reason}: the drive is being stopped; take it again afterwards"
        if not self.lease.is_held(now):
            return f"nobody holds the lease of {self.drive.name}: take it first"
        return f"{self.lease.owner} holds the lease"

    def _check_reach(self, now: float) -> None:
        """Refuse a stop that must not, or cannot, be sent."""
        if self.standing is Standing.QUIET:
            raise NotAdmitted(Reason.QUIESCED, f"the drive is left alone, so that its F803 stops it: {self.reason}")
        if not self.state.is_heard:
            self.loss.owe()
            if self.state.may_move:  # no read may start its F803 anew before the stop is sent
                self.loss.unverified("a stop came while the drive was not heard", now)
            text = f"{self.drive.name} is not heard; if it comes back running, it is stopped"
            raise NotAdmitted(Reason.OFFLINE, text)

    def _check_state(self, plan: Plan) -> None:
        if self.standing is Standing.QUIET:
            raise NotAdmitted(Reason.QUIESCED, f"the drive is left alone: {self.reason}")
        if self.standing is Standing.LOST:
            raise NotAdmitted(Reason.NOT_OWNER, f"{self.reason}: the drive is being stopped")
        if self.resets.is_under_way:
            raise NotAdmitted(Reason.BUSY, "the drive is being reset")
        if not self.state.is_online:
            raise NotAdmitted(Reason.OFFLINE, f"{self.drive.name} is not online")
        if plan.is_motion and self.standing is not Standing.ARMED:
            raise NotAdmitted(Reason.NOT_ARMED, f"disarmed: {self.reason}")
        if plan.is_motion and self.state.unwatched and not self.settings.is_unwatched:
            raise NotAdmitted(Reason.NO_WATCHDOG, self.state.unwatched)

    # ---- permission

    def _change_permission(self, command: Command, answer: Answer, now: float) -> None:
        """Take, arm or release."""
        if command.verb is Verb.TAKE:
            self._take(command, now)
        elif command.verb is Verb.RELEASE:
            self._check_owner(command, now)
            self.loss.begin(f"released by {command.source}", now, "released")
        else:
            self._check_owner(command, now)
            self._check_armable()
            self.lease.renew(min(now, command.received))
            marking = self.resets.marking(command, answer, self._arm)
            if marking is not None:
                self.state.queue.put(marking)
                return
            self._arm()
        answer(Result(command, Status.DONE))

    def _take(self, command: Command, now: float) -> None:
        if not self.settings.is_leased:
            return
        if self.standing in (Standing.LOST, Standing.QUIET):
            raise NotAdmitted(Reason.BUSY, f"the drive is {self.standing.value}: {self.reason}")
        is_new = self.lease.owner is None
        if not self.lease.take(command.source, min(now, command.received)):
            raise NotAdmitted(Reason.NOT_OWNER, self._owner_text(now))
        self.loss.taken()
        if is_new:
            self.state.tell("taken", str(command.source))

    def _check_armable(self) -> None:
        state = self.state
        if self.standing in (Standing.LOST, Standing.QUIET):
            raise NotAdmitted(Reason.QUIESCED, f"the drive is {self.standing.value}: {self.reason}")
        if not state.is_online or self.resets.is_under_way:
            raise NotAdmitted(Reason.OFFLINE, f"{self.drive.name} is not online")
        if state.is_tripped:
            raise NotAdmitted(Reason.NOT_ARMED, "the drive is tripped: reset it first")
        if state.queue.is_setting_up:
            raise NotAdmitted(Reason.BUSY, "F803, F804 and F808 are being set")
        if state.unwatched and not self.settings.is_unwatched:
            raise NotAdmitted(Reason.NO_WATCHDOG, state.unwatched)

    def _arm(self) -> None:
        self._check_armable()
        self.state.standing, self.state.reason = Standing.ARMED, ""
        self.state.tell("armed", str(self.lease.owner or ""))

    def leave(self, now: float) -> None:
        """End all permission, since the gateway ends; `on_exit` says whether the drive is stopped (SAFETY.md H13)."""
        self.state.is_ending = True
        self.loss.leave(now)

    # ---- what happens to the drive

    def on_heard(self, now: float) -> None:
        """Take that the drive is there, whoever it is: stops may be sent."""
        self.state.is_heard = True
        if not self.state.is_online:
            self.loss.heard(now)

    def on_online(self, facts: Mapping[str, int], signs: Mapping[str, bool], now: float) -> None:
        """Take that the drive is identified and observed: how it is set, and whether it is tripped."""
        state = self.state
        if state.is_online:
            return
        state.is_online, state.is_heard, state.needs_set_up, state.is_marked = True, True, False, False
        state.facts = dict(facts)
        if signs:
            self.on_trip(is_tripped=any(signs.values()))
        self.resets.came_back()
        if self.resets.is_stop_lost:
            self.resets.is_stop_lost = False
            self.loss.owe()
        if state.is_running:
            self.loss.found_running(now)
        else:
            self.loss.found_standing()
        self._set_watchdog(now)

    def on_offline(self, reason: str, now: float) -> None:
        """Take that the link is lost: the drive is disarmed, and nothing that waited is sent later."""
        state = self.state
        is_stop_pending = state.queue.has_stop or self.standing is Standing.LOST
        was_online, state.is_online, state.is_heard = state.is_online, False, False
        state.is_tripped = None
        state.carrying.form = None
        state.queue.clear(Reason.OFFLINE, reason)
        self.loss.link_lost(is_stop_pending=is_stop_pending, reason=reason, now=now)
        if was_online:
            state.disarm(f"the link was lost: {reason}")

    def on_trip(self, is_tripped: bool | None) -> None:
        """Take whether the drive is tripped; None where an answer does not say."""
        state = self.state
        if is_tripped is None:
            return
        was_tripped, state.is_tripped = state.is_tripped, is_tripped
        if was_tripped and not is_tripped and state.is_online:
            self.resets.on_reset(CLEARED)  # nothing else ends a trip: what it had in its RAM is gone (7.1)
        if not is_tripped:
            return
        for execution in tuple(state.queue.executions):
            execution.on_tripped()
            self._settle(execution)
        self.loss.tripped()
        if not was_tripped:
            state.disarm("the drive has tripped")

    def _set_watchdog(self, now: float) -> None:
        """Set F804, F808 and F803 as configured where they read otherwise: nobody has to ask for that."""
        state, model, codec = self.state, self.drive.model, self.drive.codec
        for register, word in watchdog.wanted(self.settings, model, state.facts):
            command = Command(self.drive.name, Verb.SET, GATEWAY, now, now + WATCHDOG_WITHIN, name=register.name)
            allowed = Allowed(stored=not codec.forms.has_ram_write)
            try:
                write = plan_write(model, codec, self.drive.number, register, word, allowed, state.facts)
            except BadCommand as error:
                state.tell("watchdog", str(error))
                return
            execution = Execution(command, (write,), self._after_watchdog)
            execution.plan((write,))
            state.queue.put(execution)

    def _after_watchdog(self, result: Result) -> None:
        if result.status is not Status.DONE:
            self.state.tell("watchdog", f"{result.command.name} could not be set: {result.text or result.reason}")

    # ---- towards the line

    def tick(self, now: float) -> None:
        """Look at the time: leases that ran out, stops that were not seen, resets that take too long."""
        self.loss.tick(now)
        self.resets.tick(now)

    def next_time(self) -> float:
        """Return when `tick` or `next` has to be asked again at the latest."""
        waiting = self.state.queue.head.command.deadline if self.state.queue else float("inf")
        return min(self.loss.next_time(), self.resets.next_time(), waiting)

    def next(self, now: float) -> Errand | None:
        """Return the next frame for this drive; None where none waits."""
        if self.standing is Standing.QUIET:
            return None
        while self.state.queue:
            errand = self._next_of(self.state.queue.head, now)
            if errand is not None:
                return errand
            if self.state.queue and self.state.queue.head.is_to_be_counted:
                break
        return self.loss.next_look(now) or self.resets.next_look(now)

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
        command = execution.command
        if command.verb is Verb.ARM:
            execution.plan(execution.writes)
            return True
        try:
            plan = self.state.admission.plan(command, self.facts, is_own=self.state.is_own(command.source, now))
            if not execution.is_stop:
                self._check_state(plan)
        except NotAdmitted as refusal:
            self.state.queue.remove(execution)
            execution.finish(Status.REFUSED, refusal.reason, str(refusal))
            return False
        execution.plan(plan.writes)
        execution.beside = plan.beside
        if plan.is_reset:
            self.state.disarm("the drive is being reset")
        return True

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
            self.loss.seen(errand.look, reply.words[0], now)
            self.resets.seen(errand.look, reply.words[0], now)
            if errand.look.name == "trip_code" and reply.words[0]:
                self.on_trip(is_tripped=True)
        elif execution is not None and not execution.write.is_answered:
            self.resets.sent(execution, now)
        elif execution is not None:
            execution.on_reply(reply)
            self._settle(execution)

    def on_refused(self, errand: Errand, refused: Refused) -> None:
        """Take a refusal."""
        if errand.look is not None:
            self.resets.refused(errand.look, refused.reason)
        if errand.execution is not None:
            errand.execution.on_refused(refused)
            self._settle(errand.execution)

    def on_silence(self, errand: Errand, text: str, now: float) -> None:
        """Take silence, or bytes that are no answer."""
        execution = errand.execution
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
        """Drop what is over, and remember what the drive holds now."""
        self.state.facts.update(execution.read_back)
        if self.standing is Standing.ARMED and self.state.unwatched and not self.settings.is_unwatched:
            self.state.disarm(self.state.unwatched)
        if execution.is_over:
            self.state.queue.remove(execution)
        if execution.has_stopped and execution.writes[0].register.name != FREQUENCY:
            self.state.may_move = False
            self.loss.stopped()
