"""Gives drives a frequency in percent by the S command, and sees what each has made of it (VF-MB1 RS485 6.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from gateway.bus.groups import MODBUS, Reach, reach
from gateway.bus.session import Session, processing_time
from gateway.control.writes import BadCommand, Verdict, Why
from gateway.drives import proportional
from gateway.drives.register import Register
from gateway.errors import BadConfig, BadReply, LineDown, NoReply, Refused
from gateway.protocol.codec import NoSuchForm
from gateway.protocol.pdu import Proportional
from gateway.protocol.registry import PROTOCOLS
from gateway.site import Drive

BINARY = "toshiba-binary"  # the only mode that has it
COMMAND = "frequency_command"  # FA01, the only number that it may carry


@dataclass(frozen=True, slots=True)
class Followed:
    """What one drive made of the command, in Hz. `verdict` is None where nothing says what it should be."""

    drive: Drive
    old: Decimal | None
    new: Decimal | None
    expected: Decimal | None
    verdict: Verdict | None


HIGHEST = Decimal(500)  # Hz, FH of any drive at the most

Frame = tuple[Reach, Proportional]


def plan(drives: Sequence[Drive], on_line: Sequence[Drive], percent: Decimal) -> tuple[Frame, ...]:
    """Return the frames to send; BadCommand where a drive does not take the command."""
    word = proportional.word_of(percent)
    for drive in drives:
        _check(drive)
    planned = []
    for address in dict.fromkeys(_register(drive).address for drive in drives):
        alike = [drive for drive in drives if _register(drive).address == address]
        for frame in reach(alike, on_line, BINARY):
            request = Proportional(frame.target, address, word)
            try:
                PROTOCOLS[BINARY].encode(request)
            except NoSuchForm as error:
                raise BadCommand(Why.NO_FORM, f"{alike[0].name}: {error}") from error
            planned.append((frame, request))
    return tuple(planned)


def _check(drive: Drive) -> None:
    if drive.protocol == MODBUS:
        raise BadCommand(Why.NO_FORM, f"{drive.name}: MODBUS-RTU has no proportional command; it is TOSHIBA binary")
    if not proportional.is_taken_by(drive.model) or COMMAND not in drive.model.registers:
        text = f"{drive.name}: {drive.model.name} is not known to have the proportional command (S, F810-F814)"
        raise BadCommand(Why.NO_FORM, text)


def _register(drive: Drive) -> Register:
    return drive.model.registers[COMMAND]


async def expectations(
    session: Session, drives: Sequence[Drive], percent: Decimal, maximum: Decimal | None
) -> Mapping[str, Decimal | None]:
    """Read F810-F814, and FH where the catalogue has it, and work out each drive's frequency in Hz, by name.

    BadCommand where one would be beyond FH, or what FA01 takes: the drives do not check it. `maximum` is FH, where it
    was given. NoReply: the only drive is silent.
    """
    found = {}
    for drive in drives:
        words = await _settings(session, drive, is_only=len(drives) == 1)
        found[drive.name] = proportional.expected(percent, drive.model, words, maximum)
        _check_limit(drive, found[drive.name], maximum or _maximum(drive, words))
    return found


def maximum_of(text: str) -> Decimal:
    """Read FH in Hz; BadConfig where it is no frequency that a drive can have."""
    try:
        value = Decimal(text) if text.isascii() else Decimal("NaN")
    except InvalidOperation:
        value = Decimal("NaN")
    if not value.is_finite() or not 0 < value <= HIGHEST:
        raise BadConfig(f"--fh {text}: give FH in Hz, above 0 and up to {HIGHEST}")
    return value


async def _settings(session: Session, drive: Drive, *, is_only: bool) -> dict[str, int]:
    """Read what a drive converts by, as far as it has it; silence of the only drive passes through (NoReply)."""
    words = {}
    for register in proportional.registers_of(drive.model):
        try:
            words[register.name] = await session.read(drive, register)
        except Refused:
            continue
        except (NoReply, BadReply):
            if is_only:
                raise
            break
    return words


def _maximum(drive: Drive, words: Mapping[str, int]) -> Decimal | None:
    name = proportional.MAXIMUM
    return drive.model.registers[name].decode(words[name]) if name in words else None


def _check_limit(drive: Drive, frequency: Decimal | None, limit: Decimal | None) -> None:
    if frequency is None:
        return
    if frequency > _highest(drive):
        text = f"{drive.name}: F810-F814 make {frequency} Hz of that, beyond {_highest(drive)} Hz: put them right"
        raise BadCommand(Why.RANGE, text)
    if limit is not None and frequency > limit:
        raise BadCommand(Why.RANGE, f"{drive.name}: that is {frequency} Hz, beyond FH, {limit} Hz")


def _highest(drive: Drive) -> Decimal:
    """Return the most that FA01 can be given, in Hz."""
    register = _register(drive)
    top = register.scaling.limits[1] if register.maximum is None else register.maximum
    return min(HIGHEST, top * register.scaling.scale)


async def command(
    session: Session,
    drives: Sequence[Drive],
    frames: Sequence[Frame],
    expected: Mapping[str, Decimal | None],
) -> tuple[Followed, ...]:
    """Send the command, which nobody answers, and read back the frequency command of each drive."""
    old = {drive.name: await _read(session, drive) for drive in drives}
    sent: set[str] = set()
    try:
        for frame, request in frames:
            sent |= {drive.name for drive in frame.drives}
            await session.send(PROTOCOLS[BINARY], request, max(map(processing_time, frame.drives)))
    except LineDown:
        return tuple(_lost(drive, old[drive.name], expected[drive.name], drive.name in sent) for drive in drives)
    followed = []
    for drive in drives:
        try:
            new = await _read(session, drive)
        except LineDown:
            new = None
        before, wanted = old[drive.name], expected[drive.name]
        followed.append(Followed(drive, before, new, wanted, _judge(before, new, wanted)))
    return tuple(followed)


def _lost(drive: Drive, old: Decimal | None, expected: Decimal | None, is_sent: bool) -> Followed:
    """Say of a drive on a port that is gone what is known."""
    return Followed(drive, old, None, expected, Verdict.UNKNOWN if is_sent else Verdict.NOT_WRITTEN)


async def _read(session: Session, drive: Drive) -> Decimal | None:
    word = await session.read_if_possible(drive, _register(drive))
    return None if word is None else _register(drive).decode(word)


def _judge(old: Decimal | None, new: Decimal | None, expected: Decimal | None) -> Verdict | None:
    """Judge what reads back: a count more or less is rounding (6.1).

    Where nothing is expected a change says that it was heard, and nothing says that it was not: unknown.
    """
    if new is None:
        return Verdict.UNKNOWN
    if expected is None:
        return Verdict.UNKNOWN if old is None or new == old else None
    return Verdict.DONE if abs(new - expected) <= proportional.STEP else Verdict.NOT_DONE


def told(followed: Followed) -> str:
    """Say what a drive made of it: "fan-1: 0.00 Hz -> 45.00 Hz (expected 45.00 Hz): done"."""
    old, new = ("?" if value is None else f"{value} Hz" for value in (followed.old, followed.new))
    if followed.expected is None:
        expected = "not known what to expect: F810 is 0 and FH is unknown, or F811-F814 tell nothing"
    else:
        expected = f"expected {followed.expected} Hz"
    verdict = "sent" if followed.verdict is None else followed.verdict.value
    return f"{followed.drive.name}: {old} -> {new} ({expected}): {verdict}"
