"""The options by which a command says whom it is for, the same for every command."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any

import typer

from gateway.commissioning.targets import Chosen

FROM_FILE = "Drives of a configuration file"
ONE_DRIVE = "One drive, without a file"
CAUTION = "Caution"


def _option(kind: Any, text: str, panel: str, *names: str, metavar: str | None = None) -> Any:
    return Annotated[kind, typer.Option(*names, help=text, rich_help_panel=panel, metavar=metavar)]


OPTIONS: dict[str, Any] = {
    "config": _option(Path | None, "configuration file (TOML)", FROM_FILE, metavar="FILE"),
    "drive": _option(str | None, "a drive of the file", FROM_FILE, metavar="NAME"),
    "group": _option(str | None, "the drives of a group of the file", FROM_FILE, metavar="NAME"),
    "everyone": _option(bool, "every drive of a line of the file", FROM_FILE, "--everyone"),
    "line": _option(str | None, "which line, with --everyone", FROM_FILE, metavar="NAME"),
    "port": _option(str | None, "/dev/serial/by-id/..., socket://host:port, rfc2217://host:port", ONE_DRIVE),
    "number": _option(int | None, "inverter number (F802)", ONE_DRIVE),
    "model": _option(str | None, "vf-nc3, vf-mb1, vf-as3, or one of your own", ONE_DRIVE),
    "protocol": _option(str, "modbus-rtu, toshiba-ascii or toshiba-binary (F829)", ONE_DRIVE),
    "baud": _option(int, "9600, 19200 or 38400 (F800)", ONE_DRIVE),
    "parity": _option(str, "even, odd or none (F801)", ONE_DRIVE),
    "wait_time": _option(str, "F805 as it is set in the drive", ONE_DRIVE),
    "catalogue": _option(list[Path] | None, "a further catalogue file", ONE_DRIVE, metavar="FILE"),
    "any_model": _option(bool, "write to a drive that says it is of another model", CAUTION, "--any-model"),
}


def for_target(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command whose first argument is a Chosen the options that make one."""
    _, *own = inspect.signature(command, eval_str=True).parameters.values()
    defaults = {field.name: field.default for field in fields(Chosen)} | {"catalogue": None}
    shared = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=defaults[name], annotation=annotation)
        for name, annotation in OPTIONS.items()
    ]

    @wraps(command)
    def with_options(**given: Any) -> None:
        chosen = {name: given.pop(name) for name in OPTIONS}
        command(Chosen(**chosen | {"catalogue": chosen["catalogue"] or ()}), **given)

    with_options.__signature__ = inspect.Signature(own + shared)  # type: ignore[attr-defined]
    with_options.__annotations__ = {parameter.name: parameter.annotation for parameter in own + shared}
    return with_options
