"""Finds out how many of the messages of a connection the broker has for certain, also at QoS 0.

What is published at QoS 0 is never acknowledged, but a broker reads a connection in order: when it answers a PINGREQ,
it has read all that was written before. Above QoS 0 the acknowledgements are counted (`Outgoing.count`).
"""

from __future__ import annotations

from typing import Any

from gateway.mqtt.outgoing import Outgoing

BETWEEN = 0.2  # seconds from one question to the next


class Receipts:
    """The pings of one connection that prove what came before them."""

    def __init__(self, client: Any, outgoing: Outgoing) -> None:
        self._client = client
        self._outgoing = outgoing
        self._mark: int | None = None  # messages handed over when it was asked; None: nothing is asked
        self._ask_at = float("-inf")

    def ask(self, now: float) -> None:
        """Ask whether the broker has all that was handed over; a flush writes the question."""
        outgoing = self._outgoing
        if not outgoing.needs_ping or outgoing.there >= outgoing.handed or now < self._ask_at:
            return
        if self._mark is None and not self._client._ping_t:  # one of paho's own may be under way
            self._mark, self._ask_at = outgoing.handed, now + BETWEEN
            self._client._send_pingreq()

    def look(self) -> bool:
        """Take an answer that has come; say whether one has."""
        if self._mark is None or self._client._ping_t:
            return False
        self._outgoing.there = self._mark
        self._mark = None
        return True
