"""The control of one drive: who may command it, what waits for it, and when it is stopped or left alone.

Pure: it is told what happened and what time it is, and says which frame is next. The line asks it before each
exchange; whatever it is asked to do ends in exactly one result (SAFETY.md H03-H12).
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal
from enum import Enum

from gateway.control import watchdog
from gateway.control.command import GATEWAY, Answer, Command, Reason, Result, Source, Status, Verb
from gateway.control.composing import COMMAND, FREQUENCY, NotComposable, compose
from gateway.control.execution import Execution
from gateway.control.lease import Lease
from gateway.control.settings import ControlSettings, OnLoss
from gateway.control.writes import Allowed, BadCommand, PlannedWrite, Why, plan_write
from gateway.drives.register import Register
from gateway.errors import Refused
from gateway.protocol.pdu import Reply, Request
from gateway.site import Drive

WAITING = 16  # commands of one drive that may wait
REMEMBERED = 256  # results by id, so that a repeated command acts once (SAFETY.md H03)
WATCHDOG_WITHIN = 10.0  # seconds for F803, F804 and F808 to be written after a drive has come
STOP_WITHIN = 1.0  # seconds for a stop after a lost lease to be read back, before the drive is left to its own F803
QUIET_BEYOND = 1.0  # seconds beyond F803 that a drive is left alone, so that it surely acts
EXECUTIVE = (Verb.RUN, Verb.JOG, Verb.PRESET)  # what sets a motor in motion

REASONS = {
    Why.READ_ONLY: Reason.READ_ONLY,
    Why.FORBIDDEN: Reason.FORBIDDEN,
    Why.KEYS: Reason.FORBIDDEN,
    Why.RANGE: Reason.RANGE,
    Why.STORED: Reason.STORED,
    Why.NO_EFFECT: Reason.STORED,
    Why.NO_FORM: Reason.FORBIDDEN,
}


class Standing(Enum):
    """Whether the drive may be set in motion, and why not."""

    ARMED = "armed"
    DISARMED = "disarmed"
    LOST = "lost"  # the lease has ended; on_loss is being done
    QUIET = "quiet"  # no frame is sent, so that the drive's own F803 acts


Telling = Callable[[str, str], None]  # an event and its reason, for whoever publishes them


class Refusal(Exception):
    """A command that is not admitted."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason = reason


