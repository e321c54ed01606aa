"""What the four digits of a drive's panel can show, and the words that show it (E6581657 7.3.1, VF-MB1 8.3.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation

from gateway.errors import GatewayError

DIGITS = 4
DOT = 0x80  # bit 7 adds a dot behind the character
DOTS = ".,"  # 2EH and 2CH show a dot alone
SHOWN = " (),-./0123456789<=>ABCDEFGHIJKLMNOPQRSTUVY[\\]^_abcdefghijklmnopqrstuvy{}"
LARGEST_NUMBER = 9999
MOST_DECIMALS = 2

UNITS = {"none": 0, "hz": 1, "%": 2, "hz%": 3}  # FA68, FA74, FA79: which of the LEDs Hz and % are on


class CannotShow(GatewayError):
    """The panel cannot show this: the message says what it can."""


@dataclass(frozen=True, slots=True)
class Number:
    """A number on the panel: FA66 its digits, FA67 how many of them are decimals."""

    digits: int
    decimals: int


def characters(text: str) -> tuple[int, ...]:
    """Return the words of a text's characters; a dot is joined to the character before it."""
    words: list[int] = []
    for place, character in enumerate(text):
        if character not in SHOWN:
            raise CannotShow(f"the panel cannot show {character!r}; it can: {SHOWN.strip()} and blanks")
        if character in DOTS and place > 0 and text[place - 1] not in DOTS:
            words[-1] |= DOT
        else:
            words.append(ord(character))
    return tuple(words)


def digits(text: str, highest: Sequence[int | None] = (None,) * DIGITS) -> tuple[int, ...]:
    """Return the words of the digits from left to right, the text right-aligned.

    `highest` are the greatest words that the digits take: those that stop at 7FH have no dot.
    """
    words = characters(text)
    if len(words) > DIGITS:
        raise CannotShow(f"{text!r} has {len(words)} characters; the panel has {DIGITS} digits, dots not counted")
    words = (ord(" "),) * (DIGITS - len(words)) + words
    for place, (word, limit) in enumerate(zip(words, highest, strict=True), 1):
        if limit is not None and word > limit:
            with_dots = [str(i) for i, most in enumerate(highest, 1) if most is None or most & DOT]
            raise CannotShow(f"{text!r}: digit {place} has no dot; those that have: {', '.join(with_dots)}")
    return words


def text_of(words: Sequence[int]) -> str:
    """Return the text that words show, blanks for what the chart calls blank."""
    shown = ""
    for word in words:
        character = chr(word & 0x7F)
        shown += (character if character in SHOWN else " ") + ("." if word & DOT else "")
    return shown


def number_of(text: str) -> Number:
    """Return how a number such as 12.3 stands on the panel: 0 to 9999, with up to two decimals."""
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise CannotShow(f"{text!r} is no number") from None
    exponent = value.as_tuple().exponent
    decimals = max(0, -exponent) if isinstance(exponent, int) else -1
    if decimals < 0 or decimals > MOST_DECIMALS or not 0 <= value.scaleb(decimals) <= LARGEST_NUMBER:
        raise CannotShow(f"{text}: the panel shows 0 to 9999, 0.0 to 999.9 or 0.00 to 99.99")
    return Number(int(value.scaleb(decimals)), decimals)


def unit_of(text: str) -> int:
    """Return the word of the unit LEDs: none, hz, %, hz%."""
    if text.lower() not in UNITS:
        raise CannotShow(f"{text!r} is no unit of the panel; units: {', '.join(UNITS)}")
    return UNITS[text.lower()]
