"""Says what a controller that comes by MQTT may ask of a drive, by mode, sources, rights and what the model has."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from fnmatch import fnmatchcase

from gateway.config import MqttSection
from gateway.control.command import Channel, Verb
from gateway.control.composing import COMMAND, FREQUENCY, VALUES
from gateway.control.settings import ControlSettings, Right, settings_of
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.site import Drive

NEEDED_BITS = {Verb.PRESET: "preset_speed_1", Verb.JOG: "jog", Verb.ACCELERATION: "acceleration_2"}  # of FA00
ANYBODY = "*"


@dataclass(frozen=True, slots=True)
class Operation:
    """What may be asked of a drive; `least` and `greatest` bound its frequency, in Hz."""

    settings: ControlSettings
    verbs: frozenset[Verb]
    least: Decimal
    greatest: Decimal
    step: Decimal

    @property
    def is_leased(self) -> bool:
        """Say whether all but stopping needs a lease."""
        return self.settings.is_leased


def operation_of(drive: Drive, section: MqttSection, name: str = ANYBODY) -> Operation | None:
    """Return what a controller of that name may ask for, or any of them; None where nothing can be by this broker."""
    settings = settings_of(drive.section) if drive.section is not None else None
    if settings is None or Channel.MQTT not in settings.sources or not section.commands:
        return None
    rights = [right for right in settings.rights if right.channel is Channel.MQTT and _is_of(right, name, section)]
    verbs = {verb for verb in Verb if _has(drive.model, verb)}
    if settings.rights:
        verbs = {verb for verb in verbs if verb.is_stopping or _permits(rights, verb)}
    if settings.has_frequency_limits:
        verbs.discard(Verb.SPEED)  # which is in min-1, and is refused where the limits are in Hz
    least, greatest = _bounds(settings, rights)
    register = drive.model.registers.get(FREQUENCY)
    step = register.scaling.scale if register is not None else Decimal(1)
    return Operation(settings, frozenset(verbs), least, greatest, step)


def _is_of(right: Right, name: str, section: MqttSection) -> bool:
    is_here = fnmatchcase(section.origin, right.broker)
    return is_here and (name == ANYBODY or fnmatchcase(name, right.name))


def _permits(rights: list[Right], verb: Verb) -> bool:
    return any(fnmatchcase(verb, pattern) for right in rights for pattern in right.commands)


def _has(model: Model, verb: Verb) -> bool:
    """Say whether a model has what a command needs; without FA00 only what concerns permission is left."""
    if verb in VALUES:
        return VALUES[verb] in model.registers
    bits = bits_of(model.registers.get(COMMAND))
    return verb not in NEEDED_BITS or NEEDED_BITS[verb] in bits


def bits_of(register: Register | None) -> dict[str, int]:
    """Return the masks of a register's bits by name; none where there is no register."""
    return {} if register is None else {name: 1 << bit for bit, name in register.bits.items()}


def _bounds(settings: ControlSettings, rights: list[Right]) -> tuple[Decimal, Decimal]:
    """Return the least and the greatest frequency: those of the drive, narrowed by what rights leave of them."""
    least, greatest = settings.least_frequency, settings.greatest_frequency
    covering = [right for right in rights if any(fnmatchcase(FREQUENCY, pattern) for pattern in right.registers)]
    if not covering:
        return least, greatest
    lows = [least if right.least is None else right.least for right in covering]
    highs = [greatest if right.greatest is None else right.greatest for right in covering]
    return max(least, min(lows)), min(greatest, max(highs))
