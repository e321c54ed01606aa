"""Decides from its STATE messages whether the primary host is online (Sparkplug 3.0, 5.3 and 6.5). Pure.

Online is no sign of life of a controller, since the broker keeps that message. Offline counts at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal

from gateway.mqtt import exact
from gateway.mqtt.exact import NotExact
from gateway.sparkplug import topics


@dataclass(frozen=True, slots=True)
class State:
    """What a host application says of itself; `timestamp` is in milliseconds of UTC since 1970."""

    is_online: bool
    timestamp: Decimal


def read(payload: bytes) -> State:
    """Read a STATE message; NotExact says what would be right."""
    document = exact.document(payload)
    if not isinstance(document, dict):
        raise NotExact('a JSON object is wanted: {"online": true, "timestamp": 1772366400250}')
    timestamp = document.get("timestamp")
    if not isinstance(timestamp, Decimal):
        raise NotExact(f"timestamp {exact.shown(timestamp)}: milliseconds since 1970 are wanted")
    return State(exact.boolean(document.get("online"), "online"), timestamp)


@dataclass(slots=True)
class PrimaryHost:
    """The one host application that edge nodes wait for.

    `is_online` is None while it is not known, as it is after each connect. A message that is older than the newest
    one is of a session of the host that has ended already, and changes nothing.
    """

    name: str
    is_online: bool | None = None
    _newest: Decimal | None = None

    @property
    def topic(self) -> str:
        """Return where it says whether it is online."""
        return topics.state(self.name)

    def forget(self) -> None:
        """Take that the connection is new: the host may have gone meanwhile. The newest time stays known."""
        self.is_online = None

    def hear(self, state: State) -> bool:
        """Take what it says; False where that is old."""
        if self._newest is not None and state.timestamp < self._newest:
            return False
        self._newest = state.timestamp
        self.is_online = state.is_online
        return True
