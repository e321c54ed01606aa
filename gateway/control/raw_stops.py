"""Which raw words are a stop: the command word (FA00), written by its number or its name, without motion.

Pure. Stopping needs no right and no lease, however it is spelt (SAFETY.md H04, H29).
"""

from __future__ import annotations

from gateway.control.command import Command, Verb
from gateway.control.composing import COMMAND, NotComposable, Step, compose, has_bit, runs
from gateway.drives.model import Model
from gateway.drives.register import Register

STARTING = ("run", "jog", "fault_reset")  # bits of the command word that a stop of somebody else does not carry
PRIORITY = "command_priority"  # without it the panel or the terminals may start the motor


def raw_stop(command: Command, model: Model) -> Step | None:
    """Return the command word of a raw command that stops, as it was given; None where it does not stop.

    An emergency stop is none the less one beside a fault reset, which is left out: the drive would not answer to it.
    """
    step = _command_word(command, model)
    if step is None or not _stops(step.register, step.word):
        return None
    if has_bit(step.register, step.word, "emergency_stop"):
        return Step(step.register, _without(step, ("fault_reset",)), step.bits)
    return step


def is_plain(step: Step) -> bool:
    """Say whether a word that stops does nothing else: one with a fault reset is its owner's reset."""
    return not has_bit(step.register, step.word, "fault_reset")


def bare(step: Step) -> Step:
    """Return what is left of a stop of somebody who may do nothing else.

    It starts and resets nothing, now or later, and does not hand the motor to the panel or the terminals.
    """
    priority = sum(1 << bit for bit, name in step.register.bits.items() if name == PRIORITY)
    return Step(step.register, _without(step, STARTING) | priority, step.bits)


def _without(step: Step, names: tuple[str, ...]) -> int:
    return step.word & ~sum(1 << bit for bit, name in step.register.bits.items() if name in names)


def _stops(register: Register, word: int) -> bool:
    """Say whether a command word keeps the motor from running; a reset alone is no stop."""
    if has_bit(register, word, "emergency_stop", "coast"):
        return True
    return not runs(register, word) and not has_bit(register, word, "fault_reset")


def _command_word(command: Command, model: Model) -> Step | None:
    """Return what a raw command writes to the command word; None where it does not, or not understandably."""
    register = model.registers.get(COMMAND)
    if register is None:
        return None
    if command.verb is Verb.WORDS:
        place = register.address - command.address
        return Step(register, command.words[place], register.mask) if 0 <= place < len(command.words) else None
    if command.verb is not Verb.SET or command.name != register.name:
        return None
    try:
        (step,) = compose(command, model, {})
    except NotComposable:
        return None
    return step
