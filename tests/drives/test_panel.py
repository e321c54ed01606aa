"""What the panel's digits can show, by the code charts of both manuals."""

from __future__ import annotations

from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.drives import panel
from gateway.drives.catalogue import load
from gateway.drives.panel import CannotShow

# E6581657 7.3.1 and VF-MB1 RS485 8.3.1, column by column: what the charts call BLANK beside a character.
BLANK = {*range(0x20, 0x28), 0x2A, 0x2B, 0x3A, 0x3B, 0x3F, 0x40, 0x57, 0x58, 0x5A, 0x60, 0x77, 0x78, 0x7A, 0x7C, 0x7E}
LIMITS = (0x7F, 0xFF, 0xFF, 0x7F)  # FA70-FA73


def test_the_characters_are_those_of_the_chart() -> None:
    """From 20H to 7EH; the blank itself can be shown, as a blank."""
    chart = {chr(code) for code in range(0x20, 0x7F) if code not in BLANK}
    assert set(panel.SHOWN) == chart | {" "}


def test_the_examples_of_the_manuals() -> None:
    """60.0 with the dot joined to the 0; 0123; the text that the drives are shipped with."""
    assert panel.digits("60.0") == (0x20, 0x36, 0xB0, 0x30)
    assert panel.digits("0123") == (0x30, 0x31, 0x32, 0x33)
    assert panel.digits("dAtA") == (0x64, 0x41, 0x74, 0x41)
    registers = load()["vf-nc3"].registers
    shipped = [registers[f"led_text_1_digit_{place}"].initial for place in (1, 2, 3, 4)]
    assert panel.text_of(shipped) == "dAtA"


def test_a_text_stands_at_the_right() -> None:
    """Missing digits on the left are blank; no text is a dark panel."""
    assert panel.digits("Ab") == (0x20, 0x20, 0x41, 0x62)
    assert panel.digits("") == (0x20,) * 4


def test_a_dot_takes_a_digit_only_where_there_is_nothing_to_join_it_to() -> None:
    """At the start, and behind another dot; a comma is a dot."""
    assert panel.digits(".5") == (0x20, 0x20, 0x2E, 0x35)
    assert panel.digits("1..2") == (0x20, 0xB1, 0x2E, 0x32)
    assert panel.digits("6,0", LIMITS) == (0x20, 0x20, 0xB6, 0x30)


@pytest.mark.parametrize("character", sorted(chr(code) for code in (BLANK - {0x20}) | {0x1F, 0x7F, 0xE4}))
def test_what_the_display_cannot_show_is_refused_with_what_it_can(character: str) -> None:
    """Nothing becomes a blank by itself."""
    with pytest.raises(CannotShow, match="0123456789") as caught:
        panel.digits(f"A{character}")
    assert repr(character) in str(caught.value)


def test_more_than_four_digits_are_refused() -> None:
    """Dots that are joined do not count."""
    assert len(panel.digits("1.2.3.4.")) == 4
    with pytest.raises(CannotShow, match="5 characters; the panel has 4 digits"):
        panel.digits("12345")


def test_the_outer_digits_have_no_dot() -> None:
    """FA70 and FA73 end at 7FH."""
    assert panel.digits("12.34", LIMITS) == (0x31, 0xB2, 0x33, 0x34)
    with pytest.raises(CannotShow, match="digit 1 has no dot; those that have: 2, 3"):
        panel.digits("1.234", LIMITS)
    with pytest.raises(CannotShow, match="digit 4 has no dot"):
        panel.digits("1234.", LIMITS)


@given(st.text(alphabet="".join(sorted(set(panel.SHOWN) - set(panel.DOTS))), max_size=4))
def test_what_is_shown_reads_back(text: str) -> None:
    """Any text without dots, right-aligned."""
    assert panel.text_of(panel.digits(text)) == text.rjust(4)


@given(st.integers(0, 9999), st.integers(0, 2))
def test_every_number_that_the_panel_has_goes_in(digits: int, decimals: int) -> None:
    """Its digits and the place of its point."""
    text = f"{Decimal(digits).scaleb(-decimals):.{decimals}f}"
    assert panel.number_of(text) == panel.Number(digits, decimals)


@pytest.mark.parametrize("text", ["10000", "1000.0", "100.00", "0.001", "-1", "NaN", "Infinity", "1e9"])
def test_numbers_that_do_not_fit_are_refused(text: str) -> None:
    """With what would fit."""
    with pytest.raises(CannotShow, match=r"the panel shows 0 to 9999, 0\.0 to 999\.9 or 0\.00 to 99\.99"):
        panel.number_of(text)


def test_what_is_no_number_and_no_unit_is_said() -> None:
    """The units are the two LEDs."""
    with pytest.raises(CannotShow, match="'x' is no number"):
        panel.number_of("x")
    assert [panel.unit_of(unit) for unit in ("none", "Hz", "%", "hz%")] == [0, 1, 2, 3]
    with pytest.raises(CannotShow, match="'A' is no unit of the panel; units: none, hz, %, hz%"):
        panel.unit_of("A")
