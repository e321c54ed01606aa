"""The frames of a line as a capture file that Wireshark reads: each one in a UDP packet, so that its way is known."""

from __future__ import annotations

import struct
from pathlib import Path

from gateway.errors import GatewayError
from gateway.sim.frames import STARTS, protocol_of
from gateway.sim.journal import Entry, Way
from gateway.sim.options import MODBUS_RTU, TOSHIBA
from gateway.trace import packets

MAGIC, VERSION = 0xA1B2C3D4, (2, 4)  # pcap, times in microseconds
LONGEST = 65_535  # bytes of a packet
LONGEST_FRAME = 4096  # bytes of a frame that are kept: more is no frame of these drives
LINKTYPE_IPV4 = 228
MASTER, LINE = packets.address(packets.MASTER), packets.address(packets.MASTER + 1)  # as the gateway's captures
PORTS = {MODBUS_RTU: packets.MODBUS_PORT, TOSHIBA: packets.TOSHIBA_PORT}  # of the line
UDP, TIME_TO_LIVE, VERSION_AND_LENGTH = 17, 64, 0x45


def header() -> bytes:
    """Return what a capture file begins with."""
    return struct.pack("<IHHiIII", MAGIC, *VERSION, 0, 0, LONGEST, LINKTYPE_IPV4)


def protocol(entry: Entry, before: int) -> int:
    """Return the protocol (F829) of a frame; a broken one is of the frame before it, unless it begins a request."""
    if (own := protocol_of(entry.data)) is not None:
        return own
    return TOSHIBA if entry.way is Way.REQUEST and entry.data.startswith(STARTS) else before


def record(entry: Entry, opened: float, spoken: int) -> bytes:
    """Return the record of a frame of that protocol, at the time of its end, in seconds since the line was opened."""
    data, line_port = entry.data[:LONGEST_FRAME], PORTS[spoken]
    if entry.way is Way.REQUEST:
        packet = _packet(MASTER, packets.MASTER_PORT, LINE, line_port, data)
    else:
        packet = _packet(LINE, line_port, MASTER, packets.MASTER_PORT, data)
    whole, microseconds = divmod(round((entry.end - opened) * 1e6), 1_000_000)
    return struct.pack("<IIII", whole, microseconds, len(packet), len(packet)) + packet


def _packet(source: bytes, source_port: int, target: bytes, target_port: int, data: bytes) -> bytes:
    datagram = struct.pack(">HHHH", source_port, target_port, 8 + len(data), 0) + data
    head = struct.pack(">BBHHHBBH", VERSION_AND_LENGTH, 0, 20 + len(datagram), 0, 0, TIME_TO_LIVE, UDP, 0)
    return head + source + target + datagram


class Capture:
    """A capture file that is being written, of requests and of what the master hears.

    `spoken` is the protocol (F829) of a frame that is broken before any whole one has come.
    """

    def __init__(self, path: Path, opened: float, spoken: int = MODBUS_RTU) -> None:
        self._opened = opened
        self._spoken = spoken
        self._file = path.open("wb", buffering=0)  # each frame is there at once
        self._file.write(header())

    def write(self, entry: Entry) -> None:
        """Write an entry of the journal, where it is a frame on the line."""
        if entry.way in (Way.REQUEST, Way.HEARD) and entry.data:
            self._spoken = protocol(entry, self._spoken)
            try:
                self._file.write(record(entry, self._opened, self._spoken))
            except OSError as error:
                raise GatewayError(f"the capture cannot be written: {error}") from error

    def close(self) -> None:
        """End the file."""
        self._file.close()
