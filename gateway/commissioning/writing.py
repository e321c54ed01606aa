"""Writes registers by hand: the whole list is checked first, then made in order up to the first that fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gateway.bus.group_writes import Writes, write_together
from gateway.bus.session import Outcome, Session
from gateway.commissioning import models
from gateway.commissioning.reading import in_words
from gateway.commissioning.targets import Target
from gateway.control.writes import Allowed, PlannedWrite, Verdict, check_access, limited_by, plan_write
from gateway.drives.notation import NotUnderstood, found, label, raw_word_of, word_of
from gateway.drives.register import Register
from gateway.errors import BadReply, LineDown, NoReply, Refused
from gateway.site import Drive

Say = Callable[[str], None]

AGAIN = "if only the RAM has it, --again writes it to the EEPROM all the same"


@dataclass(frozen=True, slots=True)
class Assignment:
    """What is to be written, as it was given: "frequency_command=30.0"."""

    name: str
    value: str

    def word(self, register: Register, *, is_raw: bool) -> int:
        """Return its word for a register."""
        return (raw_word_of if is_raw else word_of)(register, self.value)


@dataclass(frozen=True, slots=True)
class Wish:
    """A whole call: what to write, how the values are meant, and what is permitted."""

    assignments: tuple[Assignment, ...]
    allowed: Allowed
    is_raw: bool = False
    again: bool = False


def assignment(text: str) -> Assignment:
    """Split NAME=VALUE; NotUnderstood says the form."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise NotUnderstood(f"{text!r}: give NAME=VALUE, such as frequency_command=30.0")
    return Assignment(name.strip(), value.strip())


def plan(drives: Sequence[Drive], wish: Wish, bounds: dict[str, dict[str, int]] | None = None) -> list[Writes]:
    """Plan each assignment for every drive; BadCommand, NotUnderstood or OutOfRange before anything is sent.

    `bounds` are the words that limit registers, by drive and register name, as far as they were read.
    """
    known = bounds or {}
    return [[(drive, _plan(drive, item, wish, known)) for drive in drives] for item in wish.assignments]


def _plan(drive: Drive, item: Assignment, wish: Wish, bounds: dict[str, dict[str, int]]) -> PlannedWrite:
    register = found(drive.model, item.name)
    check_access(drive.model, register, wish.allowed)
    word = item.word(register, is_raw=wish.is_raw)
    limits = bounds.get(drive.name, {})
    return plan_write(drive.model, drive.codec, drive.number, register, word, wish.allowed, limits)


async def write(session: Session, target: Target, wish: Wish, say: Say, warn: Say) -> bool:
    """Check the drives and the values, write, say what came of it, warn; False where not all is as it was to be.

    NoReply: the only drive is silent, LineDown: the port is gone, and nothing was written. In a group a silent
    drive may hear all the same.
    """
    plans = plan(target.drives, wish)
    await models.check(session, target, warn)
    plans = plan(target.drives, wish, await _bounds(session, plans))
    for place, writes in enumerate(plans):
        try:
            is_good = await _write(session, writes, target, wish, say)
        except (LineDown, NoReply, BadReply, Refused) as error:
            say(f"  not written: {error}")
            if place == 0:
                raise
            is_good = False
        if not is_good:
            left = [label(later[0][1].register) for later in plans[place + 1 :]]
            if left:
                say(f"not written any more: {', '.join(left)}")
            return False
    return True


async def _bounds(session: Session, plans: Sequence[Writes]) -> dict[str, dict[str, int]]:
    """Read the registers that limit what is to be written: FH, where the catalogue knows it."""
    bounds: dict[str, dict[str, int]] = {}
    for drive, write in (pair for writes in plans for pair in writes):
        for register in limited_by(drive.model, write.register):
            word = await session.read_if_possible(drive, register)
            if word is not None:
                bounds.setdefault(drive.name, {})[register.name] = word
    return bounds


async def _write(session: Session, writes: Writes, target: Target, wish: Wish, say: Say) -> bool:
    drive, first = writes[0]
    say(f"writing {label(first.register)} = {in_words(first.register, first.word)}: {first.used}")
    if target.is_group:
        done = await write_together(session, writes, again=wish.again)
        outcomes: Sequence[Outcome] = done.outcomes
        for frame in done.frames:
            say(f"  to {frame}")
    else:
        outcomes = [await session.write(drive, first, again=wish.again)]
    for outcome in outcomes:
        say(f"  {told(outcome)}")
    return all(outcome.verdict.is_good for outcome in outcomes)


def told(outcome: Outcome) -> str:
    """Say what became of a write: "pump-1: 0.00 Hz (0000H) -> 30.00 Hz (0BB8H): done"."""
    register = outcome.write.register
    note = AGAIN if outcome.verdict is Verdict.EQUAL else outcome.note
    verdict = "; ".join(filter(None, (outcome.verdict.value, note)))
    if outcome.new is None and (outcome.old is None or outcome.verdict is Verdict.NOT_WRITTEN):
        return f"{outcome.drive.name}: {verdict}"
    return f"{outcome.drive.name}: {in_words(register, outcome.old)} -> {in_words(register, outcome.new)}: {verdict}"
