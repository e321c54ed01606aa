"""The arithmetic of a line against the figures that the manuals print."""

from __future__ import annotations

import pytest

from gateway.protocol.timing import LineTiming


@pytest.mark.parametrize(("baud", "milliseconds"), [(9600, 4.0), (19200, 2.0), (38400, 1.0)])
def test_the_gap_is_the_manuals_approximate_one_and_not_shorter(baud: int, milliseconds: float) -> None:
    """E6581657 3.1: about 4 ms or more at 9600, 2 at 19200, 1 at 38400."""
    gap = LineTiming(baud).gap * 1000
    assert milliseconds <= gap < milliseconds * 1.01


def test_eight_characters_at_19200_baud_take_4_6_ms() -> None:
    """E6581657 Appendix 2 prints this example."""
    assert LineTiming(19200).request(8) == pytest.approx(0.0046, abs=0.00002)


def test_an_exchange_of_five_words_takes_23_ms_at_19200_baud() -> None:
    """8 characters out, the gap, 5 ms in the drive, 15 characters back, the gap."""
    timing = LineTiming(19200)
    assert timing.exchange(8, 15, 0.005) == pytest.approx(0.02297, abs=0.00001)


def test_an_answer_is_waited_for_until_it_can_be_whole() -> None:
    """The time-out follows from baud rate, processing time and margin."""
    timing = LineTiming(9600)
    assert timing.answer_within(15, 0.015, 0.0) == pytest.approx(timing.gap + 0.015 + 15 * 12 / 9600)
