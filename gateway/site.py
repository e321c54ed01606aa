"""The site: configuration and catalogue put together, checked, ready to be run."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway import config as configuration
from gateway import site_brokers, site_mapping, site_publishing
from gateway.config import Config, DriveSection, LineSection, PollSection
from gateway.drives import catalogue
from gateway.drives.catalogue import Catalogue
from gateway.drives.model import Model
from gateway.drives.register import Derived, Register
from gateway.errors import BadConfig
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import ReadWords
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.timing import LineTiming

BOARD_MARGIN = 0.020  # seconds; a port on the board adds the kernel's time alone
SERIAL_MARGIN = 0.050  # seconds; a USB adapter without low-latency mode holds an answer back by up to 16 ms
SOCKET_MARGIN = 0.250  # seconds; a serial server adds its packing time and the network's
BOARD_PORTS = ("ttyAMA", "ttyS", "ttyO", "ttyPS", "ttymxc", "ttySC", "serial")  # how UARTs of boards are named
LEAST_MAX_AGE = 1.0  # seconds; below it, one lost frame would make a value stale
MAX_AGE_PERIODS = 3


@dataclass(frozen=True, slots=True)
class PollGroup:
    """Registers of one drive that are read every `period` seconds (0: as fast as the line allows)."""

    registers: tuple[Register, ...]
    period: float
    max_age: float


@dataclass(frozen=True, slots=True)
class Point:
    """A value of one drive: its register and the age in seconds past which it is stale."""

    register: Register
    max_age: float


COMMAND_BITS = frozenset(  # of FA00, without which a drive cannot be commanded
    ("run", "coast", "emergency_stop", "fault_reset", "frequency_priority", "command_priority")
)


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive as configured. `points` holds every polled register once, by name, in the order asked.

    `bases` are registers that derived values need; they are read when the drive is identified.
    """

    name: str
    line: str
    number: int
    unit: int
    model: Model
    protocol: str
    wait_time: float
    groups: tuple[PollGroup, ...]
    points: Mapping[str, Point]
    derived: tuple[Derived, ...]
    deadband: Mapping[str, float]
    provision: bool = False
    block_write: bool = False
    section: DriveSection | None = field(default=None, repr=False)

    @property
    def is_controlled(self) -> bool:
        """Say whether somebody may command it."""
        return self.section is not None and self.section.control != "off"

    def is_commanded_by(self, way: str) -> bool:
        """Say whether somebody may command it by that way in."""
        return self.is_controlled and self.section is not None and way in self.section.sources

    @property
    def codec(self) -> Codec:
        """Return the codec of the protocol that the drive speaks."""
        return PROTOCOLS[self.protocol]

    @property
    def bases(self) -> tuple[Register, ...]:
        """Return the registers that derived values are computed from, each once."""
        return tuple(self.model.registers[name] for name in dict.fromkeys(d.base for d in self.derived))


@dataclass(frozen=True, slots=True)
class DriveGroup:
    """Drives of one line, by name, that are written to together."""

    name: str
    drives: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Line:
    """One RS485 line as configured; times in seconds."""

    name: str
    port: str
    baud: int
    parity: str
    margin: float
    silent_share: float
    probe_every: float
    probe_at_most: float
    drives: tuple[Drive, ...]
    groups: tuple[DriveGroup, ...] = ()
    rs485: str = "auto"
    rts_on_send: bool = True
    rts_delay_before: float = 0.0
    rts_delay_after: float = 0.0
    local_echo: str = "auto"

    @property
    def timing(self) -> LineTiming:
        """Return the arithmetic of this line."""
        return LineTiming(self.baud)

    @property
    def is_network(self) -> bool:
        """Say whether the port is a serial server on the network."""
        return configuration.server_address(self.port) is not None


@dataclass(frozen=True, slots=True)
class Site:
    """All that one gateway serves: its configuration, the folder that it is in, and its lines with their drives."""

    config: Config
    lines: tuple[Line, ...]
    catalogue: Catalogue = field(repr=False)
    folder: Path = Path()

    @property
    def drives(self) -> tuple[Drive, ...]:
        """Return every drive, in the order of the file."""
        return tuple(drive for line in self.lines for drive in line.drives)


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
        wrong += _contradictions(table, models)
    if wrong:
        raise BadConfig("\n".join(f"{name}: {problem}" for problem in wrong))
    config = Config.model_validate(table)
    return Site(config, tuple(_line(section, models) for section in config.line), models, folder)


