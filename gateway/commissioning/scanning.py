"""The command `scan`: its options, its progress on a terminal, and what it prints."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Annotated, Self

import typer
from pydantic import ValidationError
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from gateway.clock import SystemClock
from gateway.commissioning import scan_plan, scan_report
from gateway.commissioning.findings import Result
from gateway.commissioning.scan import Search
from gateway.commissioning.scan import scan as look
from gateway.commissioning.scan_plan import Wish
from gateway.commissioning.targets import whole_path
from gateway.config import LineSection, seconds
from gateway.drives import catalogue
from gateway.errors import BadConfig

EXIT_NOTHING = 1


class Lines:
    """Tells of a scan in plain lines, where nobody looks at a terminal."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Do nothing: there is nothing to clear away."""

    def begin(self, what: str, probes: int) -> None:
        """Print what begins."""
        if probes:
            typer.echo(f"{what}: {probes} questions", err=True)

    def step(self) -> None:
        """Keep quiet about single questions."""

    def tell(self, what: str) -> None:
        """Print what was found."""
        typer.echo(f"  {what}", err=True)


class Bar(Lines):
    """Tells of a scan by a progress bar."""

    def __init__(self) -> None:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        self._progress = Progress(*columns, console=Console(stderr=True), transient=True)
        self._task = self._progress.add_task("", total=None)

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def begin(self, what: str, probes: int) -> None:
        """Begin the bar anew."""
        self._progress.reset(self._task, total=probes, description=what)

    def step(self) -> None:
        """Move the bar on."""
        self._progress.advance(self._task)

    def tell(self, what: str) -> None:
        """Print what was found above the bar."""
        self._progress.console.print(what, markup=False, highlight=False)


def scan(
    port: Annotated[str, typer.Argument(help="/dev/serial/by-id/..., socket://host:port, rfc2217://host:port")],
    baud: Annotated[list[int] | None, typer.Option(help="only this one; may be given several times")] = None,
    parity: Annotated[list[str] | None, typer.Option(help="only even, odd or none")] = None,
    protocol: Annotated[list[str] | None, typer.Option(help="only toshiba, or modbus-rtu")] = None,
    numbers: Annotated[str | None, typer.Option(help="only these, such as 1-16,20")] = None,
    wait_time: Annotated[str, typer.Option(help="F805 of the slowest drive")] = "0s",
    all_settings: Annotated[bool, typer.Option("--all", help="go on where drives are found already")] = False,
    catalogue_file: Annotated[list[Path] | None, typer.Option("--catalogue", help="a further catalogue file")] = None,
) -> None:
    """Find the drives of a line by reading only: protocol, baud rate, parity, numbers, models.

    What is found is printed as a configuration; it can be written to a file: scan PORT > gateway.toml.
    """
    wish = _wish(port, baud or (), parity or (), protocol or (), numbers, wait_time, is_all=all_settings)
    models = catalogue.load(catalogue_file or [])
    longest = _longest(Search(wish, models, SystemClock(), Lines()))
    typer.echo(f"{port}: this takes {longest} where nobody answers", err=True)
    with Bar() if sys.stderr.isatty() else Lines() as watcher:
        result = _scan(Search(wish, models, SystemClock(), watcher))
    for line in scan_report.sentences(result):
        typer.echo(line, err=True)
    typer.echo(scan_report.configuration(result, wish.port), nl=False)
    if not result.found:
        raise typer.Exit(EXIT_NOTHING)


def _wish(
    port: str,
    baud: Sequence[int],
    parity: Sequence[str],
    protocol: Sequence[str],
    numbers: str | None,
    wait_time: str,
    *,
    is_all: bool,
) -> Wish:
    """Check the options; BadConfig says what is wrong with one."""
    port = whole_path(port)
    _check_port(port)
    scan_plan.one_of("--baud", baud, "baud")
    scan_plan.one_of("--parity", parity, "parity")
    try:
        wait = seconds(wait_time)
    except ValueError as error:
        raise BadConfig(f"--wait-time {wait_time}: {error}") from error
    protocols = scan_plan.protocols_of(protocol)
    wanted = () if numbers is None else scan_plan.numbers_of(numbers)
    scan_plan.check_numbers(protocols, wanted)
    bauds, parities = tuple(baud) or scan_plan.BAUDS, tuple(parity) or scan_plan.PARITIES
    return Wish(port, bauds, parities, protocols, wanted, wait, is_all, is_each_baud=bool(baud))


def _check_port(port: str) -> None:
    """Take the ports that a configuration takes."""
    drive = {"name": "x", "number": 1, "model": "x"}
    try:
        LineSection.model_validate({"name": "x", "port": port, "drive": [drive]})
    except ValidationError as error:
        raise BadConfig(f"{port}: {error.errors()[0]['msg'].removeprefix('Value error, ')}") from error


def _longest(search: Search) -> str:
    """Say how long it takes where nobody answers."""
    wish, models = search.wish, search.models
    probes = scan_plan.everything(wish, models)
    is_free = not search.has_fixed_settings
    settings = scan_plan.settings(wish, has_parity=is_free, has_baud=is_free)
    total = sum(scan_plan.longest(probes, setting, search.processing, search.margin) for setting in settings)
    minutes, rest = divmod(int(total + 1), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _scan(search: Search) -> Result:
    return asyncio.run(look(search))
