"""MODBUS-RTU frames over TCP, put into MODBUS-TCP's form and back: address, PDU and CRC without a header. Pure.

TCP keeps no gaps, so a frame ends where its function says. A stream that is out of step is not trusted any more: a
request over TCP is never garbled by the way, so its sender is at fault, or a serial line behind it.
"""

from __future__ import annotations

import struct

from gateway.modbus_tcp.requests import EXCHANGE, WRITE, WRITE_WORDS
from gateway.modbus_tcp.responder import ENCAPSULATED_INTERFACE, HEAD_END
from gateway.protocol.checksum import crc16

# MODBUS over Serial Line V1.02, 2.3 and 2.5.1: address, PDU, CRC with its low byte first.
SHORTEST = 4  # bytes: address, function, CRC
LONGEST = 256  # bytes
CRC_SIZE = 2
BROADCAST = 0
HEADER = struct.Struct(">HHH")
FIXED = {1: 8, 2: 8, 3: 8, 4: 8, 5: 8, WRITE: 8, 7: 4, 8: 8, 11: 4, 12: 4, 17: 4, 22: 10, 24: 6}
FIXED[ENCAPSULATED_INTERFACE] = 7  # with MEI type 14, the only one that is answered
COUNTED = {15: 6, WRITE_WORDS: 6, 20: 2, 21: 2, EXCHANGE: 10}  # where the count of the bytes that follow it stands


class _NoFrame(Exception):
    """What begins here is no request."""


class RtuFraming:
    """One client's stream of requests. `out_of_step` says why it is not understood any more, "" while it is."""

    def __init__(self) -> None:
        self.out_of_step = ""
        self._received = bytearray()

    @property
    def is_amid(self) -> bool:
        """Say whether a frame has begun and not ended."""
        return bool(self._received)

    def receive(self, data: bytes) -> bytes:
        """Return the requests that are whole by now, in MODBUS-TCP's form; those to all drives are left out."""
        self._received += data
        requests = bytearray()
        try:
            while not self.out_of_step and (frame := self._next()) is not None:
                if frame[0] != BROADCAST:
                    requests += HEADER.pack(0, 0, len(frame)) + frame
        except _NoFrame as reason:
            self.out_of_step = str(reason)
            self._received.clear()
        return bytes(requests)

    def _next(self) -> bytes | None:
        """Return the next frame without its CRC, None while bytes are missing."""
        size = self._size()
        if size is None or len(self._received) < size:
            return None
        frame, crc = bytes(self._received[: size - CRC_SIZE]), self._received[size - CRC_SIZE : size]
        if crc16(frame) != crc:
            raise _NoFrame(f"the CRC of a frame of function {frame[1]:02X}H is wrong")
        del self._received[:size]
        return frame

    def _size(self) -> int | None:
        """Return the size of the frame that begins here, None while that cannot be told."""
        received = self._received
        if len(received) < SHORTEST:
            return None
        function = received[1]
        if function in FIXED:
            return FIXED[function]
        if function not in COUNTED:
            return self._size_by_crc()
        place = COUNTED[function]
        if len(received) <= place:
            return None
        size = place + 1 + received[place] + CRC_SIZE
        if size > LONGEST:
            raise _NoFrame(f"a frame of {size} bytes")
        return size

    def _size_by_crc(self) -> int | None:
        """Return where a frame of an unknown function ends: where its CRC fits first."""
        received = self._received
        for end in range(SHORTEST, min(len(received), LONGEST) + 1):
            if crc16(received[: end - CRC_SIZE]) == received[end - CRC_SIZE : end]:
                return end
        if len(received) >= LONGEST:
            raise _NoFrame(f"no frame of function {received[1]:02X}H ends within {LONGEST} bytes")
        return None


def framed(answers: bytes) -> bytes:
    """Return answers in MODBUS-RTU's form: each without its header, with its CRC."""
    frames = bytearray()
    at = 0
    while at < len(answers):
        _, _, length = HEADER.unpack_from(answers, at)
        at += HEAD_END
        frame = answers[at : at + length]
        frames += frame + crc16(frame)
        at += length
    return bytes(frames)
