"""Raw words to engineering values and back, exactly."""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal

from gateway.errors import GatewayError

WORD = 0x10000  # values of one 16-bit word


class OutOfRange(GatewayError):
    """A value that one word at this scale cannot hold: refuse it, never clamp it."""


@dataclass(frozen=True, slots=True)
class Scaling:
    """How one word stands for a number: `scale` units a count, two's complement where `signed`.

    The manuals say "one's complement" for negative numbers; their examples (FFFFH = -1,
    D8F0H = -100.00 %) are two's complement.
    """

    scale: Decimal = Decimal(1)
    signed: bool = False

    digits: int = field(init=False, repr=False, compare=False)  # decimals that the scale gives: 0.01 has 2
    _counts: int = field(init=False, repr=False, compare=False)  # in one unit, 100 at 0.01; 0 where that is not whole

    def __post_init__(self) -> None:
        exponent = self.scale.normalize().as_tuple().exponent
        digits = max(0, -exponent) if isinstance(exponent, int) else 0
        is_decimal = self.scale == Decimal(1).scaleb(-digits)
        object.__setattr__(self, "digits", digits)
        object.__setattr__(self, "_counts", 10**digits if is_decimal else 0)

    @property
    def limits(self) -> tuple[int, int]:
        """Return the lowest and the highest raw number of one word."""
        return (-WORD // 2, WORD // 2 - 1) if self.signed else (0, WORD - 1)

    def raw(self, word: int) -> int:
        """Return the word as a signed or unsigned whole number."""
        return word - WORD if self.signed and word & 0x8000 else word

    def decode(self, word: int) -> Decimal:
        """Raw word to engineering value, exactly: 6000 at 0.01 is 60.00."""
        return self.raw(word) * self.scale

    def format(self, word: int) -> str:
        """Raw word to text with the scale's decimals: 6000 at 0.01 is "60.00"."""
        counts, raw = self._counts, self.raw(word)
        if not counts:
            return f"{raw * self.scale:.{self.digits}f}"
        if counts == 1:
            return str(raw)
        whole, part = divmod(abs(raw), counts)
        return f"{'-' if raw < 0 else ''}{whole}.{part:0{self.digits}d}"

    def encode(self, value: Decimal) -> int:
        """Engineering value to raw word; OutOfRange where it does not fit exactly into one word."""
        low, high = (limit * self.scale for limit in self.limits)
        if not value.is_finite():
            raise OutOfRange(f"{value} is no number")
        if not low <= value <= high:
            raise OutOfRange(f"{value} is outside {low} to {high}")
        whole = int(value / self.scale)
        if whole * self.scale != value:
            raise OutOfRange(f"{value} is not a multiple of {self.scale}")
        return whole % WORD
