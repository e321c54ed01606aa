"""What a typed command comes to: words for registers by name, in the order in which they are to be written.

Bits of the command word that a command does not speak of stay as the drive has them (E6581657 7.1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.control.command import Command, Reason, Verb
from gateway.drives.model import Model
from gateway.drives.notation import NotUnderstood, word_of
from gateway.drives.register import Register
from gateway.drives.scaling import OutOfRange

COMMAND = "command"  # FA00
FREQUENCY = "frequency_command"  # FA01
SPEED = "motor_speed_command"  # FA13
POLES = "motor_poles"  # F856, by a code: half of them
HELD_FREQUENCY = "held_frequency"  # FA01 as it was found, whoever set it; FREQUENCY: by a controller
TERMINALS = "terminal_output"  # FA50
ANALOG = "analog_output"  # FA51
PRESETS = ("preset_speed_1", "preset_speed_2", "preset_speed_3", "preset_speed_4")  # bits 0 to 3, a number together
PRESET_NUMBERS = range(16)  # 0: none
PATTERNS = range(1, 3)
PRIORITIES = ("frequency_priority", "command_priority")  # bits 14 and 15

SETS: Mapping[Verb, tuple[str, ...]] = {
    Verb.RUN: ("run", "command_priority"),
    Verb.STOP: ("command_priority",),  # a drive that its panel or terminals run is stopped as well
    Verb.COAST: ("coast", "command_priority"),
    Verb.EMERGENCY_STOP: ("emergency_stop", "command_priority"),
    Verb.RESET: ("fault_reset", "command_priority"),
    Verb.PRESET: (),
    Verb.JOG: ("run", "jog", "command_priority"),
    Verb.ACCELERATION: (),
    Verb.RELEASE_PRIORITY: (),
}
MOTION = ("run", "jog", "coast", "emergency_stop", "fault_reset")
CLEARS: Mapping[Verb, tuple[str, ...]] = {
    Verb.RUN: (*MOTION, "reverse", *PRESETS),
    Verb.STOP: MOTION,
    Verb.COAST: MOTION,
    Verb.EMERGENCY_STOP: MOTION,
    Verb.RESET: MOTION,
    Verb.PRESET: PRESETS,
    Verb.JOG: (*MOTION, "reverse", *PRESETS),
    Verb.ACCELERATION: ("acceleration_2",),
    Verb.RELEASE_PRIORITY: (*MOTION, *PRIORITIES),
}
VALUES: Mapping[Verb, str] = {
    Verb.FREQUENCY: FREQUENCY,
    Verb.SPEED: SPEED,
    Verb.TERMINALS: TERMINALS,
    Verb.ANALOG: ANALOG,
}


class NotComposable(Exception):
    """A command that this model cannot be given, or not with this value; `reason` is for programs."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Step:
    """One word to be written; `bits` is what of it is to be read back."""

    register: Register
    word: int
    bits: int = 0xFFFF


def compose(command: Command, model: Model, known: Mapping[str, int]) -> tuple[Step, ...]:
    """Return the words of a command, the command word last; NotComposable says what is wrong.

    `known` are words as the drive has them, by register name: FA00, and FA01 once a controller has set it.
    """
    if command.verb is Verb.SET:
        return (_value(command, model, command.name),)
    if command.verb is Verb.WORDS and not command.words:
        raise NotComposable(Reason.MALFORMED, "no words are given")
    if command.verb is Verb.WORDS:
        steps = [_raw(model, command.address + place, word) for place, word in enumerate(command.words)]
        return tuple(sorted(steps, key=lambda step: step.register.name == COMMAND))
    before = known.get(COMMAND, 0)
    if command.verb in VALUES:
        value = _value(command, model, VALUES[command.verb])
        return (value, *_taking_effect(command, model, before))
    is_run_at = command.verb is Verb.RUN and command.value is not None
    value_first = (_value(command, model, FREQUENCY),) if is_run_at else ()
    was_set = FREQUENCY in known or SPEED in known
    with_frequency = is_run_at or (command.verb is Verb.RUN and was_set)
    return (*value_first, _command_word(command, model, before, with_frequency=with_frequency))


