"""Gives drives a frequency in percent by the S command, and sees what each has made of it (VF-MB1 RS485 6.1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

from gateway.bus.groups import MODBUS, Reach, reach
from gateway.bus.session import Session, processing_time
from gateway.bus.writes import BadCommand, Verdict, Why
from gateway.drives import proportional
from gateway.drives.register import Register
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

    BadCommand where one would be beyond FH: the drives do not check it. `maximum` is FH, where it was given.
    """
    found = {}
    for drive in drives:
        words = {}
        for register in proportional.registers_of(drive.model):
            word = await session.read_if_possible(drive, register)
            if word is not None:
                words[register.name] = word
        found[drive.name] = proportional.expected(percent, drive.model, words, maximum)
        _check_limit(drive, found[drive.name], maximum or _maximum(drive, words))
    return found


def _maximum(drive: Drive, words: Mapping[str, int]) -> Decimal | None:
    name = proportional.MAXIMUM
    return drive.model.registers[name].decode(words[name]) if name in words else None


def _check_limit(drive: Drive, frequency: Decimal | None, limit: Decimal | None) -> None:
    if frequency is not None and limit is not None and frequency > limit:
        raise BadCommand(Why.RANGE, f"{drive.name}: that is {frequency} Hz, beyond FH, {limit} Hz")


async def command(
    session: Session,
    drives: Sequence[Drive],
    frames: Sequence[Frame],
    expected: Mapping[str, Decimal | None],
) -> tuple[Followed, ...]:
    """Send the command, which nobody answers, and read back the frequency command of each drive."""
    old = {drive.name: await _read(session, drive) for drive in drives}
    for frame, request in frames:
        await session.send(PROTOCOLS[BINARY], request, max(map(processing_time, frame.drives)))
    followed = []
    for drive in drives:
        new = await _read(session, drive)
        verdict = _judge(new, expected[drive.name])
        followed.append(Followed(drive, old[drive.name], new, expected[drive.name], verdict))
    return tuple(followed)


async def _read(session: Session, drive: Drive) -> Decimal | None:
    word = await session.read_if_possible(drive, _register(drive))
    return None if word is None else _register(drive).decode(word)


def _judge(new: Decimal | None, expected: Decimal | None) -> Verdict | None:
    """Judge what reads back: a count more or less is rounding (6.1)."""
    if new is None:
        return Verdict.UNKNOWN
    if expected is None:
        return None
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