def _catalogue_files(table: Mapping[str, Any], folder: Path) -> list[Path]:
    section = table.get("gateway")
    names = section.get("catalogue", []) if isinstance(section, dict) else []
    return [folder / name for name in names if isinstance(name, str)] if isinstance(names, list) else []


def _contradictions(table: Mapping[str, Any], models: Catalogue) -> list[str]:
    """Find what is right in form and wrong in fact: models, values, and what must be there once only."""
    wrong: list[str] = []
    once: dict[tuple[str, object], str] = {}
    lines = table.get("line")
    for i, line in enumerate(lines if isinstance(lines, list) else []):
        if isinstance(line, dict):
            for key in ("name", "port"):
                value = _one_port(line.get(key)) if key == "port" else line.get(key)
                wrong += _only_once(once, f"line {key}", value, f"line[{i}].{key}")
            wrong += _group_contradictions(once, line, f"line[{i}]")
    valid = list(configuration.valid_parts(table))
    for key, line, drive in valid:
        label = f"{key} ({drive.name})"
        wrong += _only_once(once, "drive name", drive.name, f"{label}.name")
        unit = drive.number if drive.unit is None else drive.unit
        hint = "" if drive.unit else "; give this drive a unit of its own, or unit = 0: by unit 255 only"
        wrong += _only_once(once, "MODBUS-TCP unit", unit, f"{label}.unit", hint) if unit else []
        wrong += _wrong_number(label, drive)
        family = "MODBUS-RTU" if drive.protocol == "modbus-rtu" else "TOSHIBA"
        wrong += _only_once(once, f"{family} number on line {line.get('name')}", drive.number, f"{label}.number")
        if drive.model not in models:
            wrong.append(f"{label}.model: no model {drive.model!r}; known: {', '.join(sorted(models))}")
            continue
        wrong += _unknown_values(label, drive, models[drive.model])
        wrong += _wrong_control(label, drive, models[drive.model])
    used = [(f"{key} ({d.name})", d, models[d.model]) for key, _, d in valid if d.model in models]
    wrong += site_brokers.contradictions(table, ((f"{key} ({drive.name})", drive) for key, _, drive in valid))
    return [*wrong, *site_publishing.contradictions(table, used), *site_mapping.contradictions(table, used)]


def _wrong_number(label: str, drive: DriveSection) -> Iterator[str]:
    """Find a number that the drive's protocol or the MODBUS-TCP server cannot address."""
    numbers = PROTOCOLS[drive.protocol].forms.numbers
    if drive.number not in numbers:
        known = f"{numbers.start} to {numbers.stop - 1}"
        yield f"{label}.number: {drive.protocol} has the numbers {known} (given: {drive.number})"
    elif drive.number == 0 and drive.unit is None:
        yield f"{label}.unit: number 0 is no MODBUS-TCP unit id; give this drive one of 1 to 247, or 0 for none"


def _group_contradictions(once: dict[tuple[str, object], str], line: Mapping[str, Any], label: str) -> Iterator[str]:
    """Find groups with one name, and members that are not on the line or named twice."""
    drives = line.get("drive")
    names = [drive.get("name") for drive in drives if isinstance(drive, dict)] if isinstance(drives, list) else []
    groups = line.get("group", [])
    for i, group in enumerate(groups if isinstance(groups, list) else []):
        if not isinstance(group, dict):
            continue
        key = f"{label}.group[{i}]"
        yield from _only_once(once, "group name", group.get("name"), f"{key}.name")
        members = group.get("drives")
        members = members if isinstance(members, list) else []
        for member in dict.fromkeys(members):
            if member not in names:
                known = ", ".join(map(str, names))
                yield f"{key}.drives: no drive {member!r} on this line; known: {known}"
            if members.count(member) > 1:
                yield f"{key}.drives: {member!r} is named more than once"


def _wrong_control(label: str, drive: DriveSection, model: Model) -> Iterator[str]:
    """Find a control that nobody could use, that the model has no registers for, or that is not what it says."""
    if drive.control == "off":
        return
    command = model.registers.get("command")
    if command is None:
        yield f"{label}.control: {model.name} has no register 'command' (FA00): add it in a catalogue file"
    elif missing := sorted(COMMAND_BITS - set(command.bits.values())):
        yield f"{label}.control: register 'command' of {model.name} has no bit {', '.join(missing)}"
    elif model.cautions.unanswered.get("command") != "fault_reset":
        yield f'{label}.control: {model.name}: [cautions] has to say unanswered = {{ command = "fault_reset" }}'
    connector = model.connector()
    roles = connector.parameters if connector else {}
    asked = {
        "timeout": ("communication_timeout", drive.communication_timeout),
        "timeout_action": ("timeout_action", drive.timeout_action),
        "timeout_detection": ("timeout_detection", drive.timeout_detection),
    }
    for role, (key, value) in asked.items():
        if value is not None and roles.get(role) not in model.registers:
            yield f"{label}.{key}: {model.name} has no such parameter in its catalogue"
    if drive.on_loss == "quiesce" and drive.timeout_action in (None, "alarm"):
        yield f'{label}.on_loss: "quiesce" leaves the stop to F804: set timeout_action to "stop" or "coast"'


