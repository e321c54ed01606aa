"""The wire format of protocol buffers, as far as Sparkplug needs it: fields to bytes and back. Pure.

What comes from outside is read exactly or not at all: nothing beyond the end, no varint of more than 64 bits.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import lru_cache

from gateway.errors import GatewayError

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5  # wire types; groups (3, 4) are obsolete and refused
LARGEST_FIELD = (1 << 29) - 1  # number of a field
LARGEST_VARINT = (1 << 64) - 1
LONGEST_VARINT = 10  # bytes
KEPT = 4096  # whole numbers that are not written anew each time
SIZES = {FIXED64: 8, FIXED32: 4}

Field = tuple[int, int, int | bytes]  # number, wire type, value


class BadPayload(GatewayError):
    """Bytes that are no Sparkplug payload; the message says where they are wrong."""


@lru_cache(KEPT)
def varint(value: int) -> bytes:
    """Return a whole number from 0 to 2^64 - 1; tags, aliases, types and times come again and again."""
    if value < 0x80:
        return bytes((value,))
    written = bytearray()
    while value >= 0x80:
        written.append(value & 0x7F | 0x80)
        value >>= 7
    written.append(value)
    return bytes(written)


def whole(number: int, value: int) -> bytes:
    """Return a field with a whole number, or a boolean."""
    return varint(number << 3 | VARINT) + varint(value)


def double(number: int, value: float) -> bytes:
    """Return a field with a double."""
    return varint(number << 3 | FIXED64) + struct.pack("<d", value)


def single(number: int, value: float) -> bytes:
    """Return a field with a float of 32 bits."""
    return varint(number << 3 | FIXED32) + struct.pack("<f", value)


def block(number: int, value: bytes) -> bytes:
    """Return a field with bytes, or with another message."""
    return varint(number << 3 | LENGTH) + varint(len(value)) + value


def text(number: int, value: str) -> bytes:
    """Return a field with text."""
    return block(number, value.encode())


def fields(message: bytes) -> Iterator[Field]:
    """Yield the fields of a message in their order; BadPayload where the bytes are none."""
    at, end = 0, len(message)
    while at < end:
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        if not 0 < number <= LARGEST_FIELD:
            raise BadPayload(f"byte {at}: there is no field {number}")
        if kind == VARINT:
            value, at = _varint(message, at)
            yield number, kind, value
            continue
        if kind == LENGTH:
            size, at = _varint(message, at)
        elif kind in SIZES:
            size = SIZES[kind]
        else:
            raise BadPayload(f"byte {at}: wire type {kind} of field {number} is not known")
        if size > end - at:
            raise BadPayload(f"byte {at}: field {number} has {size} bytes, {end - at} are left")
        yield number, kind, message[at : at + size]
        at += size


def _varint(message: bytes, at: int) -> tuple[int, int]:
    """Return a whole number, and where the next byte is."""
    value = 0
    for place, byte in enumerate(message[at : at + LONGEST_VARINT]):
        value |= (byte & 0x7F) << 7 * place
        if byte < 0x80:
            if value > LARGEST_VARINT:
                break
            return value, at + place + 1
    raise BadPayload(f"byte {at}: no whole number of at most 64 bits")
