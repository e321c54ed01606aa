"""The fields of a request, checked: what does not fit into them is no request of the protocol."""

from __future__ import annotations

from gateway.protocol.codec import NoSuchForm
from gateway.protocol.pdu import Group

LAST_WORD = 0xFFFF
ADDRESS = "communication number"
WORD = "word"


def packed(what: str, *values: int) -> bytes:
    """Return words, the high byte first; NoSuchForm where one has more than 16 bits."""
    for value in values:
        if not 0 <= value <= LAST_WORD:
            raise NoSuchForm(f"a {what} must be 0 to 65535 (FFFFH), not {value}")
    return b"".join(value.to_bytes(2, "big") for value in values)


def unpacked(data: bytes) -> tuple[int, ...]:
    """Return the words of an answer."""
    return tuple(int.from_bytes(data[at : at + 2], "big") for at in range(0, len(data), 2))


def check(protocol: str, what: str, value: int, allowed: range) -> None:
    """Raise NoSuchForm where a number or a count is not one that the protocol has."""
    if value not in allowed:
        right = f"{allowed.start} to {allowed.stop - 1}" if len(allowed) > 1 else str(allowed.start)
        raise NoSuchForm(f"{protocol}: the {what} must be {right}, not {value}")


def check_group(protocol: str, group: Group, has_digit_groups: bool) -> None:
    """Raise NoSuchForm for a group that the protocol cannot address."""
    digits = [digit for digit in (group.tens, group.ones) if digit is not None]
    if digits and not has_digit_groups:
        raise NoSuchForm(f"{protocol}: group {group}: there is only the group of all drives")
    if len(digits) > 1 or any(digit not in range(10) for digit in digits):
        raise NoSuchForm(f"{protocol}: group {group}: a group is **, *n or n* with n from 0 to 9")