def _one_port(port: object) -> object:
    """Return of a serial server its address, whatever is spoken there, and any other port as it is."""
    with contextlib.suppress(ValueError):
        if isinstance(port, str) and (server := configuration.server_address(port)) is not None:
            return f"{server[0].lower()}:{server[1]}"
    return port


def _only_once(
    seen: dict[tuple[str, object], str], what: str, value: object, key: str, hint: str = ""
) -> Iterator[str]:
    if not isinstance(value, str | int):
        return
    if (what, value) in seen:
        yield f"{key}: {what} {value!r} is taken by {seen[what, value]}{hint}"
    else:
        seen[what, value] = key


def _unknown_values(label: str, drive: DriveSection, model: Model) -> Iterator[str]:
    derived = {d.name for d in model.derived}
    names = [(f"poll[{g}].values", name) for g, poll in enumerate(drive.poll) for name in poll.values]
    if not drive.poll and not model.profile:
        yield f"{label}.poll: {model.name} has no default profile: say what to read"
    for key, name in names + [("deadband", name) for name in drive.deadband]:
        if name in model.registers or name in derived:
            continue
        near = difflib.get_close_matches(name, [*model.registers, *derived], 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        yield f"{label}.{key}: {model.name} has no value {name!r}{hint}"


def usual_margin(port: str) -> float:
    """Return what a kind of port may add to a drive's answer time, in seconds."""
    if configuration.server_address(port) is not None:
        return SOCKET_MARGIN
    folder, _, name = port.rpartition("/")
    is_on_board = folder == "/dev" and name.rstrip("0123456789") in BOARD_PORTS
    return BOARD_MARGIN if is_on_board else SERIAL_MARGIN


def _line(section: LineSection, models: Catalogue) -> Line:
    timing = LineTiming(section.baud)
    pace = _pace(section, models, timing)
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


@dataclass(frozen=True, slots=True)
class _Pace:
    """How fast a line can be read at the worst, in single reads: what each period comes out as.

    `stretch` is by how much the timed polls ask too much of it (1: they fit); `round` is how long one turn of
    the polls without a period takes in what the timed ones leave, in seconds.
    """

    stretch: float
    round: float


LEAST_REST = 0.1  # share of the line that polls without a period are reckoned to get at the least


def _pace(section: LineSection, models: Catalogue, timing: LineTiming) -> _Pace:
    load = turn = 0.0
    for drive in section.drive:
        codec, read = PROTOCOLS[drive.protocol], ReadWords(drive.number, 0)
        size, answer = len(codec.encode(read)), codec.answer_size(read)
        single = timing.exchange(size, answer, models[drive.model].times.processing + drive.wait_time)
        for poll in _polls(drive, models[drive.model]):
            if poll.every:
                load += len(poll.values) * single / poll.every
            else:
                turn += len(poll.values) * single
    return _Pace(max(1.0, load), turn / max(LEAST_REST, 1 - load))


def _polls(section: DriveSection, model: Model) -> list[PollSection]:
    profile = ({"values": list(values), "every": every} for values, every in model.profile)
    return section.poll or [PollSection.model_validate(poll) for poll in profile]


def _drive(line: str, section: DriveSection, model: Model, pace: _Pace) -> Drive:
    asked = _polls(section, model)
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


def _group(poll: PollSection, model: Model, pace: _Pace) -> PollGroup:
    """Resolve a poll group; a derived value stands for the register that it is computed from."""
    sources = {d.name: d.of for d in model.derived}
    names = dict.fromkeys(sources.get(name, name) for name in poll.values)
    reachable = poll.every * pace.stretch or pace.round
    max_age = poll.max_age or max(MAX_AGE_PERIODS * reachable, LEAST_MAX_AGE)
    return PollGroup(tuple(model.registers[name] for name in names), poll.every, max_age)
