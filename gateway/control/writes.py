"""What a write comes to: one request and what it does to the drive, or a refusal that says why. Sends nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from enum import Enum

from gateway.drives.model import Model
from gateway.drives.notation import label
from gateway.drives.register import Register, Storage
from gateway.drives.scaling import OutOfRange
from gateway.errors import GatewayError
from gateway.protocol.codec import Codec, NoSuchForm
from gateway.protocol.pdu import Target, WriteRam, WriteStored

LIFELINES = ("baud_rate", "parity", "number", "protocol")  # roles; a wrong value cuts the line to the drive
STARTS = frozenset(  # bits by which a motor may start: FA00, FA11; a reset lets a run signal at the terminals through
    ("run", "jog", "fault_reset", "up", "down", "mode", "enter", "easy", "local_remote")
)
STOPS = frozenset(("emergency_stop", "coast", "stop", "maximum_deceleration_stop"))  # bits that win over those
SETPOINTS = ("command", "frequency_command", "motor_speed_command")  # FA00, FA01, FA13: in every model
SPEEDS = ("Hz", "min-1")  # units of setpoints that start nothing at 0


class Why(Enum):
    """Why a write is not made."""

    READ_ONLY = "not writable"
    FORBIDDEN = "never written"
    KEYS = "takes the panel's keys away"
    RANGE = "out of range"
    STORED = "wears the EEPROM"
    NO_EFFECT = "without effect"
    NO_FORM = "not in this protocol"


class BadCommand(GatewayError):
    """A write that never reaches the wire; the message says why, and what would be right."""

    def __init__(self, why: Why, message: str) -> None:
        super().__init__(message)
        self.why = why


@dataclass(frozen=True, slots=True)
class Allowed:
    """What whoever writes has permitted in so many words: wearing the EEPROM, taking over the panel's keys."""

    stored: bool = False
    keys: bool = False


NOTHING = Allowed()


@dataclass(frozen=True, slots=True)
class PlannedWrite:
    """A write that may be sent. `used` says in words what is used; `may_start` that a motor may start by it."""

    register: Register
    word: int
    request: WriteRam | WriteStored
    used: str
    may_start: bool

    @property
    def wears_eeprom(self) -> bool:
        """Say whether the drive writes its EEPROM."""
        return isinstance(self.request, WriteStored)

    @property
    def is_answered(self) -> bool:
        """Say whether the drive acknowledges it: a fault reset it obeys in silence."""
        return isinstance(self.request, WriteStored) or self.request.is_answered

    def reads_back(self, word: int) -> bool:
        """Say whether a word read from the register is what was to be written."""
        return (word ^ self.word) & self.register.mask == 0


def plan_write(
    model: Model,
    codec: Codec,
    target: Target,
    register: Register,
    word: int,
    allowed: Allowed = NOTHING,
    bounds: Mapping[str, int] | None = None,
) -> PlannedWrite:
    """Plan the write of one raw word; BadCommand where it must not, or cannot, be made.

    A stored parameter goes to RAM only where the protocol can do that, and to the EEPROM only where that is
    allowed. `bounds` are the words, by name, of the registers that limit this one (`limited_by`), as far as known.
    """
    check_access(model, register, allowed)
    _check_range(model, register, word, bounds or {})
    is_stored = _goes_to_eeprom(register, codec, allowed)
    is_answered = _is_answered(model, register, word)
    request: WriteRam | WriteStored
    if is_stored:
        request = WriteStored(target, register.address, word)
    else:
        request = WriteRam(target, register.address, word, is_answered)
    try:
        codec.encode(request)
    except NoSuchForm as error:
        raise BadCommand(Why.NO_FORM, f"{label(register)}: {error}") from error
    used = _in_words(register, codec, is_stored)
    return PlannedWrite(register, word, request, used, may_start(model, register, word))


def may_start(model: Model, register: Register, word: int) -> bool:
    """Say whether a motor may start, or change its speed, by this word; a stop and a speed of 0 start nothing.

    Bits that are in neither table are judged by their register: where one of its bits starts, the others do not.
    """
    if register.name not in model.cautions.may_start and register.name not in SETPOINTS:
        return False
    if register.bits:
        names = {name for bit, name in register.bits.items() if word >> bit & 1}
        starts = STARTS & set(register.bits.values()) or set(register.bits.values())
        return bool(names & starts) and not names & STOPS
    return word != 0 or register.unit not in SPEEDS


def limited_by(model: Model, register: Register) -> tuple[Register, ...]:
    """Return the registers whose values limit this one: FH, UL, LL where the catalogue knows them."""
    names = filter(None, (register.minimum_from, register.maximum_from))
    return tuple(model.registers[name] for name in names)


