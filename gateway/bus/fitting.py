"""What to change on a line on which polls come late: which group, to what period, or which baud rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil, floor, log10

from gateway.bus import traffic
from gateway.bus.plan import DrivePlan, plan_drive
from gateway.bus.response import Stream, Traffic
from gateway.site import Line

FACTORS = (1.1, 1.2, 1.3, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0, 50.0, 100.0)
BAUDS = (19200, 38400)  # F800: the faster ones that all models have
MANY = 4  # drives that are counted, not named


def ways(line: Line, plans: Sequence[DrivePlan], now: Traffic) -> list[str]:
    """Return what makes every poll answered in time, each enough by itself; empty where nothing of this does."""
    periods = sorted({group.period for plan in plans for group, _ in plan.groups if group.period})
    by_share = sorted(periods, key=lambda period: -_share(now, period))
    one = next(filter(None, (_one_period(plans, now, period) for period in by_share)), "")
    found = one or _all_periods(periods, now)
    return [way for way in (found, _faster(line)) if way]


def _share(now: Traffic, period: float) -> float:
    return sum(stream.cost for stream in now.polls if stream.period == period) / period


def _one_period(plans: Sequence[DrivePlan], now: Traffic, period: float) -> str:
    """Say to what the polls of one period have to be stretched; "" where that alone does not do."""
    for factor in FACTORS:
        longer = rounded(period * factor)
        if _stretched(now, {period: longer}).is_kept:
            names = [plan.drive.name for plan in plans if any(group.period == period for group, _ in plan.groups)]
            who = ", ".join(names) if len(names) < MANY else f"{len(names)} drives"
            return f"poll every {_shown(longer)} instead of every {_shown(period)} ({who})"
    return ""


def _all_periods(periods: Sequence[float], now: Traffic) -> str:
    """Say to what all periods have to be stretched together; "" where that does not do."""
    for factor in FACTORS:
        longer = {period: rounded(period * factor) for period in periods}
        if _stretched(now, longer).is_kept:
            changes = ", ".join(f"{_shown(period)} to {_shown(other)}" for period, other in longer.items())
            return f"make every period {factor:g} times as long ({changes})"
    return ""


def _faster(line: Line) -> str:
    """Say which baud rate is enough; "" where none is."""
    for baud in BAUDS:
        if baud > line.baud:
            faster = replace(line, baud=baud)
            plans = [plan_drive(drive, faster, with_selectors=True) for drive in line.drives]
            if traffic.undisturbed(faster, plans).is_kept:
                return f"raise F800 and line.baud to {baud}"
    return ""


def _stretched(now: Traffic, longer: dict[float, float]) -> Traffic:
    polls = [Stream(longer.get(stream.period, stream.period), stream.cost) for stream in now.polls]
    return Traffic(polls, now.ahead, now.reserved)


def rounded(seconds: float) -> float:
    """Return a period of two figures that is not shorter."""
    step = 10.0 ** (floor(log10(seconds) + 1e-9) - 1)
    return float(f"{ceil(seconds / step - 1e-6) * step:.6g}")


def _shown(seconds: float) -> str:
    return f"{seconds * 1000:.0f} ms" if seconds < 10 else f"{seconds:g} s"
