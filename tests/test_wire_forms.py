"""Numbers in the forms of a user-defined map; pymodbus' client judges the 32 bits."""

from __future__ import annotations

import struct
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from gateway.wire_forms import FORMS, encoder, rounded

ONE = Decimal(1)
JUDGED = {
    "signed": ModbusClientMixin.DATATYPE.INT16,
    "int32": ModbusClientMixin.DATATYPE.INT32,
    "uint32": ModbusClientMixin.DATATYPE.UINT32,
    "float32": ModbusClientMixin.DATATYPE.FLOAT32,
}
ORDERS = st.sampled_from(["big", "little"])


def judged(form: str, words: bytes, order: str) -> object:
    """Return what pymodbus makes of registers."""
    registers = struct.unpack(f">{len(words) // 2}H", words)
    return ModbusClientMixin.convert_from_registers(
        registers, JUDGED[form], word_order="little" if order == "little" else "big"
    )


@given(st.sampled_from(["signed", "int32", "uint32"]), ORDERS, st.data())
def test_whole_numbers_are_what_a_foreign_client_reads(name: str, order: str, data: st.DataObject) -> None:
    """Over the whole range of each form, in both word orders."""
    form = FORMS[name]
    number = data.draw(st.integers(form.low, form.high))
    told = encoder(form, ONE, order)(Decimal(number))
    assert told is not None
    assert judged(name, told, order) == number


@given(st.decimals(-(10**9), 10**9, places=3), ORDERS)
def test_floats_are_what_a_foreign_client_reads(number: Decimal, order: str) -> None:
    """The nearest number of 32 bits, as struct has it."""
    told = encoder(FORMS["float32"], ONE, order)(number)
    assert told is not None
    (nearest,) = struct.unpack(">f", struct.pack(">f", float(number)))
    assert judged("float32", told, order) == nearest


def test_the_word_order_swaps_words_and_no_bytes() -> None:
    """123456.0 is 47F1 2000H; little has the low word first."""
    assert encoder(FORMS["float32"], ONE, "big")(Decimal(123456)) == bytes.fromhex("47f12000")
    assert encoder(FORMS["float32"], ONE, "little")(Decimal(123456)) == bytes.fromhex("200047f1")
    assert encoder(FORMS["int32"], ONE, "little")(Decimal(0x12345678)) == bytes.fromhex("56781234")
    assert encoder(FORMS["signed"], ONE, "little")(Decimal(-2)) == bytes.fromhex("fffe")


@pytest.mark.parametrize(
    ("number", "whole"), [("0.5", 1), ("-0.5", -1), ("2.5", 3), ("2.4999", 2), ("-2.51", -3), ("-0.49", 0)]
)
def test_halves_go_away_from_zero(number: str, whole: int) -> None:
    """As people round, not as processors do."""
    assert rounded(Decimal(number)) == whole


@pytest.mark.parametrize(
    ("form", "scale", "fits", "does_not"),
    [
        ("signed", "100", "327.67", "327.68"),
        ("signed", "100", "-327.68", "-327.69"),
        ("signed", "1", "32767.49", "32767.5"),
        ("uint32", "1", "0", "-1"),
        ("uint32", "1", "4294967295", "4294967296"),
        ("int32", "1000", "-2147483.648", "-2147483.649"),
    ],
)
def test_what_does_not_fit_is_not_encoded(form: str, scale: str, fits: str, does_not: str) -> None:
    """Neither saturated nor cut off."""
    encode = encoder(FORMS[form], Decimal(scale), "big")
    assert encode(Decimal(fits)) is not None
    assert encode(Decimal(does_not)) is None
