"""What a command comes to, or why it is refused: rights, ranges, limits; validated whole (SAFETY.md H22)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

from gateway.control import watchdog
from gateway.control.command import GATEWAY, Command, Reason, Verb
from gateway.control.composing import (
    COMMAND,
    FREQUENCY,
    HELD_FREQUENCY,
    POLES,
    PRIORITIES,
    SPEED,
    NotComposable,
    Step,
    compose,
    has_bit,
    runs,
)
from gateway.control.raw_stops import bare, is_plain, raw_stop
from gateway.control.settings import ControlSettings
from gateway.control.writes import Allowed, BadCommand, PlannedWrite, Why, limited_by, plan_write
from gateway.drives.register import Kind, Register
from gateway.site import Drive

EXECUTIVE = (Verb.RUN, Verb.JOG, Verb.PRESET)  # what sets a motor in motion
COMPOSED = frozenset(Verb) - {Verb.SET, Verb.WORDS, Verb.ARM, Verb.TAKE, Verb.RELEASE}
SETPOINTS = (Verb.FREQUENCY, Verb.SPEED, Verb.ANALOG)  # of which only the newest matters
LEFT_OUT = "stopped; the words beside the stop were left out: they are for the owner, with the right to them"

POLES_PER_HZ = 120  # min-1 times the number of poles, to Hz (FA13, VF-MB1 RS485 8.1)

REASONS = {
    Why.READ_ONLY: Reason.READ_ONLY,
    Why.FORBIDDEN: Reason.FORBIDDEN,
    Why.KEYS: Reason.FORBIDDEN,
    Why.RANGE: Reason.RANGE,
    Why.STORED: Reason.STORED,
    Why.NO_EFFECT: Reason.STORED,
    Why.NO_FORM: Reason.FORBIDDEN,
}


class NotAdmitted(Exception):
    """A command that is refused; `reason` is for programs."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Plan:
    """The writes of a command. `is_stop`: it goes ahead; `is_motion`: the drive must be armed for it.

    `beside` says what of the words beside a raw stop is not written, and why; without a reason it is no failure.
    """

    writes: tuple[PlannedWrite, ...]
    is_stop: bool = False
    is_motion: bool = False
    is_reset: bool = False
    beside: tuple[Reason, str] = (Reason.NONE, "")