def runs(register: Register, word: int) -> bool:
    """Say whether a command word sets the motor in motion."""
    return any(name in ("run", "jog") and word >> bit & 1 for bit, name in register.bits.items())


def has_bit(register: Register, word: int, *names: str) -> bool:
    """Say whether one of the named bits is set in a word."""
    return any(name in names and word >> bit & 1 for bit, name in register.bits.items())


def _taking_effect(command: Command, model: Model, before: int) -> tuple[Step, ...]:
    """Give the frequency from the line priority where the motor already runs by command, but not at it.

    A preset speed goes before it (7.1), and is ended; who jogs goes on jogging, and has the frequency afterwards.
    """
    register = model.registers.get(COMMAND)
    is_setpoint = command.verb in (Verb.FREQUENCY, Verb.SPEED)
    if register is None or not is_setpoint or not runs(register, before):
        return ()
    if not has_bit(register, before, "command_priority") or has_bit(register, before, "jog"):
        return ()
    place = {name: bit for bit, name in register.bits.items()}
    if "frequency_priority" not in place:
        return ()
    held = before & register.mask
    word = held | 1 << place["frequency_priority"]
    for name in PRESETS:
        word &= ~(1 << place[name]) if name in place else word
    return (Step(register, word, register.mask),) if word != held else ()


def _register(model: Model, name: str) -> Register:
    register = model.registers.get(name)
    if register is None:
        raise NotComposable(Reason.NOT_IN_MODEL, f"{model.name} has no register {name!r}")
    return register


def _value(command: Command, model: Model, name: str) -> Step:
    register = _register(model, name)
    try:
        if command.text:
            return Step(register, word_of(register, command.text), register.mask)
        if command.value is not None:
            return Step(register, register.encode(command.value), register.mask)
        raise NotComposable(Reason.MALFORMED, f"{command.verb} needs a value")
    except NotUnderstood as error:
        raise NotComposable(Reason.MALFORMED, str(error)) from error
    except OutOfRange as error:
        raise NotComposable(Reason.RANGE, f"{name}: {error} {register.unit}".rstrip()) from error


def _raw(model: Model, address: int, word: int) -> Step:
    register = model.at(address)
    if register is None:
        raise NotComposable(Reason.NOT_IN_MODEL, f"{model.name} has no register {address:04X}H")
    return Step(register, word, register.mask)


def _command_word(command: Command, model: Model, before: int, *, with_frequency: bool) -> Step:
    """Set and clear what a command speaks of in the command word, and leave the rest as it is."""
    register = _register(model, COMMAND)
    place = {name: bit for bit, name in register.bits.items()}
    on, off = set(SETS[command.verb]), set(CLEARS[command.verb])
    on |= {"reverse"} if command.is_reverse and command.verb in (Verb.RUN, Verb.JOG) else set()
    on |= {"frequency_priority"} if with_frequency else set()
    on |= _numbered(command)
    if missing := on - place.keys():
        raise NotComposable(Reason.NOT_IN_MODEL, f"{model.name}: {register.name} has no bit {', '.join(missing)}")
    word = before & register.mask
    for name in off & place.keys():
        word &= ~(1 << place[name])
    for name in on:
        word |= 1 << place[name]
    return Step(register, word, register.mask)


def _numbered(command: Command) -> set[str]:
    """Return the bits that spell a preset speed or an acceleration pattern."""
    if command.verb not in (Verb.PRESET, Verb.ACCELERATION):
        return set()
    allowed = PRESET_NUMBERS if command.verb is Verb.PRESET else PATTERNS
    value = command.value
    number = int(value) if value is not None and 0 <= value < len(PRESET_NUMBERS) and value == int(value) else -1
    if number not in allowed:
        raise NotComposable(Reason.RANGE, f"{command.verb} is a number from {allowed[0]} to {allowed[-1]}")
    if command.verb is Verb.ACCELERATION:
        return {"acceleration_2"} if number == PATTERNS[-1] else set()
    return {name for bit, name in enumerate(PRESETS) if number >> bit & 1}
