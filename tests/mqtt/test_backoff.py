"""How long to wait before the next try."""

from __future__ import annotations

import random

from hypothesis import given
from hypothesis import strategies as st

from gateway.mqtt.backoff import Backoff


@given(least=st.floats(0.01, 10), factor=st.floats(1, 1000), seed=st.integers())
def test_pauses_stay_within_their_bounds(least: float, factor: float, seed: int) -> None:
    """However long the broker is away."""
    most = least * factor
    backoff = Backoff(least, most, random.Random(seed))
    assert all(least <= backoff.next() <= most for _ in range(50))


def test_pauses_grow_and_differ_and_begin_anew() -> None:
    """Thirty tries are far apart; two gateways do not come at the same time."""
    one, two = (Backoff(1.0, 300.0, random.Random(seed)) for seed in (1, 2))
    pauses = [one.next() for _ in range(30)]
    assert 1.0 <= pauses[0] <= 2.0
    assert min(pauses[10:]) >= 150.0
    assert pauses != [two.next() for _ in range(30)]
    one.reset()
    assert one.next() <= 2.0


def test_a_least_pause_above_the_most_is_the_most() -> None:
    """The longest pause is the promise."""
    backoff = Backoff(60.0, 30.0, random.Random(1))
    assert {backoff.next() for _ in range(5)} == {30.0}
