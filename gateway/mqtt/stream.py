"""Cuts the bytes that a broker sends into packets. Pure."""

from __future__ import annotations

LENGTH_AT = 1  # behind the type of a packet stands its remaining length (MQTT 5 2.1.1)
LONGEST_LENGTH = 4  # bytes (MQTT 5 1.5.5)
MORE = 0x80  # another byte of the length follows


class TooLarge(Exception):
    """The broker sends a packet that nobody here will collect; `size` is its remaining length."""

    def __init__(self, size: int) -> None:
        super().__init__(size)
        self.size = size


class Stream:
    """What came and was not taken yet: less than a packet of the largest size, and what was fed last."""

    def __init__(self, largest: int) -> None:
        self._largest = largest
        self._buffer = bytearray()
        self._at = 0

    def feed(self, received: bytes) -> None:
        """Take bytes as they come."""
        del self._buffer[: self._at]
        self._at = 0
        self._buffer += received

    def next(self) -> bytes | None:
        """Return the next whole packet; None while bytes of it are missing; TooLarge as soon as that is known.

        Of a packet whose length is none, so much is returned as shows it.
        """
        buffer, at = self._buffer, self._at
        if len(buffer) < at + 2:
            return None
        size, behind = buffer[at + LENGTH_AT], at + 2
        if size & MORE:
            found = self._long_size()
            if found is None:
                return None
            size, behind = found
        if size > self._largest:
            raise TooLarge(size)
        end = behind + size
        if len(buffer) < end:
            return None
        self._at = end
        return bytes(buffer[at:end])

    def _long_size(self) -> tuple[int, int] | None:
        """Return a remaining length of several bytes, and where what it counts starts; None: not whole yet."""
        start, size = self._at + LENGTH_AT, 0
        for place, digit in enumerate(self._buffer[start : start + LONGEST_LENGTH]):
            size |= (digit & ~MORE) << 7 * place
            if not digit & MORE:
                return size, start + place + 1
        shown = start + LONGEST_LENGTH + 1
        return (0, shown) if len(self._buffer) >= shown else None
