"""The blocks of a pcapng capture file (IETF draft-ietf-opsawg-pcapng), as bytes; a line is an interface."""

from __future__ import annotations

import struct
from collections.abc import Iterable

SECTION, INTERFACE, PACKET = 0x0A0D0D0A, 0x00000001, 0x00000006
BYTE_ORDER = 0x1A2B3C4D
LINKTYPE_WIRESHARK_UPPER_PDU = 252  # each packet names the dissector that it is for
LONGEST_PACKET = 65_535  # bytes
LONGEST_OPTION = 4096  # bytes of a text; the format allows 65,535
NANOSECONDS = 9  # if_tsresol: 10^-9
INBOUND, OUTBOUND = 1, 2  # epb_flags, bits 0 and 1
CRC_ERROR = 1 << 24  # epb_flags

END, COMMENT = 0, 1  # options of every block
APPLICATION = 4  # shb_userappl
NAME, RESOLUTION, DESCRIPTION = 2, 9, 3  # if_name, if_tsresol, if_description
FLAGS = 2  # epb_flags


def section(application: str, comment: str = "") -> bytes:
    """Return what a file begins with."""
    options = [(APPLICATION, application.encode())]
    if comment:
        options.insert(0, (COMMENT, comment.encode()))
    return _block(SECTION, struct.pack("<IHHq", BYTE_ORDER, 1, 0, -1) + _options(options))


def interface(name: str, description: str = "") -> bytes:
    """Return the block of one interface; packets name it by its place in the file, from 0."""
    options = [(NAME, name.encode()), (RESOLUTION, bytes([NANOSECONDS]))]
    if description:
        options.append((DESCRIPTION, description.encode()))
    head = struct.pack("<HHI", LINKTYPE_WIRESHARK_UPPER_PDU, 0, LONGEST_PACKET)
    return _block(INTERFACE, head + _options(options))


def packet(place: int, time: float, data: bytes, flags: int, comment: str = "") -> bytes:
    """Return the block of one packet of the interface at that place; `time` is UTC seconds since 1970."""
    data = data[:LONGEST_PACKET]
    stamp = round(time * 1e6) * 1000  # a double holds microseconds of today's dates, no more
    high, low = stamp >> 32, stamp & 0xFFFFFFFF
    options = [(FLAGS, struct.pack("<I", flags))]
    if comment:
        options.insert(0, (COMMENT, comment.encode()))
    head = struct.pack("<IIIII", place, high, low, len(data), len(data))
    return _block(PACKET, head + _padded(data) + _options(options))


def _block(kind: int, body: bytes) -> bytes:
    size = struct.pack("<I", 12 + len(body))
    return struct.pack("<I", kind) + size + body + size


def _options(options: Iterable[tuple[int, bytes]]) -> bytes:
    found = ((code, value[:LONGEST_OPTION]) for code, value in options)
    return b"".join(struct.pack("<HH", code, len(value)) + _padded(value) for code, value in found) + bytes(4)


def _padded(data: bytes) -> bytes:
    """Fill up to 32 bits."""
    return data + bytes(-len(data) % 4)
