"""How the rates of eight drives are told from a journal."""

from __future__ import annotations

import pytest

from bench.line_journal import Exchange
from bench.masters import BLOCK, RATES
from bench.three_rates import DRIVES, kept


def read(number: int, address: int, end: float, answer: bytes = bytes(7)) -> Exchange:
    """Return a read that was answered, or refused by five bytes."""
    return Exchange(end - 0.02, end, bytes((number, 3)) + address.to_bytes(2, "big") + b"\0\1??", answer)


def test_each_rate_is_told_by_its_answers() -> None:
    """Half of the answers of one drive, twice as far apart; a refusal is no answer."""
    seconds, period = 10.0, RATES[BLOCK]
    found = [read(number, BLOCK, n * period) for number in range(2, DRIVES + 1) for n in range(round(10 / period))]
    found += [read(1, BLOCK, 2 * n * period) for n in range(round(5 / period))]
    found += [read(1, BLOCK, 0.1, bytes(5))]
    block, *others = kept(found, seconds)
    assert block.share == pytest.approx((DRIVES - 0.5) / DRIVES)
    assert block.median == pytest.approx(period)
    assert block.longest == pytest.approx(2 * period)
    assert [(other.share, other.longest) for other in others] == [(0.0, 0.0)] * 2
