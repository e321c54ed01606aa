"""From configuration and catalogue to a site that can be run, or to all that is wrong with them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gateway import config as configuration
from gateway.config import Config, DriveSection, LineSection, PollSection
from gateway.drives import catalogue
from gateway.drives.catalogue import Catalogue
from gateway.drives.model import Model
from gateway.errors import BadConfig
from gateway.protocol.timing import LineTiming
from gateway.site.contradictions import contradictions
from gateway.site.margins import usual_margin
from gateway.site.pace import Pace, pace_of, polls_of
from gateway.site.parts import Drive, DriveGroup, Line, Point, PollGroup, Site


def load(path: Path) -> Site:
    """Read and check a configuration file; BadConfig lists everything that is wrong, a line each."""
    return build(configuration.read(path), str(path), path.parent)


def build(table: Mapping[str, Any], name: str, folder: Path) -> Site:
    """Check the table of a configuration file; relative files start from `folder`."""
    wrong = configuration.problems(table)
    models: Catalogue = {}
    try:
        models = catalogue.load(_catalogue_files(table, folder))
    except BadConfig as error:
        wrong += str(error).splitlines()
    if models:
        wrong += contradictions(table, models)
    if wrong:
        raise BadConfig("\n".join(f"{name}: {problem}" for problem in wrong))
    config = Config.model_validate(table)
    return Site(config, tuple(_line(section, models) for section in config.line), models, folder)


def _catalogue_files(table: Mapping[str, Any], folder: Path) -> list[Path]:
    section = table.get("gateway")
    names = section.get("catalogue", []) if isinstance(section, dict) else []
    return [folder / name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def _line(section: LineSection, models: Catalogue) -> Line:
    timing = LineTiming(section.baud)
    pace = pace_of(section, models, timing)
    return Line(
        name=section.name,
        port=section.port,
        baud=section.baud,
        parity=section.parity,
        margin=(section.answer_margin or usual_margin(section.port)) + section.rts_delay_before,
        silent_share=section.silent_share,
        probe_every=section.probe_every,
        probe_at_most=max(section.probe_every, section.probe_at_most),
        drives=tuple(_drive(section.name, drive, models[drive.model], pace) for drive in section.drive),
        groups=tuple(DriveGroup(group.name, tuple(group.drives)) for group in section.group),
        rs485=section.rs485,
        rts_on_send=section.rts_on_send,
        rts_delay_before=section.rts_delay_before,
        rts_delay_after=section.rts_delay_after,
        local_echo=section.local_echo,
    )


def _drive(line: str, section: DriveSection, model: Model, pace: Pace) -> Drive:
    asked = polls_of(section, model)
    groups = tuple(_group(poll, model, pace) for poll in asked)
    points: dict[str, Point] = {}
    for group in groups:
        for register in group.registers:
            known = points.get(register.name)
            if known is None or group.max_age < known.max_age:
                points[register.name] = Point(register, group.max_age)
    return Drive(
        name=section.name,
        line=line,
        number=section.number,
        unit=section.number if section.unit is None else section.unit,
        model=model,
        protocol=section.protocol,
        wait_time=section.wait_time,
        groups=groups,
        points=points,
        derived=tuple(d for d in model.derived if d.of in points),
        deadband=section.deadband,
        provision=section.provision,
        block_write=section.block_write and section.control != "off",
        section=section,
    )


def _group(poll: PollSection, model: Model, pace: Pace) -> PollGroup:
    """Resolve a poll group; a derived value stands for the register that it is computed from."""
    sources = {d.name: d.of for d in model.derived}
    names = dict.fromkeys(sources.get(name, name) for name in poll.values)
    registers = tuple(model.registers[name] for name in names)
    return PollGroup(registers, poll.every, poll.max_age or pace.usual_max_age(poll.every))
