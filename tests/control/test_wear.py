"""How worn a parameter is: its pace forgets, its count does not."""

from __future__ import annotations

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.control.wear import LIFE, MEMORY, UNWORN, Wear, last_write

DAY = 86_400.0
GAPS = st.lists(st.floats(0, 10 * DAY), max_size=50)


def written(gaps: list[float], start: float = 1000.0) -> tuple[Wear, float]:
    """Return what becomes of a parameter that is written after each of these pauses, and when that is."""
    wear, now = UNWORN, start
    for gap in gaps:
        now += gap
        wear = wear.after_write(now)
    return wear, now


@pytest.mark.hazard("H08")
@pytest.mark.parametrize("every", [600.0, 3600.0, 6 * 3600.0])
def test_the_life_left_is_that_of_the_pace_seen(every: float) -> None:
    """Written once an hour, the rest of its writes last for as many hours; never said to be more than that."""
    wear, now = written([every] * 2000)
    assert wear.writes == 2000
    assert 0.85 < wear.seconds_left(now) / ((LIFE - 2000) * every) < 1


@pytest.mark.hazard("H08")
def test_a_controller_that_writes_without_end_is_noticed_on_the_first_day() -> None:
    """At the rate that is permitted by default, after eight hours: less than three months are left."""
    wear, now = written([180.0] * 160)
    assert wear.seconds_left(now) / DAY < 90


def test_a_burst_at_commissioning_is_soon_forgotten() -> None:
    """A year is left during it, and ever more afterwards."""
    wear, now = written([1.0] * 20)
    assert 365 < wear.seconds_left(now) / DAY < 600
    assert wear.seconds_left(now + 7 * DAY) > 100 * 365 * DAY


def test_without_writes_it_lasts_for_ever_and_a_worn_one_is_worn() -> None:
    """And no number of writes makes time negative."""
    assert UNWORN.seconds_left(5.0) == inf
    assert Wear(LIFE, 0.1, 0.0).seconds_left(5.0) == 0.0
    assert Wear(LIFE + 5, 0.0, 0.0).seconds_left(5.0) == 0.0


@given(gaps=GAPS, pause=st.floats(-DAY, 100 * DAY))
def test_the_pace_only_falls_while_nothing_is_written(gaps: list[float], pause: float) -> None:
    """Also by a clock that is set back it does not grow; its share is that of a mean over a day."""
    wear, now = written(gaps)
    assert wear.writes == len(gaps)
    assert 0 <= wear.pace_at(now + pause) <= wear.pace <= len(gaps) / MEMORY + 1e-12


@given(first=GAPS, second=GAPS)
def test_of_two_accounts_the_worse_is_believed(first: list[float], second: list[float]) -> None:
    """In each respect, whichever comes first."""
    one, other = written(first)[0], written(second, start=2000.0)[0]
    joined = one.joined(other)
    assert joined == other.joined(one)
    assert joined.writes >= max(one.writes, other.writes)
    assert joined.joined(one) == joined


def test_the_last_write_to_a_drive_is_that_of_any_parameter() -> None:
    """Of that drive alone."""
    wear = {("pump", 1): Wear(1, 0.0, 10.0), ("pump", 2): Wear(1, 0.0, 30.0), ("fan", 1): Wear(1, 0.0, 99.0)}
    assert (last_write(wear, "pump"), last_write(wear, "fan"), last_write(wear, "mixer")) == (30.0, 99.0, -inf)
