"""Scaling: every word comes back as it went, and what does not fit is refused."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.drives.scaling import OutOfRange, Scaling

SCALES = [Decimal(text) for text in ("0.01", "0.1", "1", "10", "1000", "0.5", "0.0001", "2.5")]
scalings = st.builds(Scaling, st.sampled_from(SCALES), st.booleans())
words = st.integers(0, 0xFFFF)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("scale", ["0.01", "1", "10"])
def test_all_65536_words_come_back_as_they_went(scale: str, signed: bool) -> None:
    """Decode and encode each word there is."""
    scaling = Scaling(Decimal(scale), signed)
    assert [scaling.encode(scaling.decode(word)) for word in range(0x10000)] == list(range(0x10000))


@given(scalings, words)
def test_decode_and_encode_are_inverse(scaling: Scaling, word: int) -> None:
    """Round trip at any scale, signed or not."""
    assert scaling.encode(scaling.decode(word)) == word


@given(scalings, words)
def test_the_text_form_is_exact(scaling: Scaling, word: int) -> None:
    """The decimals of the scale are enough to write any value of it."""
    value = scaling.decode(word)
    assert Decimal(f"{value:.{scaling.digits}f}") == value


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("scale", SCALES)
def test_the_text_that_is_written_is_the_value(scale: Decimal, signed: bool) -> None:
    """With the decimals of the scale, of words around every end and in between."""
    scaling = Scaling(scale, signed)
    for word in (*range(300), *range(0x7F00, 0x8100), *range(0xFF00, 0x10000), 6000, 12_345, 50_001):
        assert scaling.format(word) == f"{scaling.decode(word):.{scaling.digits}f}"


@given(scalings, words)
def test_the_nearest_float_is_the_one_of_the_exact_value(scaling: Scaling, word: int) -> None:
    """Rounded once and not twice."""
    assert scaling.nearest(word) == float(scaling.decode(word))


numbers = st.decimals() | st.decimals(-400, 700, places=3) | st.integers(-40_000, 70_000).map(Decimal)


@given(scalings, numbers)
def test_encode_is_exact_or_refuses(scaling: Scaling, value: Decimal) -> None:
    """Any number at all either becomes the word that means it, or is refused."""
    try:
        word = scaling.encode(value)
    except OutOfRange:
        return
    assert 0 <= word <= 0xFFFF
    assert scaling.decode(word) == value


@given(words)
def test_signed_words_are_twos_complement(word: int) -> None:
    """Words from 8000H are negative where the scaling is signed, and never where it is not."""
    assert Scaling(signed=True).raw(word) == int.from_bytes(word.to_bytes(2, "big"), "big", signed=True)
    assert Scaling().raw(word) == word


@pytest.mark.parametrize(
    ("scale", "signed", "word", "value"),
    [
        ("0.01", False, 0x1770, "60.00"),
        ("0.01", False, 0x077B, "19.15"),
        ("0.01", True, 0xD8F0, "-100.00"),
        ("1", True, 0xFFFF, "-1"),
        ("10", False, 0x0003, "30"),
    ],
)
def test_values_of_the_manuals(scale: str, signed: bool, word: int, value: str) -> None:
    """Examples that the manuals print."""
    scaling = Scaling(Decimal(scale), signed)
    assert scaling.decode(word) == Decimal(value)
    assert scaling.encode(Decimal(value)) == word


@pytest.mark.parametrize(("scale", "digits"), [("0.01", 2), ("0.10", 1), ("1", 0), ("10", 0), ("2.5", 1)])
def test_digits_are_those_that_the_scale_gives(scale: str, digits: int) -> None:
    """A trailing zero gives no decimal, a scale above 1 neither."""
    assert Scaling(Decimal(scale)).digits == digits


@pytest.mark.hazard("H31")
@pytest.mark.parametrize(
    ("scale", "signed", "value", "reason"),
    [
        ("0.01", False, "655.36", "655.36 is outside 0.00 to 655.35"),
        ("0.01", False, "-0.01", "-0.01 is outside 0.00 to 655.35"),
        ("0.01", True, "327.68", "327.68 is outside -327.68 to 327.67"),
        ("0.01", True, "-327.69", "-327.69 is outside -327.68 to 327.67"),
        ("0.01", False, "60.005", "60.005 is not a multiple of 0.01"),
        ("10", False, "5", "5 is not a multiple of 10"),
        ("0.01", False, "60.0000000000000000000000000000000000001", "is not a multiple of 0.01"),
        ("0.01", False, "1E+999999", r"1E\+999999 is outside 0.00 to 655.35"),
        ("0.01", False, "Infinity", "Infinity is no number"),
        ("0.01", True, "-Infinity", "-Infinity is no number"),
        ("0.01", False, "NaN", "NaN is no number"),
        ("0.01", False, "sNaN", "sNaN is no number"),
    ],
)
def test_what_does_not_fit_one_word_is_refused(scale: str, signed: bool, value: str, reason: str) -> None:
    """Refused with the limits, never rounded and never clamped."""
    with pytest.raises(OutOfRange, match=reason):
        Scaling(Decimal(scale), signed).encode(Decimal(value))
