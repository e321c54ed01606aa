"""The frequency that a drive makes of a proportional command in percent (VF-MB1 RS485 4.2, 6.1)."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import ROUND_FLOOR, Decimal

from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.drives.scaling import OutOfRange

STEP = Decimal("0.01")  # % of one count of the command, and Hz of one count of the frequency
HIGHEST = Decimal(100)  # %; FH, or where the points say

SWITCH = "frequency_points"  # F810
MAXIMUM = "maximum_frequency"  # FH, where the catalogue knows it
POINTS = (("point_1_setting", "point_1_frequency"), ("point_2_setting", "point_2_frequency"))  # F811-F814


@dataclass(frozen=True, slots=True)
class Point:
    """One point of the line by which a drive converts: a command in percent and its frequency in Hz."""

    setting: Decimal
    frequency: Decimal


def is_taken_by(model: Model) -> bool:
    """Say whether a model is known to have the S command: its manual describes the points."""
    return SWITCH in model.registers


def registers_of(model: Model) -> tuple[Register, ...]:
    """Return what is to be read of a drive before its frequency can be worked out."""
    names = (SWITCH, *POINTS[0], *POINTS[1], MAXIMUM)
    return tuple(model.registers[name] for name in names if name in model.registers)


def word_of(percent: Decimal) -> int:
    """Return the word of a command: 50.00 % is 5000; OutOfRange where it is none."""
    if not percent.is_finite() or not 0 <= percent <= HIGHEST:
        raise OutOfRange(f"{percent} % is outside 0.00 to {HIGHEST}.00 %")
    counts = percent / STEP
    if counts != int(counts):
        raise OutOfRange(f"{percent} % is not a multiple of {STEP} %")
    return int(counts)


def expected(percent: Decimal, model: Model, words: dict[str, int], maximum: Decimal | None) -> Decimal | None:
    """Return the frequency that a drive will be given, in Hz; None where what was read of it does not tell.

    `words` are the words of `registers_of`, by name. `maximum` is FH in Hz, where somebody knows it better.
    """
    if words.get(SWITCH) is None:
        return None
    if words[SWITCH] == 0:
        top = maximum if maximum is not None else _value(model, words, MAXIMUM, "Hz")
        return None if top is None else _cut(percent * top / 100)
    one, two = (_point(model, words, *names) for names in POINTS)
    return None if one is None or two is None else along(percent, one, two)


def along(percent: Decimal, one: Point, two: Point) -> Decimal | None:
    """Return the frequency on the line through both points; None where it is no line, or leads below 0 Hz."""
    if one.setting == two.setting:
        return None
    rise = (two.frequency - one.frequency) * (percent - one.setting)
    frequency = rise / (two.setting - one.setting) + one.frequency
    return _cut(frequency) if frequency >= 0 else None


def _point(model: Model, words: dict[str, int], setting: str, frequency: str) -> Point | None:
    percent, hertz = _value(model, words, setting, "%"), _value(model, words, frequency, "Hz")
    return None if percent is None or hertz is None else Point(percent, hertz)


def _value(model: Model, words: dict[str, int], name: str, unit: str) -> Decimal | None:
    """Return a value in its unit; None where it was not read, or the catalogue does not know the unit."""
    register = model.registers.get(name)
    if register is None or name not in words or register.unit != unit:
        return None
    return register.decode(words[name])


def _cut(frequency: Decimal) -> Decimal:
    """Leave out what is below 0.01 Hz, as the drive does."""
    return frequency.quantize(STEP, ROUND_FLOOR)
