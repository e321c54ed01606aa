"""Whom a command is for: drives of a configuration file, or one drive given by options."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gateway import site
from gateway.drives.model import Model
from gateway.errors import BadConfig
from gateway.site import Drive, Line

KEY = re.compile(r"command line: line\[0\]\.(?:drive\[0\](?: \(\w+\))?\.)?(\w+)(?: \(\w+\))*")


@dataclass(frozen=True, slots=True)
class Target:
    """Drives of one line. `is_group`: they are written to together; `any_model`: whatever they say they are.

    `models` are those that a drive may be taken for.
    """

    line: Line
    drives: tuple[Drive, ...]
    is_group: bool = False
    any_model: bool = False
    models: Mapping[str, Model] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Chosen:
    """What the options of a command say of its target; what was not given is None."""

    config: Path | None = None
    drive: str | None = None
    group: str | None = None
    everyone: bool = False
    line: str | None = None
    port: str | None = None
    number: int | None = None
    model: str | None = None
    protocol: str = "modbus-rtu"
    baud: int = 19200
    parity: str = "even"
    wait_time: str = "0s"
    catalogue: Sequence[Path] = ()
    any_model: bool = False


def target_of(chosen: Chosen) -> Target:
    """Find the target; BadConfig says what is missing, or what there is to choose from."""
    if (chosen.config is None) == (chosen.port is None):
        raise BadConfig("give --config FILE with --drive, --group or --everyone; or --port, --number and --model")
    if chosen.config is not None:
        loaded = site.load(chosen.config)
        return replace(_configured(loaded, chosen), any_model=chosen.any_model, models=loaded.catalogue)
    if chosen.number is None or chosen.model is None:
        raise BadConfig("--port needs --number and --model as well; `tosvert-gateway scan` finds both")
    if chosen.drive or chosen.group or chosen.everyone or chosen.line:
        raise BadConfig("--drive, --group, --everyone and --line name what stands in a file: give --config too")
    return _by_options(chosen)


def _configured(loaded: site.Site, chosen: Chosen) -> Target:
    if [chosen.drive is not None, chosen.group is not None, chosen.everyone].count(True) != 1:
        raise BadConfig("with --config give one of --drive NAME, --group NAME and --everyone")
    if chosen.number is not None or chosen.model is not None:
        raise BadConfig("--number and --model stand in the file: leave them out, or give --port instead of --config")
    if chosen.drive is not None:
        return _one(loaded, chosen.drive)
    if chosen.group is not None:
        return _group(loaded, chosen.group)
    return _everyone(loaded, chosen.line)


def _one(loaded: site.Site, name: str) -> Target:
    for line in loaded.lines:
        for drive in line.drives:
            if drive.name == name:
                return Target(line, (drive,))
    known = ", ".join(drive.name for drive in loaded.drives)
    raise BadConfig(f"--drive {name}: no such drive; known: {known}")


def _group(loaded: site.Site, name: str) -> Target:
    for line in loaded.lines:
        for group in line.groups:
            if group.name == name:
                by_name = {drive.name: drive for drive in line.drives}
                return Target(line, tuple(by_name[member] for member in group.drives), is_group=True)
    known = ", ".join(group.name for line in loaded.lines for group in line.groups)
    raise BadConfig(f"--group {name}: no such group; known: {known or 'none; see [[line.group]]'}")


def _everyone(loaded: site.Site, name: str | None) -> Target:
    lines = [line for line in loaded.lines if name in (None, line.name)]
    known = ", ".join(line.name for line in loaded.lines)
    if not lines:
        raise BadConfig(f"--line {name}: no such line; known: {known}")
    if len(lines) > 1:
        raise BadConfig(f"--everyone: there are several lines; give --line NAME; known: {known}")
    return Target(lines[0], lines[0].drives, is_group=True)


def whole_path(port: str) -> str:
    """Return the whole path of a port that is given from here (./line); others, socket:// too, as they are."""
    is_here = "://" not in port and not port.startswith("/") and ("/" in port or Path(port).exists())
    return str(Path(port).absolute()) if is_here else port


def _by_options(chosen: Chosen) -> Target:
    """Build a line of one drive, by the rules of a configuration file, its errors named after the options."""
    drive = {
        "name": "drive",
        "number": chosen.number,
        "model": chosen.model,
        "protocol": chosen.protocol,
        "wait_time": chosen.wait_time,
        "unit": 1,
    }
    port = whole_path(chosen.port or "")
    line = {"name": "line", "port": port, "baud": chosen.baud, "parity": chosen.parity, "drive": [drive]}
    files = [str(path.absolute()) for path in chosen.catalogue]
    table: dict[str, Any] = {"gateway": {"name": "command", "catalogue": files}, "line": [line]}
    try:
        loaded = site.build(table, "command line", Path())
    except BadConfig as error:
        raise BadConfig(KEY.sub(lambda match: "--" + match[1].replace("_", "-"), str(error))) from None
    (only,) = loaded.lines
    named = replace(only.drives[0], name=f"number {chosen.number}")
    only = replace(only, drives=(named,))
    return Target(only, only.drives, any_model=chosen.any_model, models=loaded.catalogue)