@dataclass(slots=True)
class DriveControl:
    """One controlled drive. Times are monotonic seconds."""

    drive: Drive
    settings: ControlSettings
    tell: Telling
    standing: Standing = Standing.DISARMED
    reason: str = "the gateway has started"
    is_online: bool = False
    is_tripped: bool | None = None
    facts: dict[str, int] = field(default_factory=dict)
    lease: Lease = field(init=False)
    _waiting: deque[Execution] = field(default_factory=deque)
    _results: OrderedDict[tuple[Source, str], Result | None] = field(default_factory=OrderedDict)
    _quiet_until: float = 0.0
    _lost_at: float = 0.0
    _may_move: bool = False  # a run command was sent since the drive was last seen to stand by our stop

    def __post_init__(self) -> None:
        self.lease = Lease(self.settings.lease)

    # ---- northbound

    def submit(self, command: Command, answer: Answer, now: float) -> None:
        """Take a command; its result comes by `answer`, at once where it is refused."""
        key = (command.source, command.id)
        if command.id and key in self._results:
            known = self._results[key]
            if known is not None:
                answer(known)
            else:
                answer(Result(command, Status.REFUSED, Reason.BUSY, "this id is being carried out"))
            return
        told = self._remembering(key, answer)
        try:
            self._admit(command, told, now)
        except Refusal as refusal:
            told(Result(command, Status.REFUSED, refusal.reason, str(refusal)))

    def _remembering(self, key: tuple[Source, str], answer: Answer) -> Answer:
        if not key[1]:
            return answer
        self._results[key] = None
        while len(self._results) > REMEMBERED:
            self._results.popitem(last=False)

        def told(result: Result) -> None:
            self._results[key] = result
            answer(result)

        return told

    def beat(self, source: Source, beat: object, now: float) -> bool:
        """Take a heartbeat; say whether it renewed the lease."""
        return self.settings.may_write(source) and self.lease.beat(source, beat, now)

    def _admit(self, command: Command, answer: Answer, now: float) -> None:
        self._check_source(command, now)
        if command.verb.is_about_permission:
            self._change_permission(command, answer, now)
            return
        self._check_state(command)
        writes = self._plan(command)
        if command.verb.is_stopping:
            self._clear(Reason.STOPPED, "a stop came")
            self._waiting.appendleft(Execution(command, writes, answer, is_persistent=True))
            return
        if command.verb is Verb.RESET:
            self._disarm("the drive is reset")
        self._coalesce(command, writes)
        if len(self._waiting) >= WAITING:
            raise Refusal(Reason.BUSY, f"{WAITING} commands wait for this drive already")
        self._waiting.append(Execution(command, writes, answer))

    def _check_source(self, command: Command, now: float) -> None:
        if not self.settings.may_write(command.source):
            raise Refusal(Reason.NOT_PERMITTED, f"{command.source} may not write to {self.drive.name}")
        if not self.settings.permits_verb(command):
            raise Refusal(Reason.NOT_PERMITTED, f"{command.source} has no right to {command.verb}")
        if now > command.deadline:
            raise Refusal(Reason.EXPIRED, "it came too late")
        if self.settings.is_leased and not command.verb.is_stopping and not self.lease.take(command.source, now):
            raise Refusal(Reason.NOT_OWNER, self._owner_text(now))

    def _owner_text(self, now: float) -> str:
        if self.lease.is_over(now) or self.standing is Standing.LOST:
            return "the lease has ended and is being dealt with; take it again afterwards"
        return f"{self.lease.owner} holds the lease"

    def _change_permission(self, command: Command, answer: Answer, now: float) -> None:
        """Arm, take or release: nothing is sent."""
        if command.verb is Verb.ARM:
            self._arm()
        elif command.verb is Verb.RELEASE:
            if self.settings.is_leased and not self.lease.release(command.source):
                raise Refusal(Reason.NOT_OWNER, self._owner_text(now))
            self._disarm("released")
        answer(Result(command, Status.DONE))

    def _arm(self) -> None:
        if not self.is_online:
            raise Refusal(Reason.OFFLINE, "the drive is not online")
        if self.is_tripped:
            raise Refusal(Reason.NOT_ARMED, "the drive is tripped: reset it first")
        if self.standing in (Standing.LOST, Standing.QUIET):
            raise Refusal(Reason.QUIESCED, f"the drive is {self.standing.value}: {self.reason}")
        if missing := self.unwatched():
            raise Refusal(Reason.NO_WATCHDOG, missing)
        self.standing, self.reason = Standing.ARMED, ""
        self.tell("armed", "")

    def unwatched(self) -> str:
        """Say why the drive would go on running without a gateway; "" where it would not, or where that is waived."""
        if self.settings.is_unwatched:
            return ""
        return watchdog.missing(self.drive.model, self.facts)

    def _check_state(self, command: Command) -> None:
        if self.standing is Standing.QUIET:
            raise Refusal(Reason.QUIESCED, f"the drive is left alone: {self.reason}")
        if not self.is_online:
            raise Refusal(Reason.OFFLINE, "the drive is not online")
        if command.verb.is_stopping:
            return
        if self.standing is Standing.LOST:
            raise Refusal(Reason.NOT_OWNER, f"{self.reason}: the drive is being stopped")
        if command.verb in EXECUTIVE and self.standing is not Standing.ARMED:
            raise Refusal(Reason.NOT_ARMED, f"disarmed: {self.reason}")

    def _plan(self, command: Command) -> tuple[PlannedWrite, ...]:
        """Return the writes of a command, all of them validated before the first frame (SAFETY.md H22)."""
        model, allowed = self.drive.model, Allowed(stored=self.settings.allow_stored)
        try:
            steps = compose(command, model, self.facts.get(COMMAND, 0))
            writes = tuple(
                plan_write(model, self.drive.codec, self.drive.number, step.register, step.word, allowed, self.facts)
                for step in steps
            )
        except NotComposable as error:
            raise Refusal(error.reason, str(error)) from error
        except BadCommand as error:
            raise Refusal(REASONS[error.why], str(error)) from error
        for write in writes:
            self._check_word(command, write.register, write.word)
        return writes

    def _check_word(self, command: Command, register: Register, word: int) -> None:
        if not self.settings.permits(command, register, word):
            raise Refusal(Reason.NOT_PERMITTED, f"{command.source} has no right to {register.name} = {word:04X}H")
        if register.name == FREQUENCY:
            self._check_frequency(register.decode(word))
        is_motion = register.name == COMMAND and self._runs(register, word) and not command.verb.is_stopping
        if is_motion and self.standing is not Standing.ARMED:
            raise Refusal(Reason.NOT_ARMED, f"disarmed: {self.reason}")

    def _check_frequency(self, value: Decimal) -> None:
        least, greatest = self.settings.least_frequency, self.settings.greatest_frequency
        if not least <= value <= greatest:
            raise Refusal(Reason.RANGE, f"{value} Hz is outside {least} to {greatest} Hz, as configured")

    @staticmethod
    def _runs(register: Register, word: int) -> bool:
        """Say whether a command word sets the motor in motion."""
        return any(name in ("run", "jog") and word >> bit & 1 for bit, name in register.bits.items())

    def _coalesce(self, command: Command, writes: tuple[PlannedWrite, ...]) -> None:
        """Let a newer setpoint take the place of one that still waits; run and stop keep their order."""
        if command.verb not in (Verb.FREQUENCY, Verb.SPEED, Verb.ANALOG):
            return
        for execution in [e for e in self._waiting if e.command.verb is command.verb and not e.was_sent]:
            self._waiting.remove(execution)
            execution.finish(Status.REFUSED, Reason.SUPERSEDED, "a newer value came before it was sent")

    def _clear(self, reason: Reason, text: str) -> None:
        """End everything that waits."""
        while self._waiting:
            execution = self._waiting.popleft()
            status = Status.UNKNOWN if execution.was_sent else Status.REFUSED
            execution.finish(status, reason, text)

    # ---- what happens to the drive

    def on_link(self, *, is_online: bool, reason: str, now: float) -> None:
        """Take a change of the link: a drive that was lost is disarmed, and nothing that waited is sent."""
        if is_online == self.is_online:
            return
        self.is_online = is_online
        if is_online:
            self._set_watchdog(now)
        else:
            self._clear(Reason.OFFLINE, reason)
            self._disarm(f"the link was lost: {reason}")

    def _set_watchdog(self, now: float) -> None:
        """Set F804, F808 and F803 as configured where they read otherwise: nobody has to ask for that."""
        model = self.drive.model
        for register, word in watchdog.wanted(self.settings, model, self.facts):
            command = Command(self.drive.name, Verb.WORDS, GATEWAY, now, now + WATCHDOG_WITHIN, words=(word,))
            allowed = Allowed(stored=not self.drive.codec.forms.has_ram_write)
            try:
                write = plan_write(model, self.drive.codec, self.drive.number, register, word, allowed, self.facts)
            except BadCommand as error:
                self.tell("watchdog", str(error))
                return
            self._waiting.append(Execution(command, (write,), self._after_watchdog))

    def _after_watchdog(self, result: Result) -> None:
        name = next(iter(result.raw), "")
        if result.status is not Status.DONE:
            self.tell("watchdog", f"{name} could not be set: {result.text or result.reason}")

    def on_trip(self, is_tripped: bool | None) -> None:
        """Take whether the drive is tripped."""
        if is_tripped and not self.is_tripped:
            self._disarm("the drive has tripped")
        self.is_tripped = is_tripped

    def on_reset(self) -> None:
        """Take a reset of the drive: its RAM is gone."""
        self._disarm("the drive was reset")
        self._may_move = False

    def _disarm(self, reason: str) -> None:
        if self.standing is Standing.ARMED:
            self.standing, self.reason = Standing.DISARMED, reason
            self.tell("disarmed", reason)
        elif self.standing is Standing.DISARMED:
            self.reason = reason

    # ---- towards the line

    def tick(self, now: float) -> None:
        """Look at the time: end leases that ran out, and what they leave to be done."""
        if self.settings.is_leased and self.lease.is_over(now):
            self._lose(now)
        if self.standing is Standing.LOST and now > self._lost_at + STOP_WITHIN and self._waiting:
            self._clear(Reason.NOT_READ_BACK, "the drive was not seen to stop")
            self._quiesce("it was not seen to stop", now)
        if self.standing is Standing.QUIET and now >= self._quiet_until:
            self.standing, self.reason = Standing.DISARMED, self.reason
            self.tell("awake", self.reason)

    def _lose(self, now: float) -> None:
        owner = self.lease.owner
        self.lease.end()
        self._clear(Reason.NOT_OWNER, "the lease has ended")
        reason = f"the lease of {owner} has ended"
        loss = self.settings.on_loss
        self.tell("lease_lost", str(owner))
        if loss is OnLoss.HOLD or not self._may_move:
            self._disarm(reason)
            return
        self.standing, self.reason, self._lost_at = Standing.LOST, reason, now
        if loss is OnLoss.QUIESCE:
            self._quiesce(reason, now)
            return
        self.stop(_VERBS.get(loss, Verb.STOP), self._after_loss, now, self.settings.fallback)

    def _after_loss(self, result: Result) -> None:
        """Take the end of what was done for a lost lease."""
        if self.standing is Standing.LOST:
            self.standing = Standing.DISARMED
            self.tell("on_loss", f"{self.settings.on_loss.value}: {result.status}")

    def stop(self, verb: Verb, answer: Answer, now: float, value: Decimal | None = None) -> None:
        """Have the gateway itself stop the drive, or give it the fallback frequency."""
        command = Command(self.drive.name, verb, GATEWAY, now, now + STOP_WITHIN, value=value)
        try:
            writes = self._plan(command)
        except Refusal as refusal:
            answer(Result(command, Status.FAILED, refusal.reason, str(refusal)))
            self._quiesce(str(refusal), now)
            return
        self._waiting.appendleft(Execution(command, writes, answer, is_persistent=True))

    def _quiesce(self, reason: str, now: float) -> None:
        """Send the drive no frame any more, so that its own F803 acts (SAFETY.md H05)."""
        self.standing, self.reason = Standing.QUIET, reason
        self._quiet_until = now + self._timeout() + QUIET_BEYOND
        self.tell("quiesced", reason)

    def _timeout(self) -> float:
        return watchdog.seconds(self.drive.model, self.facts)

    @property
    def is_quiet(self) -> bool:
        """Say whether nothing at all is to be sent to the drive."""
        return self.standing is Standing.QUIET

    @property
    def has_waiting(self) -> bool:
        """Say whether a command waits."""
        return bool(self._waiting)

    @property
    def is_urgent(self) -> bool:
        """Say whether a stop waits: it goes ahead of everything on the line."""
        return bool(self._waiting) and self._waiting[0].is_persistent

    def next_time(self) -> float:
        """Return when `tick` has to be called at the latest."""
        times = [self.lease.until] if self.lease.owner is not None else []
        times += [self._quiet_until] if self.standing is Standing.QUIET else []
        times += [self._lost_at + STOP_WITHIN] if self.standing is Standing.LOST else []
        return min(times, default=float("inf"))

    def next(self, now: float) -> tuple[Execution, Request] | None:
        """Return the next frame for this drive; None where none waits."""
        while self._waiting:
            execution = self._waiting[0]
            request = execution.next(now)
            if request is not None:
                return execution, request
            self._waiting.popleft()
        return None

    def sending(self, execution: Execution) -> None:
        """Take note that the frame leaves now."""
        execution.sending()
        if execution.was_sent and any(write.may_start for write in execution.writes):
            self._may_move |= not execution.command.verb.is_stopping

    def on_reply(self, execution: Execution, reply: Reply | None) -> None:
        """Take an answer."""
        execution.on_reply(reply)
        self._settle(execution)

    def on_refused(self, execution: Execution, refused: Refused) -> None:
        """Take a refusal."""
        execution.on_refused(refused)
        self._settle(execution)

    def on_silence(self, execution: Execution, text: str) -> None:
        """Take silence, or bytes that are no answer."""
        execution.on_silence(text)
        self._settle(execution)

    def _settle(self, execution: Execution) -> None:
        """Drop what is over, and remember what the drive holds now."""
        self.facts.update(execution.read_back)
        if execution.is_over and execution in self._waiting:
            self._waiting.remove(execution)
        if execution.is_over and execution.is_done and execution.command.verb.is_stopping:
            self._may_move = False


_VERBS = {
    OnLoss.STOP: Verb.STOP,
    OnLoss.COAST: Verb.COAST,
    OnLoss.EMERGENCY_STOP: Verb.EMERGENCY_STOP,
    OnLoss.FREQUENCY: Verb.FREQUENCY,
}
