"""Checksums of the drives' protocols."""

from __future__ import annotations

CRC_INITIAL = 0xFFFF
CRC_POLYNOMIAL = 0xA001  # right shift (E6581657 5.2)


def _crc_of_byte(byte: int) -> int:
    crc = byte
    for _ in range(8):
        crc = crc >> 1 ^ (CRC_POLYNOMIAL if crc & 1 else 0)
    return crc


_CRC_TABLE = tuple(_crc_of_byte(byte) for byte in range(256))


def crc16(frame: bytes | bytearray | memoryview) -> bytes:
    """Return the two CRC bytes of a MODBUS-RTU frame, low byte first (E6581657 5.2)."""
    crc = CRC_INITIAL
    for byte in frame:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc.to_bytes(2, "little")


def sum8(frame: bytes | bytearray | memoryview) -> int:
    """Return the lowest byte of the sum of a TOSHIBA frame's bytes (E6581657 4.1.1, 4.1.2)."""
    return sum(frame) & 0xFF
