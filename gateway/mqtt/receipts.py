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
        self._has_to_wait = False  # for the answer to a ping of paho's own, which keeps the connection alive

    def ask(self, now: float) -> None:
        """Ask whether the broker has all that was handed over; a flush writes the question."""
        outgoing, client = self._outgoing, self._client
        if not outgoing.needs_ping or outgoing.there >= outgoing.handed or self._mark is not None:
            return
        if client._ping_t:
            self._has_to_wait = True
        elif now >= self._ask_at:
            outgoing.push()
            client._send_pingreq()
            self._mark = outgoing.handed if client._ping_t else None
            self._ask_at = now + BETWEEN

    def look(self) -> bool:
        """Take an answer that has come; say whether one has."""
        if self._client._ping_t or not (self._has_to_wait or self._mark is not None):
            return False
        self._has_to_wait = False
        if self._mark is not None:
            self._outgoing.there = self._mark
            self._mark = None
        return True
