"""The commands for the store: show what was counted, and accept a count after some were lost."""

from __future__ import annotations

import time
from math import isfinite
from pathlib import Path
from typing import Annotated

import typer

from gateway import site
from gateway.control.wear import LIFE, Key, Wear
from gateway.store.errors import StoreAway
from gateway.store.schema import in_utc
from gateway.store.state_file import StateFile, look
from gateway.store.store import store_path

DAY = 86_400.0  # seconds
LONG = 36_500.0  # days; what lasts longer is not worth a number

ConfigFile = Annotated[Path, typer.Argument(metavar="FILE", help="configuration file (TOML)")]
Writes = Annotated[
    int, typer.Option(min=0, max=LIFE, help="no parameter has been written more often than that by now")
]

store = typer.Typer(
    help="What is kept over restarts: EEPROM write counters and the audit of commands.", no_args_is_help=True
)


def add_to(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.add_typer(store, name="store")


@store.command()
def show(file: ConfigFile) -> None:
    """Show how often each parameter was written to the EEPROM, also while the gateway runs."""
    path = _path(file)
    saved = look(path)
    for key, wear in sorted(saved.wear.items()):
        typer.echo(_line(key, wear, time.time()))
    typer.echo(
        f"{path}: {len(saved.wear)} parameters counted; every other was written {saved.begins_at} times at most"
    )
    if saved.lost:
        raise StoreAway(f"{saved.lost}: see tosvert-gateway store accept --help")


@store.command()
def accept(file: ConfigFile, writes: Writes) -> None:
    """Accept a count after some were lost with a damaged file, so that the EEPROM may be written again.

    Give the most writes that any parameter of any drive may have had; when in doubt, more. The gateway must not run.
    """
    path = _path(file)
    if not path.exists():
        raise StoreAway(f"{path}: there is no such file, and so nothing is lost; the gateway makes it when it starts")
    state = StateFile.open(path, site.load(file).config.store.audit_rows, time.time())
    try:
        lost = state.read().lost
        if not lost:
            raise StoreAway(f"{path}: no counts are lost; nothing is changed")
        state.accept(writes)
    finally:
        state.close()
    typer.echo(f"{path}: every parameter is now taken to have been written {writes} times at least")


def _path(file: Path) -> Path:
    configured = site.load(file)
    return store_path(configured.config.store, configured.folder)


def _line(key: Key, wear: Wear, now: float) -> str:
    days = wear.seconds_left(now) / DAY
    left = f"{days:.0f} days left at the pace of the last day" if isfinite(days) and days < LONG else ""
    text = f"{key[0]:24} {key[1]:04X}  {wear.writes:6} writes, last {in_utc(wear.last)}"
    return f"{text}; {left}" if left else text
