"""What a scan found, for people, and as a configuration that `tosvert-gateway check` accepts."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from gateway.bus.groups import MODBUS
from gateway.bus.identification import CAPACITY
from gateway.commissioning.findings import Found, Result
from gateway.commissioning.scan_plan import Setting

UNITS = range(1, 248)  # MODBUS-TCP unit ids

NOTHING = """no drive answers. Look at:
  wiring: A and B swapped (adapters name them both ways), the signal ground, 120 ohm at both ends
  power: a drive is deaf for a second after it is switched on
  its panel: F800 baud rate, F801 parity, F802 number, F829 protocol (they act after a reset)
  F805, the send waiting time: --wait-time 200ms
  what was tried: --baud, --parity, --protocol and --numbers narrow it; nothing beyond them was asked"""


def sentences(result: Result) -> Iterator[str]:
    """Yield what was found, a line each."""
    for setting in dict.fromkeys(found.setting for found in result.found):
        yield f"at {setting}:"
        for found in result.found:
            if found.setting == setting:
                yield f"  {_sentence(found)}"
    for setting, protocol, number in result.garbled:
        answers = f"number {number} answers garbage at {setting} ({protocol})"
        yield f"{answers}: do two drives have this number? If not, the line is disturbed"
    if result.has_late_answers:
        yield "an answer came after its time: is a send waiting time set (F805)? Try --wait-time 200ms"
    yield from result.notes
    if not result.found:
        yield NOTHING


def _sentence(found: Found) -> str:
    parts = [f"number {found.number}, {found.protocol}: {found.model_name}, by {found.recognised.by}"]
    model = found.recognised.model
    if model is not None and CAPACITY in found.facts:
        code = found.facts[CAPACITY]
        parts.append(f"capacity {model.capacities.get(code, f'code {code}')}")
    if "cpu_version" in found.facts:
        parts.append(f"CPU version {found.facts['cpu_version']}")
    if found.settings.get("timeout"):
        parts.append("F803 is set: it may act now, for nobody asks this drive any more")
    return "; ".join(parts)


def configuration(result: Result, port: str) -> str:
    """Return a configuration of the drives found at the first setting; "" where no model was recognised.

    A port has one setting: what was found at others is said as a comment, and so is a drive of unknown model.
    """
    known = [found for found in result.found if found.recognised.model is not None]
    if not known:
        return ""
    setting = known[0].setting
    here = [found for found in known if found.setting == setting]
    lines = [*_head(port, setting)]
    for found, name, unit in zip(here, _names(here), _units(here), strict=True):
        lines += _drive(found, name, unit)
    lines += [f"# {line}" for line in _left_out(result, setting)]
    return "\n".join(lines)


def _head(port: str, setting: Setting) -> Sequence[str]:
    return (
        "# Written by tosvert-gateway scan. Add [mqtt], [modbus_tcp] and [web] as config/everything.toml shows them.",
        "[gateway]",
        'name = "gateway"',
        "",
        "[[line]]",
        'name = "line-1"',
        f"port = {json.dumps(port, ensure_ascii=False)}",
        f"baud = {setting.baud}",
        f'parity = "{setting.parity}"',
        "",
    )


def _drive(found: Found, name: str, unit: int) -> Iterator[str]:
    yield "[[line.drive]]"
    yield f'name = "{name}"'
    yield f"number = {found.number}"
    yield f'model = "{found.model_name}"  # by {_comment(found.recognised.by)}'
    yield f'protocol = "{found.protocol}"'
    if unit != found.number:
        yield f"unit = {unit}"
    if (wait := _wait_time(found)) > 0:
        yield f'wait_time = "{wait}ms"  # F805'
    yield ""


def _wait_time(found: Found) -> int:
    """Return F805 in milliseconds, 0 where the drive has none."""
    model, word = found.recognised.model, found.settings.get("wait_time", 0)
    connector = model.connector() if model is not None else None
    if model is None or connector is None or not word:
        return 0
    return int(model.registers[connector.parameters["wait_time"]].decode(word) * 1000)


def _comment(text: str) -> str:
    """Return what a drive says of itself as part of a comment: printable, on one line."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _names(drives: Sequence[Found]) -> Iterator[str]:
    """Name drives by number; a number that is taken in MODBUS-RTU and in TOSHIBA has two drives."""
    taken: set[str] = set()
    for found in drives:
        name = f"drive-{found.number}"
        if name in taken:
            name += "-modbus" if found.protocol == MODBUS else "-toshiba"
        taken.add(name)
        yield name


def _units(drives: Sequence[Found]) -> Iterator[int]:
    """Give each drive its number as its unit, or the next that is free where it is taken, or 0."""
    own = {found.number for found in drives}
    taken: set[int] = set()
    for found in drives:
        unit = found.number
        if unit in taken or unit not in UNITS:
            unit = next(free for free in UNITS if free not in taken | own)
        taken.add(unit)
        yield unit


def _left_out(result: Result, setting: Setting) -> Iterator[str]:
    for found in result.found:
        if found.recognised.model is None:
            yield _comment(f"number {found.number}, {found.protocol}: model not known; {found.recognised.by}")
        elif found.setting != setting:
            yield f"number {found.number} was found at {found.setting}: set it to {setting} (F800, F801)"
