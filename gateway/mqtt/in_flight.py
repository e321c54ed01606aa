"""Messages of QoS 1 under way: what identifies each, how many may be, and which of them the broker has. Pure.

A message that finds no place waits behind the others. Nothing is ever sent again: a session ends with its connection.
Packet identifiers are given in turn, so that the number of a message says its identifier, and the other way round.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

IN_FLIGHT = 20  # messages of QoS 1 and 2 under way to the broker; Mosquitto takes no more as installed
FIRST_ID = 65_001  # of the packet identifiers of these messages; those below are for all else that has one
LAST_ID = 65_535  # MQTT 5 2.2.1
IDS = LAST_ID - FIRST_ID + 1
WRITTEN = tuple(number.to_bytes(2, "big") for number in range(FIRST_ID, LAST_ID + 1))


class InFlight:
    """The messages of QoS 1 of one connection, counted in the order in which they were handed over."""

    def __init__(self) -> None:
        self.handed = 0
        self.there = 0  # of which the broker has acknowledged so many, the first ones
        self._most = IN_FLIGHT
        self._sent = 0
        self._queued: deque[tuple[bytes, bytes]] = deque()
        self._early: set[int] = set()  # acknowledged before one that was sent before them

    @property
    def open(self) -> int:
        """Return how many messages are not known to be there."""
        return self.handed - self.there

    @property
    def queued(self) -> int:
        """Return how many messages wait until others are there."""
        return self.handed - self._sent

    def limit(self, receive_maximum: int) -> None:
        """Take how many messages the broker takes at a time (MQTT 5 3.2.2.3.3)."""
        self._most = min(IN_FLIGHT, receive_maximum)

    def add(self, before: bytes, behind: bytes) -> None:
        """Take a packet in two pieces, between which its identifier goes."""
        self._queued.append((before, behind))
        self.handed += 1

    def release(self) -> list[bytes]:
        """Return the pieces of what may be sent now: three a message."""
        pieces: list[bytes] = []
        while self._queued and self._sent - self.there < self._most:
            before, behind = self._queued.popleft()
            pieces += (before, WRITTEN[self._sent % IDS], behind)
            self._sent += 1
        return pieces

    def acknowledge(self, packet_id: int) -> bool:
        """Take that the broker has a message; False where no message under way has that identifier."""
        if packet_id < FIRST_ID:
            return False
        behind_first = (packet_id - FIRST_ID - self.there) % IDS
        if behind_first >= self._sent - self.there:
            return False
        self._early.add(self.there + behind_first)
        while self.there in self._early:
            self._early.remove(self.there)
            self.there += 1
        return True

    def receipt(self) -> Callable[[], bool]:
        """Return what says of the last message whether it is there, and all before it."""
        number = self.handed
        return lambda: self.there >= number
