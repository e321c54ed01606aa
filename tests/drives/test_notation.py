"""How people write registers and values."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.drives import notation
from gateway.drives.catalogue import load
from gateway.drives.notation import NotUnderstood
from gateway.drives.scaling import OutOfRange

MODEL = load()["vf-mb1"]
COMMAND = MODEL.registers["command"]
FREQUENCY = MODEL.registers["frequency_command"]
TORQUE = MODEL.registers["torque"]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("output_frequency", "output_frequency"),
        ("FD00", "output_frequency"),
        ("fd00", "output_frequency"),
        ("0xFD00", "output_frequency"),
        ("FD00H", "output_frequency"),
        ("F803", "communication_timeout"),
        ("f803", "communication_timeout"),
        ("0803", "communication_timeout"),
        ("0x0803", "communication_timeout"),
        ("ACC", "acceleration_time_1"),
        ("acc", "acceleration_time_1"),
        ("FMOD", "frequency_mode_selection"),
    ],
)
def test_a_register_is_found_by_name_number_and_name_on_the_panel(text: str, name: str) -> None:
    """F803 is a parameter, FD00 a number."""
    assert notation.found(MODEL, text).name == name


def test_an_unknown_register_is_answered_by_the_nearest_one() -> None:
    """Or by the command that lists them."""
    with pytest.raises(NotUnderstood, match=r"no register 'output_frequncy'; did you mean 'output_frequency'\?"):
        notation.found(MODEL, "output_frequncy")
    with pytest.raises(NotUnderstood, match="no register '0123'; see: tosvert-gateway registers vf-mb1"):
        notation.found(MODEL, "0123")
    assert notation.address_of("0123") == 0x0123
    assert notation.address_of("status") is None


def test_every_register_of_every_model_is_found_by_its_name_and_its_number() -> None:
    """In hexadecimal with 0x, with H, and bare."""
    for model in load().values():
        for register in model.registers.values():
            for text in (register.name, f"{register.address:04X}", f"0x{register.address:04x}"):
                assert notation.find(model, text) is register


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("frequency_command", "30.0", 3000),
        ("frequency_command", "30", 3000),
        ("torque", "-1.50", 0xFF6A),
        ("command", "run+command_priority+frequency_priority", 0xC400),
        ("command", "run, command_priority", 0x8400),
        ("command", "0xC400", 0xC400),
        ("command", "C400H", 0xC400),
        ("command", "none", 0),
        ("command", "0", 0),
        ("timeout_action", "Trip, coast stop", 1),
        ("timeout_action", "alarm only", 0),
        ("timeout_action", "2", 2),
        ("trip_code", "OC1", 1),
        ("block_mode", "1", 1),
    ],
)
def test_values_in_units_codes_and_bits(name: str, text: str, word: int) -> None:
    """As the manual calls them."""
    assert notation.word_of(MODEL.registers[name], text) == word


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("frequency_command", "fast", r"'fast' is no value; a number is wanted in Hz"),
        ("command", "runs", r"command \(FA00\): no bit 'runs'; bits: preset_speed_1, .*none clears all"),
        ("command", "run+", "no bit ''"),
        ("command", "1024", "no bit '1024'"),
        ("timeout_action", "stop", r"codes: 0 \(Alarm only\), 1 \(Trip, coast stop\)"),
        ("timeout_action", "", "is no value"),
    ],
)
def test_what_means_nothing_is_answered_by_what_there_is(name: str, text: str, said: str) -> None:
    """Units, bits or codes."""
    with pytest.raises(NotUnderstood, match=said):
        notation.word_of(MODEL.registers[name], text)


def test_a_value_that_no_word_holds_is_refused() -> None:
    """Too many decimals, or too large for a word; the register's own range is judged by whoever writes."""
    for text in ("30.001", "700", "-1"):
        with pytest.raises(OutOfRange):
            notation.word_of(FREQUENCY, text)
    assert notation.word_of(MODEL.registers["timeout_action"], "7") == 7


@pytest.mark.parametrize(("text", "word"), [("6000", 6000), ("0x1770", 6000), ("1770H", 6000), ("65535", 0xFFFF)])
def test_raw_values(text: str, word: int) -> None:
    """Decimal, or hexadecimal with its mark."""
    assert notation.raw_word_of(FREQUENCY, text) == word


def test_raw_values_may_be_negative_where_the_register_is_signed() -> None:
    """And never leave the word."""
    assert notation.raw_word_of(TORQUE, "-1") == 0xFFFF
    for register, text in ((FREQUENCY, "-1"), (FREQUENCY, "65536"), (TORQUE, "-32769"), (FREQUENCY, "1.5")):
        with pytest.raises(NotUnderstood, match="is no raw value; one word is wanted"):
            notation.raw_word_of(register, text)


@given(st.integers(0, 0xFFFF))
def test_what_a_register_says_can_be_written_again(word: int) -> None:
    """The formatted value, the names of the bits, the raw word."""
    assert notation.word_of(FREQUENCY, FREQUENCY.format(word)) == word
    assert notation.word_of(TORQUE, TORQUE.format(word)) == word
    assert notation.word_of(COMMAND, COMMAND.text(word) or "none") == word
    assert notation.raw_word_of(FREQUENCY, f"{word:04X}H") == word


def test_the_label_has_name_and_number() -> None:
    """For every message."""
    assert notation.label(replace(COMMAND, name="x")) == "x (FA00)"
