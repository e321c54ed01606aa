"""Percentiles and their texts."""

from __future__ import annotations

import random

import pytest

from bench.figures import milliseconds, percentile, spread


def test_a_percentile_is_one_of_the_times_whatever_their_order() -> None:
    """Of 1 to 100 ms the median is 51 ms, the 99th percentile and the worst 100 ms."""
    times = [n / 1000 for n in range(1, 101)]
    random.Random(1).shuffle(times)
    assert [percentile(times, share) for share in (0.0, 0.5, 0.99, 1.0)] == [0.001, 0.051, 0.1, 0.1]


def test_no_times_have_no_percentile() -> None:
    """An empty table is an error of the caller, never a 0."""
    with pytest.raises(ValueError, match="no times"):
        percentile([], 0.5)


def test_what_was_not_measured_shows_as_a_dash() -> None:
    """A row in which every command failed still has its columns."""
    assert milliseconds(None) == "-"
    assert spread([]).split() == ["-"] * 4
    assert spread([0.001, 0.002]).split() == ["2.00", "2.00", "2.00", "2.00"]
