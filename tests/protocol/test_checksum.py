"""The checksums against the manuals' frames, and the CRC against the standard's check value."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.protocol.checksum import crc16, sum8
from tests import frames

PRINTED = [frame for frame in frames.FRAMES if frame.protocol == frames.RTU]
SUMMED = [frame for frame in frames.FRAMES if frame.protocol == frames.BINARY]
WRONG_ON_PURPOSE = "2F 58 02 05 C4 00 17 70 D8"  # to show what a drive says to it


@pytest.mark.parametrize("frame", PRINTED, ids=lambda frame: frame.data.hex())
def test_every_printed_modbus_frame_ends_in_its_crc_but_the_misprinted_one(frame: frames.Frame) -> None:
    """The manual of VF-MB1 misprints one CRC."""
    is_misprint = frame.hex in frames.MISPRINTED
    assert (crc16(frame.data[:-2]) == frame.data[-2:]) is not is_misprint


def test_the_standard_check_value() -> None:
    """CRC-16/MODBUS of "123456789" is 4B37H."""
    assert crc16(b"123456789") == bytes.fromhex("374B")


@given(st.binary(max_size=64), st.integers(0, 511))
def test_a_flipped_bit_is_always_noticed(body: bytes, position: int) -> None:
    """A CRC catches every single-bit error."""
    frame = bytearray(body + crc16(body))
    bit = position % (8 * len(frame))
    frame[bit // 8] ^= 1 << bit % 8
    assert crc16(frame[:-2]) != frame[-2:]


@pytest.mark.parametrize("frame", SUMMED, ids=lambda frame: frame.data.hex())
def test_every_printed_binary_frame_ends_in_its_sum_but_the_one_that_is_wrong_on_purpose(frame: frames.Frame) -> None:
    """E6581657 4.1.2."""
    assert (sum8(frame.data[:-1]) == frame.data[-1]) is (frame.hex != WRONG_ON_PURPOSE)


def test_the_printed_sum_of_a_text() -> None:
    """E6581657 4.1.1 works it out: 160H, of which 60 is sent."""
    assert sum8(b"(R0000&") == 0x60
