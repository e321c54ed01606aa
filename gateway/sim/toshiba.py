"""What both modes of the TOSHIBA protocol have in common: error codes, and letters that tell of a trip."""

from __future__ import annotations

from gateway.sim.memory import Denial

CODES = {Denial.UNABLE: 0, Denial.RANGE: 1, Denial.NUMBER: 2, Denial.COMMAND: 3, Denial.CHECKSUM: 4}  # 4.3

READ, WRITE_STORED, WRITE_RAM, ERROR = b"R", b"W", b"P", b"N"
LOWER_CASE = 0x20  # added to the letter of an answer while the drive is tripped (4.1.1, 4.1.2)


def letter(command: bytes, *, is_tripped: bool) -> bytes:
    """Return the letter of an answer."""
    return bytes([command[0] | LOWER_CASE]) if is_tripped else command


def checksum(data: bytes) -> int:
    """Return the last two digits of the sum of the characters."""
    return sum(data) & 0xFF
