"""The bridge to an MQTT broker: keeps a connection, and carries what the publisher sends and the listener hears."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
from collections.abc import Sequence

from gateway.clock import Clock
from gateway.config import MqttSection
from gateway.control.command import Result
from gateway.control.door import Door
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.mqtt import access, client, outcome
from gateway.mqtt.backoff import Backoff
from gateway.mqtt.connection import LEAVE_LIMIT, BrokerAway, Connection, close
from gateway.mqtt.events import Event, Events, of_result
from gateway.mqtt.listener import FORGET, Listener
from gateway.mqtt.message import Message
from gateway.mqtt.publisher import Publisher
from gateway.mqtt.reception import Ears

log = logging.getLogger("gateway.mqtt")

TEND_EVERY = 1.0  # seconds between looks at the keep-alive
STEPS = 4  # owed values sent at a stretch: some 0.2 ms, so that a line's timing does not suffer
HANDED_OVER = 2  # commands handed to the door at a stretch, for the same reason


class Bridge:
    """Publishes the image to one broker, from `run` until it is cancelled.

    While the broker is away nothing is kept for it: after each connect the whole image is published as it is then.
    """

    def __init__(
        self,
        section: MqttSection,
        gateway: str,
        image: Image,
        stats: MqttStats,
        clock: Clock,
        chance: random.Random | None = None,
        door: Door | None = None,
    ) -> None:
        access.read(section)  # what is missing or wrong now is better known before anything starts
        self._section = section
        self._gateway = gateway
        self._introduced = client.introduction(section, gateway)
        self._stats = stats
        self._clock = clock
        self._backoff = Backoff(section.reconnect_after, section.reconnect_at_most, chance or random.SystemRandom())
        self._publisher = Publisher(section, gateway, image, stats, door.controls if door is not None else {})
        self._events = Events(image)
        self._connection: Connection | None = None
        self._in_flight = client.IN_FLIGHT
        self._told = ""
        self._listener: Listener | None = None
        image.subscribe(self._on_change)
        if door is not None and door.controls:
            self._listener = Listener(section, gateway, door, stats, clock)
            door.on_event(self._on_event)
            door.on_result(self._on_result)

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
        made = await client.connect(self._section, self._introduced, self._in_flight)
        connection = None
        try:
            connection = Connection(made, self._section, self._stats)
            await connection.accepted()
            self._respect(connection.receive_maximum)
            self._begin(connection)
            await self._serve(connection)
        except asyncio.CancelledError:
            if connection is not None and connection is self._connection:
                await self._leave(connection)
            raise
        finally:
            self._connection, self._stats.is_connected = None, False
            self._stats.waiting = 0
            if self._listener is not None:
                self._listener.end()
            if connection is None:
                close(made.client)
            else:
                connection.abort()

    def _respect(self, receive_maximum: int) -> None:
        """See that no more is under way than the broker takes; paho wants to know that before it connects."""
        if receive_maximum < self._in_flight:
            self._in_flight = receive_maximum
            raise BrokerAway(f"the broker takes {receive_maximum} messages at a time: connecting again by that rule")

    def _begin(self, connection: Connection) -> None:
        log.info("connected to %s", self._section.url)
        self._told = ""
        self._stats.is_connected = True
        self._stats.connects += 1
        self._publisher.owe_everything()
        self._connection = connection
        listener, discovery, version = self._listener, self._publisher.discovery, self._section.version
        subscriptions = []
        if listener is not None:
            listener.begin(connection)
            subscriptions += client.subscriptions(listener.filters, version)
        if discovery is not None:
            subscriptions += client.subscriptions(discovery.filters, version, wants_kept=True)
        if subscriptions:
            connection.listen(subscriptions, Ears(self._hear, self._hand_over))

    def _hear(self, message: Message) -> None:
        """Hand a message to whom it is for."""
        discovery = self._publisher.discovery
        if discovery is not None and discovery.takes(message.topic):
            self._publisher.hear(message, self._clock.now())
            if self._connection is not None and self._publisher.is_owing:
                self._connection.wake()
        elif self._listener is not None:
            self._listener.hear(message)

    def _hand_over(self) -> None:
        """Hand on the first of the commands that came; the rest is the turn of `_serve`."""
        if self._listener is not None and self._listener.hand_over(HANDED_OVER) and self._connection is not None:
            self._connection.wake()

    def _on_event(self, drive: str, _event: str, _reason: str) -> None:
        """Have it published who may command now, when whoever tells of it has come to an end."""
        self._publisher.owe_standing(drive)
        if self._connection is not None:
            self._connection.wake()

    def _on_result(self, result: Result) -> None:
        event = of_result(result)
        if event is not None:
            self._tell_events([event])

    def _tell_events(self, events: Sequence[Event]) -> None:
        """Publish what happened to a drive; where that cannot be now it is counted, and not kept."""
        for event in events:
            topic = f"{self._section.base}/{self._gateway}/{event.drive}/{outcome.EVENT}"
            text = outcome.event(event.kind, event.reason, self._clock.wall(), event.more)
            connection = self._connection
            if connection is None or not connection.say(topic, text, expiry=FORGET, is_event=True):
                self._stats.untold += 1

    async def _serve(self, connection: Connection) -> None:
        """Send what is owed, a little at a time, and keep the connection alive until it is lost."""
        tend_at = self._clock.now() + TEND_EVERY
        enough = connection.capacity // 2
        while connection.lost is None:
            now = self._clock.now()
            if now >= tend_at:
                tend_at = now + TEND_EVERY
                connection.tend()
                self._publisher.look(now)
                self._tell_events(self._events.look(now))
            are_waiting = self._listener is not None and self._listener.hand_over(HANDED_OVER)
            has_room = connection.room >= enough
            if self._publisher.is_owing and has_room:
                self._publisher.settle(connection, now, STEPS)
                connection.flush()
                await asyncio.sleep(0)
            elif are_waiting:
                await asyncio.sleep(0)
            else:
                await connection.wait(TEND_EVERY, room=enough if self._publisher.is_owing else 0)
        raise BrokerAway(f"connection lost: {connection.lost}")

    def _on_change(self, image: DriveImage, names: Sequence[str]) -> None:
        """Publish what is news, before the answer's call chain ends."""
        connection, now = self._connection, self._clock.now()
        events = self._events.notice(image, names, now)
        if connection is None:
            self._tell_events(events)
            return
        try:
            self._publisher.tell(connection, image, names, now)
            self._tell_events(events)
            connection.flush()
        except Exception as error:
            connection.fail(error)
        if self._publisher.is_owing:
            connection.wake()

    async def _leave(self, connection: Connection) -> None:
        """Say that the gateway goes, and disconnect; in bounded time, else the will says it."""
        self._connection = None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LEAVE_LIMIT):
                self._publisher.leave(connection, self._clock.now())
                connection.flush()
                await connection.leave()