def check_access(model: Model, register: Register, allowed: Allowed) -> None:
    """Refuse a register that is not, or never, to be written, whatever the value."""
    if register.address in model.cautions.never or register.name in _lifelines(model):
        reason = "it is set at the drive's panel only: a wrong value cuts the line to the drive, or resets it"
        raise BadCommand(Why.FORBIDDEN, f"{label(register)} is never written; {reason}")
    if not register.is_writable:
        raise BadCommand(Why.READ_ONLY, f"{label(register)} is read-only")
    if register.name in model.cautions.keys and not allowed.keys:
        reason = "it takes the panel's keys away, the STOP key too; see that the motor can be stopped otherwise"
        raise BadCommand(Why.KEYS, f"{label(register)} is not written unless keys are explicitly allowed: {reason}")


def _lifelines(model: Model) -> Iterator[str]:
    for connector in model.connectors:
        for role in LIFELINES:
            yield connector.parameters.get(role, "")


def _check_range(model: Model, register: Register, word: int, bounds: Mapping[str, int]) -> None:
    """Refuse what the register's range, or the value of a register that limits it, excludes; never clamp."""
    try:
        value = register.scaling.decode(word)
        register.encode(value)
    except OutOfRange as error:
        raise BadCommand(Why.RANGE, f"{label(register)}: {error}{_unit(register)}") from error
    for name, is_beyond in ((register.minimum_from, Decimal.__lt__), (register.maximum_from, Decimal.__gt__)):
        if name in bounds:
            bound = model.registers[name]
            limit = bound.decode(bounds[name])
            if is_beyond(value, limit):
                text = f"{label(register)}: {value} is beyond {label(bound)}, {limit}{_unit(register)}"
                raise BadCommand(Why.RANGE, text)


def _unit(register: Register) -> str:
    return f" {register.unit}" if register.unit else ""


def _goes_to_eeprom(register: Register, codec: Codec, allowed: Allowed) -> bool:
    """Decide between RAM and EEPROM; BadCommand where the one is not permitted and the other not possible."""
    if register.storage is not Storage.EEPROM:
        return False
    if allowed.stored:
        return True
    if not codec.forms.has_ram_write:
        raise BadCommand(
            Why.STORED,
            f"{label(register)} is a stored parameter, and {codec.name} can write it to the EEPROM only, which wears"
            " it (about 10,000 writes): allow stored writes explicitly, or use the TOSHIBA protocol, which can write"
            " it to RAM",
        )
    if register.takes_effect_after_reset:
        raise BadCommand(
            Why.NO_EFFECT,
            f"{label(register)} acts after a reset only, and a reset brings the EEPROM's value back: a write to RAM"
            " would have no effect; allow a stored write",
        )
    return False


def _is_answered(model: Model, register: Register, word: int) -> bool:
    """Say whether the drive answers; a fault reset must not carry a run bit (SAFETY.md H09)."""
    set_bits = {name for bit, name in register.bits.items() if word >> bit & 1}
    silent = model.cautions.unanswered.get(register.name)
    if silent not in set_bits:
        return True
    if "run" in set_bits:
        raise BadCommand(Why.RANGE, f"{label(register)}: {silent} is sent alone, without run")
    return False


def _in_words(register: Register, codec: Codec, is_stored: bool) -> str:
    """Say which command is used and what it does: "P, RAM only"."""
    has_both = codec.forms.has_ram_write
    if is_stored:
        return f"{'W' if has_both else '06H'}, RAM and EEPROM: wears it"
    command = "P" if has_both else "06H"
    if register.storage is Storage.EEPROM:
        return f"{command}, RAM only: lost when the drive is reset"
    return f"{command}, RAM only"


class Verdict(Enum):
    """What became of a write, as far as can be known. `unknown` is never said of what was seen to fail."""

    DONE = "done"
    EQUAL = "not written: reads so already"
    REFUSED = "refused"
    NOT_DONE = "not done"
    NOT_WRITTEN = "not written"
    UNKNOWN = "unknown"

    @property
    def is_good(self) -> bool:
        """Say whether the drive is as it was to be."""
        return self in (Verdict.DONE, Verdict.EQUAL)


def judge(write: PlannedWrite, read_back: int | None, *, is_refused: bool = False) -> Verdict:
    """Judge a write by what its register reads afterwards (None: no answer), whatever was acknowledged."""
    if is_refused:
        return Verdict.REFUSED
    if read_back is None:
        return Verdict.UNKNOWN
    return Verdict.DONE if write.reads_back(read_back) else Verdict.NOT_DONE
