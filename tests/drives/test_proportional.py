"""The proportional command: its word, and the frequency that each drive makes of it."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.drives import proportional
from gateway.drives.catalogue import load
from gateway.drives.model import Model
from gateway.drives.proportional import Point
from gateway.drives.scaling import OutOfRange

MB1, NC3, AS3 = (load()[name] for name in ("vf-mb1", "vf-nc3", "vf-as3"))


def points(*values: int) -> dict[str, int]:
    """Return F810 = 1 and F811-F814 as words."""
    names = [name for pair in proportional.POINTS for name in pair]
    return {"frequency_points": 1, **dict(zip(names, values, strict=True))}


def expected(
    percent: str, words: dict[str, int], maximum: Decimal | None = None, model: Model = MB1
) -> Decimal | None:
    """Work out a frequency of a VF-MB1."""
    return proportional.expected(Decimal(percent), model, words, maximum)


def test_the_example_of_the_manual() -> None:
    """VF-MB1 6.1: 50 % is 45 Hz and 40 Hz, by points and by FH."""
    assert proportional.word_of(Decimal("50.00")) == 5000
    assert expected("50", points(0, 0, 100, 9000)) == Decimal("45.00")
    assert expected("50", points(0, 0, 100, 8000)) == Decimal("40.00")
    assert expected("50", {"frequency_points": 0}, Decimal(90)) == Decimal("45.00")


def test_two_points_make_a_line_that_goes_on_beyond_them() -> None:
    """20 % is 10 Hz, 80 % is 70 Hz: 1 Hz for each percent."""
    words = points(20, 1000, 80, 7000)
    assert expected("50", words) == Decimal("40.00")
    assert expected("100", words) == Decimal("90.00")
    assert expected("10", words) == Decimal("0.00")
    assert expected("5", words) is None, "below 0 Hz nobody knows what a drive does"


def test_what_is_below_a_hundredth_is_left_out() -> None:
    """As the drive does (6.1)."""
    assert expected("33.33", points(0, 0, 100, 5000)) == Decimal("16.66")
    assert expected("33.33", {"frequency_points": 0}, Decimal("79.99")) == Decimal("26.66")


def test_nothing_is_guessed() -> None:
    """Without FH, without F810, with equal points, or in counts of an unknown unit."""
    assert expected("50", {"frequency_points": 0}) is None
    assert expected("50", {}) is None
    assert expected("50", {"frequency_points": 1, "point_1_setting": 0}) is None
    assert expected("50", points(30, 1000, 30, 2000)) is None
    assert expected("50", points(0, 0, 100, 6000), model=AS3) is None


def test_only_models_with_the_points_are_known_to_take_it() -> None:
    """E6581657 lists no S command for the VF-nC3."""
    assert [proportional.is_taken_by(model) for model in (MB1, NC3, AS3)] == [True, False, True]
    assert [register.address for register in proportional.registers_of(MB1)] == [0x810, 0x811, 0x812, 0x813, 0x814]
    assert proportional.registers_of(NC3) == ()


@pytest.mark.parametrize("percent", ["-0.01", "100.01", "NaN", "33.333"])
def test_a_wild_percentage_is_refused(percent: str) -> None:
    """The drives check nothing: S is written as it is (VF-MB1 4.2)."""
    with pytest.raises(OutOfRange):
        proportional.word_of(Decimal(percent))


@given(st.integers(0, 100), st.integers(1, 100), st.integers(0, 40000), st.integers(0, 40000))
def test_the_line_goes_through_both_points(setting: int, distance: int, first: int, second: int) -> None:
    """Exactly, whatever the slope."""
    one = Point(Decimal(setting), Decimal(first).scaleb(-2))
    two = Point(Decimal(setting + distance), Decimal(second).scaleb(-2))
    assert proportional.along(one.setting, one, two) == one.frequency
    assert proportional.along(two.setting, one, two) == two.frequency
