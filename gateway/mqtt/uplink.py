"""Keeps a connection to one broker: connects, serves, connects again; what is said and heard is its children's."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from gateway.clock import Clock
from gateway.config import MqttSection, SparkplugSection
from gateway.metrics import MqttStats
from gateway.mqtt import access, client
from gateway.mqtt.backoff import Backoff
from gateway.mqtt.client import Introduction
from gateway.mqtt.connection import LEAVE_LIMIT, Connection
from gateway.mqtt.made import BrokerAway, close
from gateway.mqtt.message import Message
from gateway.mqtt.missed import Missed
from gateway.mqtt.outgoing import Outgoing
from gateway.mqtt.reception import Ears

TEND_EVERY = 1.0  # seconds between looks at the keep-alive
UNSURE = 0.05  # seconds between questions whether the broker has all, before it is left
HANDED_OVER = 2  # commands handed to the door at a stretch, so that a line's timing does not suffer


class Uplink(ABC):
    """One broker, from `run` until it is cancelled. Nothing here waits for another broker, or for a line.

    While the broker is away `_connection` is None; what is to be told then goes to `_missed`, where its children have
    made one.
    """

    def __init__(
        self,
        section: MqttSection | SparkplugSection,
        stats: MqttStats,
        clock: Clock,
        chance: random.Random | None,
    ) -> None:
        access.read(section)  # what is missing or wrong now is better known before anything starts
        self._terms = section
        self._stats = stats
        self._clock = clock
        self._log = logging.getLogger(section.channel)
        self._backoff = Backoff(section.reconnect_after, section.reconnect_at_most, chance or random.SystemRandom())
        self._connection: Connection | None = None
        self._told = ""
        self._missed: Missed[Any] | None = None  # None: nothing is kept for this broker while it is away

    # ---- what its children say and hear

    @abstractmethod
    def _introduction(self) -> Introduction:
        """Return as what the next connection is made."""

    def _knocked(self) -> None:  # noqa: B027 - most need not know
        """Take that a CONNECT was sent, accepted or not."""

    @abstractmethod
    def _begin(self, connection: Connection) -> None:
        """Subscribe, and owe all that a broker must be told after a connect."""

    @abstractmethod
    def _end(self) -> None:
        """Take that there is no connection any more, or that none came about."""

    @abstractmethod
    def _hear(self, message: Message) -> None:
        """Take a message."""

    @abstractmethod
    def _hand_over(self, most: int) -> bool:
        """Hand on that many of the commands that came; say whether more wait."""

    @abstractmethod
    def _look(self, now: float) -> None:
        """Look for what has changed without a word, and for what need not wait any longer."""

    @abstractmethod
    def _is_owing(self, now: float) -> bool:
        """Say whether the broker lacks anything that may be sent now."""

    @abstractmethod
    def _settle(self, wire: Outgoing, now: float) -> None:
        """Send a little of what is owed, so that no line need wait long."""

    def _post(self, _wire: Outgoing, _what: Any) -> Callable[[], bool] | None:
        """Send a message that was missed; see `Missed.send`."""
        return None

    def _may_post(self, _now: float) -> bool:
        """Say whether the broker is ready for what it has missed."""
        return True

    def _patience(self, _now: float) -> float:
        """Return for how many seconds at the most nothing need be looked at."""
        return TEND_EVERY

    def _farewell(self) -> str:
        """Return why this connection is to be left in order, "" where it is not."""
        return ""

    @abstractmethod
    def _say_farewell(self, wire: Outgoing) -> None:
        """Say that the gateway goes."""

    # ---- the connection

    async def run(self) -> None:
        """Connect, publish and connect again until cancelled; whatever else ends it is an error of ours."""
        while True:
            began = self._clock.now()
            try:
                await self._connect_once()
            except BrokerAway as error:
                self._tell_away(str(error))
            if self._clock.now() - began > self._terms.reconnect_at_most:
                self._backoff.reset()
            await asyncio.sleep(self._backoff.next())

    def _tell_away(self, reason: str) -> None:
        """Log why the broker is away, the same reason once only."""
        level = logging.DEBUG if reason == self._told else logging.WARNING
        self._told = reason
        self._log.log(level, "%s: %s; trying again", self._terms.label, reason)

    async def _connect_once(self) -> None:
        """Serve one connection to its end, which BrokerAway tells."""
        made = await client.connect(self._terms, self._introduction())
        self._knocked()
        connection = None
        try:
            connection = Connection(made, self._terms, self._stats)
            await connection.accepted()
            self._take_up(connection)
            await self._serve(connection)
        except asyncio.CancelledError:
            if connection is not None and connection is self._connection:
                await self._leave(connection)
            raise
        finally:
            self._connection, self._stats.is_connected = None, False
            self._stats.waiting = 0
            self._end()
            if self._missed is not None:
                self._missed.end()
            if connection is None:
                close(made.client)
            else:
                connection.abort()

    def _take_up(self, connection: Connection) -> None:
        self._log.info("connected to %s", self._terms.label)
        self._told = ""
        self._stats.is_connected = True
        self._stats.connects += 1
        self._connection = connection
        if self._missed is not None:
            self._missed.begin(connection.wake)
        self._begin(connection)

    @property
    def _ears(self) -> Ears:
        """Return who hears what comes."""
        return Ears(self._hear, self._pause)

    def _pause(self) -> None:
        """Hand on the first of the commands that came; the rest is the turn of `_serve`."""
        are_waiting = self._hand_over(HANDED_OVER)
        if are_waiting or self._is_owing(self._clock.now()):
            self._wake()

    async def _serve(self, connection: Connection) -> None:
        """Send what is owed, a little at a time, and keep the connection alive until it is lost or to be left."""
        tend_at = self._clock.now() + TEND_EVERY
        wire, enough = connection.outgoing, connection.outgoing.capacity // 2
        while connection.lost is None and not self._farewell():
            now = self._clock.now()
            if now >= tend_at:
                tend_at = now + TEND_EVERY
                connection.tend()
                self._look(now)
            self._settle_missed(connection, now)
            are_waiting = self._hand_over(HANDED_OVER)
            is_owing = self._is_owing(now)
            if is_owing and wire.room >= enough:
                self._settle(wire, now)
                connection.flush()
                await asyncio.sleep(0)
            elif are_waiting or self._has_posted(connection, now):
                await asyncio.sleep(0)
            else:
                await connection.wait(self._patience_with_missed(wire, now), room=enough if is_owing else 0)
        if connection.lost is None:
            reason = self._farewell()
            await self._leave(connection)
            raise BrokerAway(reason)
        raise BrokerAway(f"connection lost: {connection.lost}")

    # ---- what the broker misses

    def _mark(self, connection: Connection, *, was_sent: bool) -> int | None:
        """Return by which message what was just sent is known to be there; see `Unconfirmed.add`."""
        return connection.outgoing.handed if was_sent else None

    def _settle_missed(self, connection: Connection, now: float) -> None:
        """Find out what the broker has: that it cannot miss any more."""
        if self._missed is None:
            return
        self._missed.settle(connection.outgoing.there)
        if self._missed.is_unsure:
            connection.receipts.ask(now)
            connection.flush()

    def _has_posted(self, connection: Connection, now: float) -> bool:
        """Send a message that the broker has missed, where it is time for one and nothing live waits."""
        missed, wire = self._missed, connection.outgoing
        if missed is None or not self._may_post(now) or not missed.is_due(wire, now):
            return False
        missed.send(now, lambda what: self._post(wire, what))
        connection.flush()
        return True

    def _patience_with_missed(self, wire: Outgoing, now: float) -> float:
        patience = self._patience(now)
        if self._missed is None or not self._may_post(now):
            return patience
        return self._missed.patience(wire, now, patience)

    def _wake(self) -> None:
        """Have what is owed sent when whoever tells of it has come to an end."""
        if self._connection is not None:
            self._connection.wake()

    async def _leave(self, connection: Connection) -> None:
        """Say that the gateway goes, and disconnect; in bounded time, else the will says it."""
        self._connection = None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LEAVE_LIMIT):
                self._say_farewell(connection.outgoing)
                connection.flush()
                while self._missed is not None and self._missed.is_unsure and connection.lost is None:
                    self._settle_missed(connection, self._clock.now())
                    await connection.wait(UNSURE)
                await connection.leave()
