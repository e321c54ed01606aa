"""The commands for commissioning: read, write, display, keys, proportional, scan."""

from __future__ import annotations

import json
import sys
from collections.abc import Awaitable, Callable, Sequence
from decimal import Decimal, InvalidOperation
from functools import wraps
from typing import Annotated, Any, TypeVar

import typer

from gateway.bus.session import Session, opened
from gateway.clock import SystemClock
from gateway.commissioning import display, models, proportional, reading, scanning, writing
from gateway.commissioning.breaking_off import BrokenOff, carry_out
from gateway.commissioning.options import for_target
from gateway.commissioning.targets import Chosen, Target, target_of
from gateway.control.writes import Allowed, BadCommand, Why
from gateway.drives import panel
from gateway.drives.notation import NotUnderstood, label
from gateway.drives.panel import CannotShow
from gateway.drives.scaling import OutOfRange
from gateway.errors import BadConfig, BadReply, NoReply
from gateway.protocol.codec import NoSuchForm
from gateway.site import Drive

WRONG_CALLS = (BadConfig, BadCommand, NotUnderstood, OutOfRange, CannotShow, NoSuchForm)  # the user's to put right
EXIT_NOT_DONE = 1
EXIT_SIGNAL = 128  # and the number of the signal, as shells say it
HINTS = {Why.STORED: "--stored", Why.NO_EFFECT: "--stored", Why.KEYS: "--allow-keys"}
KEYS = ("key_state", "panel_keys", "panel_key_selection")  # FC00, FC01, FA10

Result = TypeVar("Result")
Yes = Annotated[bool, typer.Option("--yes", help="do not ask where a motor may start")]
Stored = Annotated[bool, typer.Option("--stored", help="write the EEPROM (about 10,000 writes)")]


