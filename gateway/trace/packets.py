"""A frame of an RS485 line as a packet that Wireshark takes apart by itself: it names the dissector that it is for.

The form is Wireshark's "exported PDU" (epan/exported_pdu.h, tags as 16-bit code and length in network order). The
addresses tell one line from another and a request from an answer.
"""

from __future__ import annotations

import struct

DISSECTOR, COLUMN = 12, 33  # tags: name of the dissector, text of the column "Protocol"
SOURCE, TARGET = 20, 21  # tags: IPv4 addresses
PORT_TYPE, SOURCE_PORT, TARGET_PORT = 24, 25, 26
END = 0
UDP = 3  # of the port types
MASTER_PORT, MODBUS_PORT, TOSHIBA_PORT = 40_000, 502, 829  # 829: F829 chooses the protocol
DOCUMENTATION = (192, 0, 2)  # RFC 5737: a network for documentation
MASTER = 1
MOST_LINES = 254 - MASTER

MODBUS_RTU = "modbus-rtu"
NAMES = {
    MODBUS_RTU: "Modbus RTU",
    "toshiba-ascii": "TOSHIBA ASCII",
    "toshiba-binary": "TOSHIBA binary",
    "": "RS485",
}


def packet(place: int, protocol: str, data: bytes, *, is_request: bool, is_whole: bool = True) -> bytes:
    """Return the packet of a frame on the line with that place, from 0; a damaged frame is shown as bytes."""
    is_modbus = protocol == MODBUS_RTU
    dissector = "mbrtu" if is_modbus and is_whole else "data"
    master = (address(MASTER), MASTER_PORT)
    line = (address(MASTER + 1 + place % MOST_LINES), MODBUS_PORT if is_modbus else TOSHIBA_PORT)
    source, target = (master, line) if is_request else (line, master)
    return b"".join(
        (
            _tag(DISSECTOR, dissector.encode()),
            _tag(COLUMN, NAMES.get(protocol, protocol).encode()) if dissector == "data" else b"",
            _tag(SOURCE, source[0]),
            _tag(TARGET, target[0]),
            _tag(PORT_TYPE, struct.pack(">I", UDP)),
            _tag(SOURCE_PORT, struct.pack(">I", source[1])),
            _tag(TARGET_PORT, struct.pack(">I", target[1])),
            struct.pack(">HH", END, 0),
            data,
        )
    )


def address(host: int) -> bytes:
    """Return the IPv4 address of the gateway (MASTER), or of a line: the first has MASTER + 1."""
    return bytes((*DOCUMENTATION, host))


def _tag(code: int, value: bytes) -> bytes:
    filled = value + bytes(-len(value) % 4)
    return struct.pack(">HH", code, len(filled)) + filled
