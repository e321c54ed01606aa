"""Counters: histograms count every observation once and answer with bounds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.metrics import ANSWER_BOUNDS, GAP_BOUNDS, LATEST, AnswerTimes, Histogram, LineStats, Responses, Stats


def test_an_observation_is_counted_under_the_first_bound_that_holds_it() -> None:
    """A value that equals a bound lies within it, as Prometheus' "le" says."""
    histogram = Histogram((1.0, 2.0))
    for value in (0.5, 1.0, 1.5, 2.0, 2.5):
        histogram.observe(value)
    assert histogram.counts == [2, 2, 1]
    assert histogram.cumulated() == [2, 4, 5]
    assert histogram.count == 5
    assert histogram.total == 7.5


def test_a_quantile_is_the_bound_below_which_that_share_lies() -> None:
    """Half of the observations are below the median's bound; what is beyond the last bound answers with it."""
    histogram = Histogram((1.0, 2.0, 3.0))
    for value in (0.5, 1.5, 1.5, 9.0):
        histogram.observe(value)
    assert histogram.quantile(0.25) == 1.0
    assert histogram.quantile(0.5) == 2.0
    assert histogram.quantile(1.0) == 3.0


def test_a_quantile_of_nothing_is_zero() -> None:
    """Nothing observed: no bound is claimed."""
    assert Histogram((1.0,)).quantile(0.99) == 0.0


@given(st.lists(st.floats(min_value=0, max_value=10), max_size=50), st.floats(min_value=0.01, max_value=1))
def test_a_quantile_bounds_its_share_of_the_observations(values: list[float], share: float) -> None:
    """At least that share of what was observed up to the last bound lies at or below the quantile."""
    histogram = Histogram(GAP_BOUNDS)
    for value in values:
        histogram.observe(value)
    quantile = histogram.quantile(share)
    below = sum(value <= quantile for value in values)
    assert below >= share * len(values) or quantile in (0.0, GAP_BOUNDS[-1])
    assert histogram.cumulated()[-1] == histogram.count == len(values)


@pytest.mark.parametrize("bounds", [ANSWER_BOUNDS, GAP_BOUNDS])
def test_bounds_rise(bounds: tuple[float, ...]) -> None:
    """The bisection and Prometheus both need rising bounds."""
    assert list(bounds) == sorted(set(bounds))


def test_stats_of_two_lines_are_apart() -> None:
    """No counter is shared by way of a default."""
    first, second = LineStats(), LineStats()
    first.errors["no_reply"] += 1
    first.gaps.observe(0.002)
    assert not second.errors
    assert second.gaps.count == 0
    assert Stats(started=1.0).lines is not Stats(started=1.0).lines


def test_answer_times_have_exact_quantiles_of_the_latest_and_the_longest_of_all() -> None:
    """Each quantile was measured; what is older than the latest no longer counts, but for the longest."""
    times = AnswerTimes()
    assert times.latest() == {}
    times.observe(0.5)
    for place in range(LATEST):
        times.observe((place % 100 + 1) / 1000)
    assert times.latest() == pytest.approx({0.5: 0.05, 0.95: 0.095, 0.99: 0.099}, abs=0.0021)
    assert times.longest == 0.5
    assert times.count == LATEST + 1


@given(st.lists(st.floats(min_value=0, max_value=10), min_size=1, max_size=3 * LATEST))
def test_a_quantile_of_answer_times_has_its_share_of_the_latest_below_it(values: list[float]) -> None:
    """And not a smaller one of them has: as many as the share says, rounded up."""
    times = AnswerTimes()
    for value in values:
        times.observe(value)
    window = values[-LATEST:]
    for share, seconds in times.latest().items():
        assert seconds in window
        assert sum(value <= seconds for value in window) >= share * len(window)
        assert sum(value < seconds for value in window) < share * len(window) + 1


def test_a_response_is_held_against_both_predictions() -> None:
    """The worst stays; later than the first counts, later than the second counts twice."""
    responses = Responses(predicted=0.1, disturbed=0.5)
    for seconds in (0.05, 0.1, 0.3, 0.6, 0.2):
        responses.observe(seconds)
    assert responses == Responses(0.1, 0.5, worst=0.6, late=3, very_late=1)
