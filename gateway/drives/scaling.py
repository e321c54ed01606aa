"""Raw words to engineering values and back, exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cache

from gateway.errors import GatewayError

WORD = 0x10000  # values of one 16-bit word
MOST_DIGITS = 3  # for which all fractions are written beforehand: a thousand of them


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
    format: Callable[[int], str] = field(init=False, repr=False, compare=False)
    """Raw word to text with the scale's decimals: 6000 at 0.01 is "60.00". Made once, since it is called so often."""

    def __post_init__(self) -> None:
        exponent = self.scale.normalize().as_tuple().exponent
        digits = max(0, -exponent) if isinstance(exponent, int) else 0
        is_decimal = self.scale == Decimal(1).scaleb(-digits)
        object.__setattr__(self, "digits", digits)
        object.__setattr__(self, "_counts", 10**digits if is_decimal else 0)
        object.__setattr__(self, "format", _decimal(digits, signed=self.signed) if is_decimal else self._exact)

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

    def nearest(self, word: int) -> float:
        """Raw word to the floating-point number that is nearest to the engineering value."""
        return self.raw(word) / self._counts if self._counts else float(self.decode(word))

    def _exact(self, word: int) -> str:
        """Write the number of a scale that is no power of ten."""
        return f"{self.decode(word):.{self.digits}f}"

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


def _decimal(digits: int, *, signed: bool) -> Callable[[int], str]:
    """Return what writes words with so many decimals, without any Decimal."""
    if not digits:
        return _whole if signed else str
    counts = 10**digits
    fractions = _fractions(min(digits, MOST_DIGITS))

    def unsigned(word: int) -> str:
        return f"{word // counts}{fractions[word % counts]}"

    def two_complement(word: int) -> str:
        if word < WORD // 2:
            return f"{word // counts}{fractions[word % counts]}"
        return f"-{(WORD - word) // counts}{fractions[(WORD - word) % counts]}"

    def long(word: int) -> str:
        raw = word - WORD if signed and word >= WORD // 2 else word
        return f"{'-' if raw < 0 else ''}{abs(raw) // counts}.{abs(raw) % counts:0{digits}d}"

    if digits > MOST_DIGITS:
        return long
    return two_complement if signed else unsigned


def _whole(word: int) -> str:
    return str(word - WORD if word >= WORD // 2 else word)


@cache
def _fractions(digits: int) -> tuple[str, ...]:
    """Return ".00" to ".99" for two digits."""
    return tuple(f".{part:0{digits}d}" for part in range(10**digits))
