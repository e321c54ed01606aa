"""Shows a text or a number on a drive's panel: the text in one frame where that is possible (E6581657 7.3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gateway.bus.session import Outcome, Session, processing_time
from gateway.commissioning.breaking_off import to_the_end
from gateway.control.writes import Allowed, BadCommand, PlannedWrite, Verdict, Why, plan_write
from gateway.drives import panel
from gateway.drives.notation import label
from gateway.drives.panel import Number
from gateway.drives.register import Register
from gateway.errors import BadReply, GatewayError, NoReply
from gateway.protocol.pdu import Exchange, Exchanged
from gateway.site import Drive

SELECTION = "led_selection"  # FA65
NUMBER, TEXT_1, TEXT_2 = 0, 1, 2  # what FA65 selects
NUMBER_PARTS = ("led_number", "led_decimal_point", "led_unit_0")  # FA66-FA68
BLOCK_MODE = "block_mode"  # FA80
MONITOR = "standard_monitor"  # F710
BY_COMMUNICATION = "LED data by communication"  # its value that shows all this
RESTORE_TRIES = 3

Step = tuple[Register, int]


@dataclass(frozen=True, slots=True)
class Shown:
    """What was used to show it, what became of each write, and what else there is to say."""

    used: str
    outcomes: tuple[Outcome, ...]
    notes: tuple[str, ...] = ()
    is_silent: bool = False

    @property
    def is_good(self) -> bool:
        """Say whether all that was to be written reads back."""
        return not self.is_silent and all(outcome.verdict.is_good for outcome in self.outcomes)


def text_parts(drive: Drive, which: int) -> tuple[Register, ...]:
    """Return the registers of text 1 or 2: four digits from the left, and the unit LEDs."""
    names = [f"led_text_{which}_digit_{place}" for place in range(1, panel.DIGITS + 1)]
    return tuple(_register(drive, name) for name in (*names, f"led_unit_{which}"))


def _register(drive: Drive, name: str) -> Register:
    if name not in drive.model.registers:
        raise BadCommand(Why.NO_FORM, f"{drive.model.name}: the catalogue knows no {name}: it cannot be displayed")
    return drive.model.registers[name]


def text_words(drive: Drive, text: str, unit: int) -> tuple[int, ...]:
    """Return the words of a text and its unit for this drive; CannotShow says what it can show."""
    limits = [register.maximum for register in text_parts(drive, TEXT_1)[: panel.DIGITS]]
    return (*panel.digits(text, limits), unit)


def has_text_block(drive: Drive) -> bool:
    """Say whether a text goes into one frame: X with FA80 = 1, which must be set in RAM."""
    return drive.codec.forms.has_exchange and has_block_mode(drive)


def has_block_mode(drive: Drive) -> bool:
    """Say whether a drive has FA80, and it can be set in RAM."""
    return drive.codec.forms.has_ram_write and BLOCK_MODE in drive.model.registers


def check(drive: Drive, shown: Sequence[int] | Number, unit: int, allowed: Allowed) -> None:
    """Refuse (BadCommand) what cannot be written to a drive, or must not be, before anything is sent to any."""
    if isinstance(shown, Number):
        _number_plans(drive, shown, unit, allowed)
        return
    for which in (TEXT_1, TEXT_2):
        _steps(drive, which, shown, allowed)
        _plans(drive, [(_register(drive, SELECTION), which)], allowed)


async def show_text(session: Session, drive: Drive, words: Sequence[int], allowed: Allowed) -> Shown:
    """Show a text: all digits at once by the block, or else in the place that is not shown, and then switched to."""
    select = {which: _plans(drive, [(_register(drive, SELECTION), which)], allowed)[0] for which in (TEXT_1, TEXT_2)}
    steps = {which: _steps(drive, which, words, allowed) for which in (TEXT_1, TEXT_2)}
    if has_text_block(drive) and not allowed.stored:
        return await _by_block(session, drive, steps[TEXT_1], select[TEXT_1])
    now_shown = await session.read(drive, _register(drive, SELECTION))
    wears = any(write.wears_eeprom for write in steps[TEXT_1])
    which = now_shown if wears and now_shown in steps else (TEXT_2 if now_shown == TEXT_1 else TEXT_1)
    return await _one_by_one(session, drive, [*steps[which], select[which]])


async def show_number(session: Session, drive: Drive, number: Number, unit: int, allowed: Allowed) -> Shown:
    """Show a number: FA66-FA68, and then FA65 switched to them."""
    return await _one_by_one(session, drive, _number_plans(drive, number, unit, allowed))


def _number_plans(drive: Drive, number: Number, unit: int, allowed: Allowed) -> list[PlannedWrite]:
    words = (number.digits, number.decimals, unit)
    steps = [(_register(drive, name), word) for name, word in zip(NUMBER_PARTS, words, strict=True)]
    return _plans(drive, [*steps, (_register(drive, SELECTION), NUMBER)], allowed)


def _steps(drive: Drive, which: int, words: Sequence[int], allowed: Allowed) -> list[PlannedWrite]:
    return _plans(drive, list(zip(text_parts(drive, which), words, strict=True)), allowed)


def _plans(drive: Drive, steps: Sequence[Step], allowed: Allowed) -> list[PlannedWrite]:
    """Plan every write before the first is made."""
    return [plan_write(drive.model, drive.codec, drive.number, register, word, allowed) for register, word in steps]


async def _one_by_one(session: Session, drive: Drive, plans: Sequence[PlannedWrite]) -> Shown:
    """Make the writes in order, up to the first that fails."""
    outcomes = []
    for write in plans:
        outcomes.append(await session.write(drive, write))
        if not outcomes[-1].verdict.is_good:
            break
    used = f"one by one, {label(plans[-1].register)} last: {plans[-1].used}"
    return Shown(used, tuple(outcomes), (*await _give_back(session, drive), *await _notes(session, drive)))


async def _by_block(session: Session, drive: Drive, steps: Sequence[PlannedWrite], select: PlannedWrite) -> Shown:
    """Write all five words in one frame, and FA80 back to 0, whatever happens."""
    mode = _register(drive, BLOCK_MODE)
    before = await session.read(drive, mode)
    on, back = _plans(drive, [(mode, 1), (mode, 0)], Allowed())
    try:
        switched = await session.write(drive, on)
        if not switched.verdict.is_good:
            return Shown("block mode (FA80)", (switched,), (switched.note,))
        notes = await _exchange(session, drive, [write.word for write in steps])
    finally:
        await to_the_end(_restore(session, drive, back))
    outcomes = [await _read_back(session, drive, write) for write in steps]
    if all(outcome.verdict.is_good for outcome in outcomes):
        outcomes.append(await session.write(drive, select))
    used = f"all digits in one frame (X, {label(mode)} = 1 meanwhile), RAM only"
    left_behind = (_left_behind(mode),) if before else ()
    return Shown(used, tuple(outcomes), (*notes, *left_behind, *await _notes(session, drive)))


async def _give_back(session: Session, drive: Drive) -> tuple[str, ...]:
    """Set FA80 to 0 where somebody has left it behind, and say so; not where that would wear the EEPROM."""
    if not has_block_mode(drive):
        return ()
    mode = _register(drive, BLOCK_MODE)
    if not await session.read_if_possible(drive, mode):
        return ()
    (back,) = _plans(drive, [(mode, 0)], Allowed())
    await to_the_end(_restore(session, drive, back))
    return (_left_behind(mode),)


def _left_behind(mode: Register) -> str:
    return f"{label(mode)} was 1, left behind by another display: it is set to 0, and the block carries values again"


async def _exchange(session: Session, drive: Drive, words: Sequence[int]) -> tuple[str, ...]:
    """Send the frame; return what it says was shown before."""
    blocks = drive.model.blocks
    request = Exchange(
        drive.number, blocks.indirect_read_address, len(words), blocks.indirect_write_address, tuple(words)
    )
    try:
        reply = await session.send(drive.codec, request, processing_time(drive))
    except (NoReply, BadReply) as error:
        return (f"the block was not acknowledged ({error})",)
    if not isinstance(reply, Exchanged):
        return ()
    return (f"shown before: {panel.text_of(reply.words[: panel.DIGITS])!r}",)


async def _restore(session: Session, drive: Drive, back: PlannedWrite) -> None:
    """Set FA80 back; repeated, for it does no harm, and the block carries no values until it is done."""
    reason = ""
    for _ in range(RESTORE_TRIES):
        try:
            outcome = await session.write(drive, back)
        except GatewayError as error:  # LineDown and silence alike
            reason = str(error)
        else:
            reason = outcome.note or outcome.verdict.value
            if outcome.verdict.is_good:
                return
    raise GatewayError(
        f"{drive.name}: {label(back.register)} could not be set back to {back.word} ({reason}): until that is done,"
        " or the drive is reset, the block carries the panel's text instead of values"
    )


async def _read_back(session: Session, drive: Drive, write: PlannedWrite) -> Outcome:
    word = await session.read_if_possible(drive, write.register)
    if word is None:
        return Outcome(drive, write, Verdict.UNKNOWN, None, None, "silent")
    return Outcome(drive, write, Verdict.DONE if write.reads_back(word) else Verdict.NOT_DONE, None, word)


async def _notes(session: Session, drive: Drive) -> tuple[str, ...]:
    """Say where the panel is set to show something else."""
    monitor = drive.model.registers.get(MONITOR)
    if monitor is None or monitor.enumeration is None:
        return ()
    word = await session.read_if_possible(drive, monitor)
    if word is None or monitor.enumeration.texts.get(word) == BY_COMMUNICATION:
        return ()
    code = next((code for code, text in monitor.enumeration.texts.items() if text == BY_COMMUNICATION), None)
    return (f"the panel shows it only while {label(monitor)} is {code}; it is {word}",)
