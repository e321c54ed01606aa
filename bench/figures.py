"""Percentiles and texts of measured times, for the tables of several benchmarks."""

from __future__ import annotations

from collections.abc import Sequence


def percentile(times: Sequence[float], share: float) -> float:
    """Return what that share of the times stays below, one of them; ValueError without any."""
    if not times:
        raise ValueError("no times")
    return sorted(times)[min(len(times) - 1, int(share * len(times)))]


def milliseconds(seconds: float | None) -> str:
    """Return a time as text; "-" for none."""
    return "-" if seconds is None else f"{seconds * 1e3:.2f}"


def spread(times: Sequence[float]) -> str:
    """Return median, 90th and 99th percentile and the worst of some times, in columns of milliseconds."""
    of = [percentile(times, share) if times else None for share in (0.5, 0.9, 0.99, 1.0)]
    return " ".join(f"{milliseconds(each):>7}" for each in of)


SPREAD = f"{'p50':>7} {'p90':>7} {'p99':>7} {'worst':>7}"  # the heads of those columns
