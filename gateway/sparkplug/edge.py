"""The connection of the edge node to its broker: keeps it, and carries what the node sends and the listener hears."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
from collections.abc import Sequence

from gateway.clock import Clock
from gateway.config import SparkplugSection
from gateway.control.command import Result
from gateway.control.door import Door
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.mqtt import access, client
from gateway.mqtt.backoff import Backoff
from gateway.mqtt.client import Introduction
from gateway.mqtt.connection import LEAVE_LIMIT, BrokerAway, Connection, close
from gateway.mqtt.reception import Ears
from gateway.sparkplug.device import Moment
from gateway.sparkplug.listener import Listener
from gateway.sparkplug.node import Node
from gateway.sparkplug.session import Happening, Phase

log = logging.getLogger("gateway.sparkplug")

TEND_EVERY = 1.0  # seconds between looks at the keep-alive
STEPS = 1  # messages sent at a stretch: a birth takes 0.3 ms, and a line's timing must not suffer
HANDED_OVER = 2  # commands handed to the door at a stretch, for the same reason


class EdgeNode:
    """Publishes the image as Sparkplug B to one broker, from `run` until it is cancelled."""

    def __init__(
        self,
        section: SparkplugSection,
        gateway: str,
        image: Image,
        stats: MqttStats,
        clock: Clock,
        chance: random.Random | None = None,
        door: Door | None = None,
    ) -> None:
        access.read(section)  # what is missing or wrong now is better known before anything starts
        self._section = section
        self._stats = stats
        self._clock = clock
        self._backoff = Backoff(section.reconnect_after, section.reconnect_at_most, chance or random.SystemRandom())
        controls = door.controls if door is not None else {}
        self.node = Node(section, gateway, image, stats, controls, door.lines if door is not None else {})
        self._listener = Listener(section, self.node, stats, clock, door)
        self._connection: Connection | None = None
        self._told = ""
        image.subscribe(self._on_change)
        if controls and door is not None:
            door.on_result(self._on_result)
            door.on_event(self._on_event)

    async def run(self) -> None:
        """Connect, publish and connect again until cancelled; whatever else ends it is an error of ours."""
        while True:
            began = self._clock.now()
            try:
                await self._connect_once()
            except BrokerAway as error:
                self._tell_away(str(error))
            if self._clock.now() - began > self._section.reconnect_at_most:
                self._backoff.reset()
            await asyncio.sleep(self._backoff.next())

    def _tell_away(self, reason: str) -> None:
        """Log why the broker is away, the same reason once only."""
        level = logging.DEBUG if reason == self._told else logging.WARNING
        self._told = reason
        log.log(level, "%s: %s; trying again", self._section.url, reason)

    async def _connect_once(self) -> None:
        """Serve one connection to its end, which BrokerAway tells."""
        made = await client.connect(self._section, self._introduction(), client.IN_FLIGHT)
        self.node.session.connecting()
        connection = None
        try:
            connection = Connection(made, self._section, self._stats)
            await connection.accepted()
            self._begin(connection)
            await self._serve(connection)
        except asyncio.CancelledError:
            if connection is not None and connection is self._connection:
                await self._leave(connection)
            raise
        finally:
            self._connection, self._stats.is_connected = None, False
            self._stats.waiting = 0
            self.node.take(Happening.LOST)
            self._listener.end()
            if connection is None:
                close(made.client)
            else:
                connection.abort()

    def _introduction(self) -> Introduction:
        """Return as what the edge node connects: its will is the NDEATH of this very connection."""
        topics = self.node.topics
        name = self._section.client_id or f"sparkplug-{topics.group}-{topics.node}".replace(" ", "-")
        will = self.node.will(self._ms())
        return Introduction(name, topics.of_node("NDEATH"), will, 1, retain=False, wills_at_leave=True)

    def _begin(self, connection: Connection) -> None:
        log.info("connected to %s", self._section.url)
        self._told = ""
        self._stats.is_connected = True
        self._stats.connects += 1
        self._connection = connection
        self.node.take(Happening.CONNECTED)
        listener, version = self._listener, self._section.version
        subscriptions = client.subscriptions(listener.command_topics, version)
        if listener.state_topic is not None:
            subscriptions.append(client.subscription_to_state(listener.state_topic, version))
        connection.listen(subscriptions, Ears(listener.hear, self._hand_over))
        listener.begin()

    def _hand_over(self) -> None:
        """Hand on the first of the commands that came; the rest is the turn of `_serve`."""
        self._listener.hand_over(HANDED_OVER)
        if self._connection is not None:
            self._connection.wake()

    async def _serve(self, connection: Connection) -> None:
        """Send what is owed, a little at a time, and keep the connection alive until it is lost or to be left."""
        tend_at = self._clock.now() + TEND_EVERY
        enough = connection.capacity // 2
        while connection.lost is None and self.node.session.phase is not Phase.LEAVING:
            now = self._clock.now()
            if now >= tend_at:
                tend_at = now + TEND_EVERY
                connection.tend()
                self.node.look()
            are_waiting = self._listener.hand_over(HANDED_OVER)
            is_owing = self.node.is_owing(now)
            if is_owing and connection.room >= enough:
                self.node.settle(connection, self._moment(), STEPS)
                connection.flush()
                await asyncio.sleep(0)
            elif are_waiting:
                await asyncio.sleep(0)
            else:
                limit = min(TEND_EVERY, self.node.held_back(now) or TEND_EVERY)
                await connection.wait(limit, room=enough if is_owing else 0)
        if connection.lost is None:
            await self._leave(connection)
            raise BrokerAway(f"the primary host {self._section.primary_host} is offline")
        raise BrokerAway(f"connection lost: {connection.lost}")

    # ---- what is told to the node

    def _on_change(self, image: DriveImage, names: Sequence[str]) -> None:
        """Publish what is news, before the answer's call chain ends."""
        connection = self._connection
        if connection is None:
            return
        try:
            moment = self._moment()
            self.node.note_change(image, names, moment.now)
            self.node.settle_drive(connection, image.drive.name, moment)
            connection.flush()
        except Exception as error:
            connection.fail(error)
        if self.node.is_owing(self._clock.now()):
            connection.wake()

    def _on_result(self, result: Result) -> None:
        self.node.note_result(result, self._clock.wall())
        self._wake()

    def _on_event(self, drive: str, event: str, reason: str) -> None:
        self.node.note_event(drive, event, reason, self._clock.wall())
        self._wake()

    def _wake(self) -> None:
        """Have it published when whoever tells of it has come to an end."""
        if self._connection is not None:
            self._connection.wake()

    def _ms(self) -> int:
        return round(self._clock.wall() * 1000)

    def _moment(self) -> Moment:
        return Moment(self._clock.now(), self._ms())

    async def _leave(self, connection: Connection) -> None:
        """Say that the edge node goes, and disconnect; in bounded time, else the will says it."""
        self._connection = None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LEAVE_LIMIT):
                connection.carry(self.node.topics.of_node("NDEATH"), self.node.death(self._ms()))
                connection.flush()
                await connection.leave()
