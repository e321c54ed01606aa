"""The drive's own communication time-out: which parameters it has, and what they are to be set to (E6581657 6.3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal

from gateway.config import DriveSection
from gateway.control.composing import COMMAND, FREQUENCY, POLES
from gateway.control.settings import ControlSettings
from gateway.control.writes import limited_by
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.drives.scaling import OutOfRange
from gateway.site import Drive

OBSERVED = (COMMAND, "trip_code", "status", "reset_detection")  # FA00, FC90, FD01, FA87
ROLES = ("timeout_action", "timeout_detection", "timeout")  # F804, F808, F803: the time last, which arms it


@dataclass(frozen=True, slots=True)
class Need:
    """What a parameter has to be so that a drive stops that nobody talks to, and what it comes to `otherwise`.

    `name` is the parameter's own, `is_optional` says that a model need not have it, or that the drive may refuse it.
    """

    role: str
    name: str
    words: range
    otherwise: str
    is_optional: bool = False


NEEDS = (
    Need(
        "timeout",
        "F803",
        range(1, 1001),
        "the drive would not notice that nobody talks to it; set communication_timeout",
    ),
    Need(
        "timeout_action",
        "F804",
        range(1, 3),  # trip and coast, trip after slowing down
        "the drive would not trip, but show an alarm at the most; set timeout_action to stop or coast",
    ),
    Need(
        "timeout_detection",
        "F808",
        # Always; in communication mode; in communication mode while running. All three watch over a motor that a
        # run command of the gateway turns: bit 15 of FA00 selects communication, whatever CMOD is (7.1).
        range(3),
        "no manual tells when the time-out counts then; set timeout_detection",
        is_optional=True,
    ),
)


def registers(model: Model) -> dict[str, Register]:
    """Return the registers of the time-out by their roles, as far as the model has them."""
    connector = model.connector()
    roles = connector.parameters if connector else {}
    return {role: model.registers[roles[role]] for role in ROLES if roles.get(role) in model.registers}


def control_registers(drive: Drive) -> list[Register]:
    """Return what must be known of a drive before it is commanded; nothing where it is not.

    FA00 first: whether it runs; then whether it is tripped, its reset mark, its time-out and its limits.
    """
    if not drive.is_controlled:
        return []
    model = drive.model
    frequency = model.registers.get(FREQUENCY)
    limits = limited_by(model, frequency) if frequency is not None else ()
    names = [name for name in (*OBSERVED, POLES) if name in model.registers]
    return [*(model.registers[name] for name in names), *registers(model).values(), *limits]


def wanted(settings: ControlSettings, model: Model, facts: Mapping[str, int]) -> Iterator[tuple[Register, int]]:
    """Yield what is to be written, in order: only what is configured and reads otherwise."""
    for role, register in registers(model).items():
        word = _configured(settings, role, register)
        if word is not None and facts.get(register.name) != word:
            yield register, word


def _configured(settings: ControlSettings, role: str, register: Register) -> int | None:
    """Return the word that a parameter of the time-out is configured to have, None where none is."""
    timeout = settings.communication_timeout
    if role == "timeout":
        return None if timeout is None else register.encode(_exact(timeout))
    return settings.timeout_action if role == "timeout_action" else settings.timeout_detection


def objection(settings: ControlSettings, model: Model, register: Register, word: int) -> str:
    """Say why a controller may not write that word to a parameter of the time-out; "" for what it may."""
    role = next((role for role, known in registers(model).items() if known.name == register.name), None)
    if role is None:
        return ""
    configured = _configured(settings, role, register)
    need = next(need for need in NEEDS if need.role == role)
    if configured is not None and word != configured:
        return f"{_number(register)} is {register.format(configured)} by the configuration, and is kept so"
    if word not in need.words and not settings.is_unwatched:
        return f"{_number(register)} = {register.format(word)}: {need.otherwise}; or unwatched = true permits it"
    return ""


def contradictions(section: DriveSection, model: Model) -> Iterator[tuple[str, str]]:
    """Yield (key, what is wrong and what to do) for what is configured of the time-out and cannot be had."""
    timeout = section.communication_timeout
    if timeout is not None:
        if ambiguous := _ambiguous(model):
            yield "communication_timeout", ambiguous
        elif (register := registers(model).get("timeout")) is not None:
            try:
                register.encode(_exact(timeout))
            except OutOfRange as error:
                yield "communication_timeout", f"{_number(register)}: {error} s"
    if section.control != "off" and section.on_loss == "quiesce" and timeout is None:
        yield "on_loss", '"quiesce" leaves the stop to the drive\'s own F803: give communication_timeout as well'


def missing(model: Model, facts: Mapping[str, int]) -> str:
    """Say why the drive would go on running without a gateway; "" where it would stop."""
    if ambiguous := _ambiguous(model):
        return ambiguous
    found = registers(model)
    for need in NEEDS:
        register = found.get(need.role)
        word = None if register is None else facts.get(register.name)
        if word is not None and register is not None and word not in need.words:
            return f"{_number(register)} is {register.format(word)}: {need.otherwise}"
        if word is None and not need.is_optional:
            return _unknown(need, model, register)
    return ""


def _unknown(need: Need, model: Model, register: Register | None) -> str:
    if register is None:
        return f"the catalogue of {model.name} has no {need.name}: nobody can see whether the drive would stop"
    return f"{_number(register)} could not be read: nobody knows whether the drive would stop"


def _ambiguous(model: Model) -> str:
    """Say why a model's time-out is not known: each connector has one of its own, which the others do not refresh."""
    names = [c.parameters["timeout"] for c in model.connectors if "timeout" in c.parameters]
    if len(names) < 2:
        return ""
    numbers = ", ".join(_number(model.registers[name]) for name in names if name in model.registers)
    return (
        f"{model.name} has {len(names)} connectors with time-outs of their own ({numbers}), and nobody can know"
        " which one is wired: use a model of your own, with that connector only (docs/catalogue.md)"
    )


def _number(register: Register) -> str:
    """Return a parameter's number as the panel shows it: F803 for 0803H."""
    return f"F{register.address & 0xFFF:03X}"


def _exact(timeout: float) -> Decimal:
    """Return a time as it was written: 700 times 0.001 is no 0.7."""
    return Decimal(str(round(timeout, 6)))


def seconds(model: Model, facts: Mapping[str, int]) -> float:
    """Return F803 as far as it is known; 0 where it is off."""
    register = registers(model).get("timeout")
    return 0.0 if register is None else float(register.decode(facts.get(register.name, 0)))


def shortest(settings: ControlSettings, model: Model, facts: Mapping[str, int]) -> float:
    """Return the F803 to reckon with: a configured one may be in force though its write was not read back."""
    configured = settings.communication_timeout if "timeout" in registers(model) else None
    return min(filter(None, (seconds(model, facts), configured)), default=0.0)
