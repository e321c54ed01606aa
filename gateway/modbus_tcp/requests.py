"""Requests that write: function codes 06H, 10H and 17H, read from their bytes and checked whole. Pure."""

from __future__ import annotations

import struct
from dataclasses import dataclass

WRITE = 0x06
WRITE_WORDS = 0x10
EXCHANGE = 0x17
WRITING = frozenset((WRITE, WRITE_WORDS, EXCHANGE))
MOST_WRITTEN = 123  # registers, MODBUS Application Protocol V1.1b3 6.12
MOST_EXCHANGED = 121  # registers that 17H writes, 6.17
MOST_READ = 125


class Malformed(Exception):
    """Lengths or counts that contradict each other or the standard: exception 03."""


@dataclass(frozen=True, slots=True)
class WriteRequest:
    """What a write asks for: words from an address on; `read` are start and count of what 17H reads behind it."""

    function: int
    address: int
    words: tuple[int, ...]
    read: tuple[int, int] | None = None

    def answer(self, read: bytes = b"") -> bytes:
        """Return the PDU of the answer; `read` are the words that 17H reads, as they stand on the wire."""
        if self.function == EXCHANGE:
            return bytes((EXCHANGE, len(read))) + read
        value = self.words[0] if self.function == WRITE else len(self.words)
        return struct.pack(">BHH", self.function, self.address, value)


def parse(pdu: bytes) -> WriteRequest:
    """Read a request PDU that writes; Malformed where it is not exact."""
    try:
        return _READERS[pdu[0]](pdu[1:])
    except struct.error:
        raise Malformed from None


def _write(body: bytes) -> WriteRequest:
    address, word = struct.unpack(">HH", body)
    return WriteRequest(WRITE, address, (word,))


def _write_words(body: bytes) -> WriteRequest:
    address, count, size = struct.unpack_from(">HHB", body)
    return WriteRequest(WRITE_WORDS, address, _words(body[5:], count, size, MOST_WRITTEN))


def _exchange(body: bytes) -> WriteRequest:
    start, wanted, address, count, size = struct.unpack_from(">HHHHB", body)
    words = _words(body[9:], count, size, MOST_EXCHANGED)
    if not 1 <= wanted <= MOST_READ:
        raise Malformed
    return WriteRequest(EXCHANGE, address, words, (start, wanted))


_READERS = {WRITE: _write, WRITE_WORDS: _write_words, EXCHANGE: _exchange}


def _words(data: bytes, count: int, size: int, most: int) -> tuple[int, ...]:
    if not 1 <= count <= most or size != 2 * count or len(data) != size:
        raise Malformed
    return struct.unpack(f">{count}H", data)