@dataclass(frozen=True, slots=True)
class Admission:
    """The rules of one drive that do not change."""

    drive: Drive
    settings: ControlSettings

    def is_stop(self, command: Command) -> bool:
        """Say whether a command stops the motor, typed or raw: from any source, with or without a right to more."""
        return command.verb.is_stopping or raw_stop(command, self.drive.model) is not None

    def check_right(self, command: Command) -> None:
        """Refuse what the source may not ask for at all."""
        if not self.settings.may_write(command.source):
            raise NotAdmitted(Reason.NOT_PERMITTED, f"{command.source} may not write to {self.drive.name}")
        if not self.settings.permits_verb(command) and not self.is_stop(command):
            raise NotAdmitted(Reason.NOT_PERMITTED, f"{command.source} has no right to {command.verb}")

    def plan(self, command: Command, known: Mapping[str, int], *, is_own: bool) -> Plan:
        """Return all the writes of a command, every one of them checked before the first frame.

        `known` are words as the drive has them, by register name; `is_own` says that the source may command more
        than stops. A raw stop goes first, and is carried out whatever stands beside it.
        """
        stop = raw_stop(command, self.drive.model)
        if stop is not None and not (is_own and self.settings.permits_verb(command)):
            left_out = LEFT_OUT if len(command.words) > 1 else ""
            return Plan(self._writes((bare(stop),), known), is_stop=True, beside=(Reason.NONE, left_out))
        if stop is None:
            return self._plan_all(command, known)
        try:
            if not is_plain(stop):
                return self._plan_all(command, known)
            rest = self._checked(command, known, but=COMMAND)
        except NotAdmitted as refusal:
            only = stop if is_plain(stop) else bare(stop)
            beside = (refusal.reason, f"stopped; not written: {refusal}")
            return Plan(self._writes((only,), known), is_stop=True, beside=beside)
        writes = (*self._writes((stop,), known), *rest)
        return Plan(writes, is_stop=True, is_motion=any(map(_is_motion, rest)))

    def _plan_all(self, command: Command, known: Mapping[str, int]) -> Plan:
        writes = self._checked(command, known)
        self._check_held_frequency(writes, known)
        return Plan(
            writes,
            is_stop=command.verb.is_stopping,
            is_motion=command.verb in EXECUTIVE or any(_is_motion(write) for write in writes),
            is_reset=any(not write.is_answered for write in writes),
        )

    def _check_held_frequency(self, writes: Sequence[PlannedWrite], known: Mapping[str, int]) -> None:
        """Refuse to run at a frequency that is left in FA01 from before and is out of range (SAFETY.md H12, H31)."""
        word = next((write.word for write in writes if write.register.name == COMMAND), 0)
        register = self.drive.model.registers.get(COMMAND)
        is_said = {FREQUENCY, SPEED} & {*known, *(write.register.name for write in writes)}
        if register is None or is_said or not runs(register, word) or not has_bit(register, word, PRIORITIES[0]):
            return
        frequency = self.drive.model.registers.get(FREQUENCY)
        if frequency is not None and HELD_FREQUENCY in known:
            self._check_frequency(frequency.decode(known[HELD_FREQUENCY]))

    def _checked(self, command: Command, known: Mapping[str, int], but: str = "") -> tuple[PlannedWrite, ...]:
        """Return the writes of a command but for one register, all of them in range and permitted."""
        try:
            steps = compose(command, self.drive.model, known)
        except NotComposable as error:
            raise NotAdmitted(error.reason, str(error)) from error
        writes = self._writes((step for step in steps if step.register.name != but), known)
        for write in writes:
            self._check_word(command, write.register, write.word, known)
        return writes

    def _writes(self, steps: Iterable[Step], known: Mapping[str, int]) -> tuple[PlannedWrite, ...]:
        drive, allowed = self.drive, Allowed(stored=self.settings.allow_stored)
        try:
            return tuple(
                plan_write(drive.model, drive.codec, drive.number, step.register, step.word, allowed, known)
                for step in steps
            )
        except BadCommand as error:
            raise NotAdmitted(REASONS[error.why], str(error)) from error

    def _check_word(self, command: Command, register: Register, word: int, known: Mapping[str, int]) -> None:
        if not self.settings.permits(command, register, word):
            raise NotAdmitted(Reason.NOT_PERMITTED, f"{command.source} has no right to {register.name} = {word:04X}H")
        if register.name == FREQUENCY or (register.unit == "Hz" and register.kind is Kind.COMMAND):
            self._check_frequency(register.decode(word))
        if register.unit == "min-1" and register.kind is Kind.COMMAND and self.settings.has_frequency_limits:
            if POLES not in known:
                text = f"F856 of {self.drive.name} is not known: its limits are in Hz, {register.name} is in min-1"
                raise NotAdmitted(Reason.NOT_PERMITTED, text)
            self._check_frequency(register.decode(word) * 2 * known[POLES] / POLES_PER_HZ)
        objection = watchdog.objection(self.settings, self.drive.model, register, word)
        if objection and command.source != GATEWAY:
            raise NotAdmitted(Reason.FORBIDDEN, objection)

    def _check_frequency(self, value: Decimal) -> None:
        least, greatest = self.settings.least_frequency, self.settings.greatest_frequency
        if not least <= value <= greatest:
            raise NotAdmitted(Reason.RANGE, f"{value} Hz is outside {least} to {greatest} Hz, as configured")

    def limits(self) -> tuple[Register, ...]:
        """Return the registers that limit the frequency: FH, UL, LL as far as the model has them."""
        frequency = self.drive.model.registers.get(FREQUENCY)
        return limited_by(self.drive.model, frequency) if frequency is not None else ()


def _is_motion(write: PlannedWrite) -> bool:
    """Say whether a write runs the motor; a reset, which may let a signal of the terminals through, is no run."""
    if write.register.name == COMMAND:
        return runs(write.register, write.word) and write.may_start
    return write.may_start and bool(write.register.bits) and write.is_answered
