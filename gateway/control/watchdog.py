"""The drive's own communication time-out: which parameters it has, and what they are to be set to (E6581657 6.3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from decimal import Decimal

from gateway.control.composing import COMMAND, FREQUENCY
from gateway.control.settings import ControlSettings
from gateway.control.writes import limited_by
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.site import Drive

OBSERVED = (COMMAND, "trip_code", "status", "reset_detection")  # FA00, FC90, FD01, FA87
ROLES = ("timeout_action", "timeout_detection", "timeout")  # F804, F808, F803: the time last, which arms it


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
    names = [name for name in OBSERVED if name in model.registers]
    return [*(model.registers[name] for name in names), *registers(model).values(), *limits]


def wanted(settings: ControlSettings, model: Model, facts: Mapping[str, int]) -> Iterator[tuple[Register, int]]:
    """Yield what is to be written, in order: only what is configured and reads otherwise."""
    timeout = settings.communication_timeout
    asked = {
        "timeout_action": settings.timeout_action,
        "timeout_detection": settings.timeout_detection,
        "timeout": None if timeout is None else Decimal(str(timeout)),
    }
    for role, register in registers(model).items():
        value = asked[role]
        if value is None:
            continue
        word = register.encode(value) if isinstance(value, Decimal) else value
        if facts.get(register.name) != word:
            yield register, word


def missing(model: Model, facts: Mapping[str, int]) -> str:
    """Say why the drive would go on running without a gateway; "" where it would stop."""
    found = registers(model)
    if not facts.get(found["timeout"].name if "timeout" in found else ""):
        return "F803 is 0: the drive would not notice that nobody talks to it; set communication_timeout"
    if not facts.get(found["timeout_action"].name if "timeout_action" in found else ""):
        return "F804 is 0: the drive would only show an alarm; set timeout_action to stop or coast"
    return ""


def seconds(model: Model, facts: Mapping[str, int]) -> float:
    """Return F803 as far as it is known; 0 where it is off."""
    register = registers(model).get("timeout")
    return 0.0 if register is None else float(register.decode(facts.get(register.name, 0)))