def add_to(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command("scan")(scanning.scan)
    for command in (read, write, display_, keys, proportional_):
        app.command(command.__name__.rstrip("_"))(for_target(_with_hints(command)))


def _with_hints(command: Callable[..., None]) -> Callable[..., None]:
    """Name the option that permits what a command refuses."""

    @wraps(command)
    def hinting(*given: Any, **options: Any) -> None:
        try:
            command(*given, **options)
        except BadCommand as error:
            if error.why in HINTS:
                raise BadCommand(error.why, f"{error} ({HINTS[error.why]})") from error
            raise

    return hinting


def _carry_out(target: Target, work: Callable[[Session], Awaitable[Result]]) -> Result:
    """Open the target's line and do the work on it."""

    async def main() -> Result:
        async with opened(target.line, SystemClock()) as session:
            return await work(session)

    try:
        return carry_out(main())
    except BrokenOff as error:
        typer.echo(f"tosvert-gateway: {error}", err=True)
        raise typer.Exit(EXIT_SIGNAL + error.number) from None


def _finish(is_good: bool) -> None:
    if not is_good:
        raise typer.Exit(EXIT_NOT_DONE)


def _warn(what: str) -> None:
    typer.echo(f"tosvert-gateway: {what}", err=True)


def _confirm(what: Sequence[str], is_agreed: bool) -> None:
    """Ask before anything by which a motor may start; without a terminal only --yes will do."""
    if not what or is_agreed:
        return
    warning = f"{', '.join(what)}: a motor may start, or change its speed, and nobody watches it afterwards."
    if not sys.stdin.isatty():
        raise BadConfig(f"{warning} There is no terminal to ask at: give --yes")
    typer.confirm(f"{warning} Go on?", abort=True, err=True)


def read(
    chosen: Chosen,
    names: Annotated[list[str], typer.Argument(metavar="NAME|NUMBER...", help="output_frequency, FD00, F803")],
    as_json: Annotated[bool, typer.Option("--json", help="print JSON")] = False,
) -> None:
    """Read values of a drive once: name, number, raw word, value in its unit or in words."""
    target = target_of(chosen)
    wanted = [(drive, [reading.wanted(drive.model, name) for name in names]) for drive in target.drives]

    async def work(session: Session) -> list[reading.Reading]:
        values = [item for drive, asked in wanted for item in await _readings(session, target, drive, asked)]
        await models.warn_of_others(session, target, _warn)
        return values

    found = _carry_out(target, work)
    if as_json:
        typer.echo(json.dumps(reading.as_objects(found), indent=2, ensure_ascii=False))
    else:
        for line in reading.as_lines(found):
            typer.echo(line)
    _finish(not any(item.problem for item in found))


async def _readings(
    session: Session, target: Target, drive: Drive, asked: Sequence[reading.Wanted]
) -> list[reading.Reading]:
    """Read a drive's values; a silent one of several is told of, and does not hold up the others."""
    try:
        return await reading.read(session, drive, asked)
    except (NoReply, BadReply) as error:
        if not target.is_group:
            raise
        return [reading.Reading(drive.name, "", problem=str(error))]


def write(
    chosen: Chosen,
    assignments: Annotated[list[str], typer.Argument(metavar="NAME=VALUE...", help="frequency_command=30.0")],
    raw: Annotated[bool, typer.Option("--raw", help="values are raw words: 3000, 0x0BB8")] = False,
    stored: Stored = False,
    again: Annotated[bool, typer.Option("--again", help="write the EEPROM even where the value reads so")] = False,
    allow_keys: Annotated[bool, typer.Option("--allow-keys", help="let FA10, FA11 take the panel's keys")] = False,
    yes: Yes = False,
) -> None:
    """Write values to a drive, or to the drives of a group, and read them back.

    To RAM where drive and protocol can do that. A motor may start when FA00, FA01 or FA13 is written, and runs on
    when the command has ended; a stop is written without a question.
    """
    target = target_of(chosen)
    given = tuple(writing.assignment(text) for text in assignments)
    wish = writing.Wish(given, Allowed(stored, allow_keys), raw, again)
    plans = [plan for writes in writing.plan(target.drives, wish) for _, plan in writes]
    _confirm(list(dict.fromkeys(label(plan.register) for plan in plans if plan.may_start)), yes)
    _finish(_carry_out(target, lambda session: writing.write(session, target, wish, typer.echo, _warn)))


def display_(
    chosen: Chosen,
    text: Annotated[str | None, typer.Argument(help="up to four characters, and dots")] = None,
    value: Annotated[str | None, typer.Option(help="a number instead: 0 to 9999, up to two decimals")] = None,
    unit: Annotated[str, typer.Option(help="unit LEDs: none, hz, %, hz%")] = "none",
    stored: Stored = False,
) -> None:
    """Show a text or a number on a drive's panel (it must be set to F710 = 18)."""
    if (text is None) == (value is None):
        raise BadConfig("give a TEXT, or --value NUMBER")
    target = target_of(chosen)
    led, allowed = panel.unit_of(unit), Allowed(stored=stored)
    number = None if value is None else _shown_number(value)
    words = [() if text is None else display.text_words(drive, text, led) for drive in target.drives]
    for drive, shown in zip(target.drives, words, strict=True):  # all of them, before anything is sent
        display.check(drive, shown if number is None else number, led, allowed)

    async def work(session: Session) -> bool:
        await models.check(session, target, _warn)
        is_good = True
        for drive, shown in zip(target.drives, words, strict=True):
            try:
                if number is not None:
                    done = await display.show_number(session, drive, number, led, allowed)
                else:
                    done = await display.show_text(session, drive, shown, allowed)
            except (NoReply, BadReply) as error:
                if not target.is_group:
                    raise
                done = display.Shown("nothing was written", (), (str(error),), is_silent=True)
            _tell_shown(drive, done)
            is_good &= done.is_good
        return is_good

    _finish(_carry_out(target, work))


def _shown_number(text: str) -> panel.Number:
    """Read a number for the panel, which has neither a sign nor other digits than 0 to 9."""
    if not text.isascii() or text.lstrip().startswith("-"):
        raise CannotShow(f"--value {text}: the panel shows 0 to 9999, 0.0 to 999.9 or 0.00 to 99.99, without sign")
    return panel.number_of(text)


def _tell_shown(drive: Drive, done: display.Shown) -> None:
    """Say how it was shown, and every write that was not done."""
    typer.echo(f"{drive.name}: {'done' if done.is_good else 'not done'}: {done.used}")
    for outcome in done.outcomes:
        if not outcome.verdict.is_good:
            typer.echo(f"  {label(outcome.write.register)}: {writing.told(outcome)}")
    for note in done.notes:
        typer.echo(f"  {note}")


def keys(chosen: Chosen) -> None:
    """Show the keys of a drive's panel: which are pressed, which are in effect, and whose keys work."""
    target = target_of(chosen)

    async def work(session: Session) -> list[reading.Reading]:
        found = []
        for drive in target.drives:
            registers = [drive.model.registers[name] for name in KEYS if name in drive.model.registers]
            if not registers:
                raise BadConfig(f"{drive.model.name}: the catalogue knows nothing of the panel's keys")
            found += await _readings(session, target, drive, registers)
        await models.warn_of_others(session, target, _warn)
        return found

    found = _carry_out(target, work)
    for line in reading.as_lines(found):
        typer.echo(line)
    _finish(not any(item.problem for item in found))


def proportional_(
    chosen: Chosen,
    percent: Annotated[str, typer.Argument(help="0.00 to 100.00")],
    fh: Annotated[str | None, typer.Option(help="FH in Hz, where the catalogue does not know it")] = None,
    yes: Yes = False,
) -> None:
    """Give drives a frequency in percent, which each converts by its own F810-F814 (TOSHIBA binary, RAM only)."""
    target = target_of(chosen)
    share, maximum = _number(percent, "percent"), None if fh is None else proportional.maximum_of(fh)
    frames = proportional.plan(target.drives, target.line.drives, share)
    _confirm(["the proportional command (S, FA01)"], yes)

    async def work(session: Session) -> Sequence[proportional.Followed]:
        await models.check(session, target, _warn)
        expected = await proportional.expectations(session, target.drives, share, maximum)
        return await proportional.command(session, target.drives, frames, expected)

    followed = _carry_out(target, work)
    for frame, _ in frames:
        typer.echo(f"{share} % to {frame.address} ({frame.protocol}): {frame.names}: S, RAM only; nobody answers")
    for item in followed:
        typer.echo(f"  {proportional.told(item)}")
    _finish(all(item.verdict is None or item.verdict.is_good for item in followed))


def _number(text: str, what: str) -> Decimal:
    try:
        value = Decimal(text if text.isascii() else "NaN")
    except InvalidOperation:
        value = Decimal("NaN")
    if not value.is_finite():
        raise BadConfig(f"{what}: a number is wanted (given: {text!r})")
    return value
