"""What communication shows on the LEDs: four characters and the lights for Hz and %, by FA65 (E6581657 7.3.1)."""

from __future__ import annotations

from collections.abc import Sequence

from gateway.sim.memory import Memory

TEXT_1 = ("led_text_1_digit_1", "led_text_1_digit_2", "led_text_1_digit_3", "led_text_1_digit_4", "led_unit_1")
TEXT_2 = ("led_text_2_digit_1", "led_text_2_digit_2", "led_text_2_digit_3", "led_text_2_digit_4", "led_unit_2")
NUMBER, FIRST_TEXT, SECOND_TEXT = range(3)  # FA65
TEXTS = {FIRST_TEXT: TEXT_1, SECOND_TEXT: TEXT_2}
DIGITS = 4
DOT = 0x80  # of a character, behind it


def shown(memory: Memory) -> Sequence[int]:
    """Return the five words of what is displayed now."""
    selection = memory.word("led_selection", FIRST_TEXT)
    if selection == NUMBER:
        return [*_number(memory.word("led_number"), memory.word("led_decimal_point")), memory.word("led_unit_0")]
    return [memory.word(name) for name in TEXTS[selection]]


def _number(number: int, decimals: int) -> list[int]:
    """Return a number's characters, from the right, blanks before it: 5 with two decimals is " 0.05"."""
    characters = list(f"{number:0{decimals + 1}d}".rjust(DIGITS).encode())
    if decimals:
        characters[DIGITS - 1 - decimals] |= DOT
    return characters
