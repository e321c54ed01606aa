"""Register: words in and out, said in the register's own terms."""

from __future__ import annotations

from decimal import Decimal

import pytest

from gateway.drives.model import Model
from gateway.drives.register import Enumeration, Kind, Register, Storage
from gateway.drives.scaling import OutOfRange, Scaling

HZ = Register(
    "frequency", 0xFA01, Kind.COMMAND, "x", unit="Hz", scaling=Scaling(Decimal("0.01")), minimum=50, maximum=6000
)
BITS = Register("flags", 0xFD01, Kind.STATUS, "x", mask=0x0005, bits={0: "ready", 2: "fault"})
CODES = Register(
    "code", 0xFC90, Kind.STATUS, "x", enumeration=Enumeration("codes", {0: "", 24: "err5"}, {0: "Off", 24: "Late"})
)
SIGNED = Register("vib", 0xFE36, Kind.MONITOR, "x", scaling=Scaling(Decimal("0.01"), signed=True))


@pytest.mark.hazard("H20")
def test_undefined_bits_never_become_a_value() -> None:
    """The mask keeps the defined bits only."""
    assert BITS.decode(0xFFFA) == 0
    assert BITS.decode(0xFFFF) == 5


def test_bits_are_named_in_order() -> None:
    """Set bits in words, lowest first; nothing for none."""
    assert BITS.text(0xFFFF) == "ready, fault"
    assert BITS.text(0x8000) == ""


def test_a_code_is_said_with_its_short_name_and_text() -> None:
    """A code without a short name is its text; an unknown one says its number."""
    assert CODES.text(24) == "err5: Late"
    assert CODES.text(0) == "Off"
    assert CODES.text(7) == "unknown code 7"


def test_a_plain_number_has_no_words() -> None:
    """Text is for bits and codes."""
    assert HZ.text(6000) is None


def test_the_value_is_written_with_the_decimals_of_its_scale() -> None:
    """Zeros at the end stay."""
    assert HZ.format(6000) == "60.00"
    assert SIGNED.format(0xD8F0) == "-100.00"
    assert Register("h", 1, Kind.MONITOR, "x", scaling=Scaling(Decimal(10))).format(3) == "30"


@pytest.mark.hazard("H31")
@pytest.mark.parametrize("value", ["0.49", "60.01", "0", "-1", "700"])
def test_a_value_outside_the_registers_range_is_refused(value: str) -> None:
    """The range of the register is narrower than that of a word."""
    with pytest.raises(OutOfRange, match="is outside"):
        HZ.encode(Decimal(value))


@pytest.mark.parametrize(("value", "word"), [("0.50", 50), ("60", 6000)])
def test_the_ends_of_the_range_are_in_it(value: str, word: int) -> None:
    """Both limits are allowed values."""
    assert HZ.encode(Decimal(value)) == word


def test_the_range_is_named_in_the_registers_unit() -> None:
    """The refusal says engineering values, not counts."""
    with pytest.raises(OutOfRange, match=r"^60\.01 is outside 0\.50 to 60\.00$"):
        HZ.encode(Decimal("60.01"))


@pytest.mark.hazard("H20")
def test_bits_that_are_not_defined_are_not_written() -> None:
    """The manuals want reserved bits 0."""
    assert BITS.encode(Decimal(5)) == 5
    with pytest.raises(OutOfRange, match=r"^000DH sets undefined bits: 0008H$"):
        BITS.encode(Decimal(0x000D))


def test_a_register_without_range_takes_what_its_word_holds() -> None:
    """Negative values too, where it is signed."""
    assert SIGNED.encode(Decimal("-327.68")) == 0x8000
    assert SIGNED.storage is Storage.NONE


def test_a_model_finds_a_register_by_its_number() -> None:
    """Numbers that do not exist give None."""
    model = Model("m", "M", "x", {r.name: r for r in (HZ, BITS)})
    assert model.at(0xFD01) is BITS
    assert model.at(0xFD02) is None
    assert model.connector() is None
