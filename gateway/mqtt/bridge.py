"""The bridge to an MQTT broker: carries what the publisher sends and the listener hears."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from gateway.backlog import Backlog
from gateway.clock import Clock
from gateway.config import MqttSection
from gateway.control.command import Result
from gateway.control.door import Door
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.mqtt import client, outcome
from gateway.mqtt.client import Introduction
from gateway.mqtt.connection import Connection
from gateway.mqtt.events import Event, Events, of_result
from gateway.mqtt.filters import policies
from gateway.mqtt.forwarding import Forwarder
from gateway.mqtt.history import Historian
from gateway.mqtt.listener import FORGET, Listener
from gateway.mqtt.message import Message
from gateway.mqtt.missed import Missed
from gateway.mqtt.outgoing import Outgoing
from gateway.mqtt.outlet import PER_VALUE
from gateway.mqtt.publisher import Publisher
from gateway.mqtt.uplink import Uplink

STEPS = 4  # owed values sent at a stretch: some 0.2 ms, so that a line's timing does not suffer


class Bridge(Uplink):
    """Publishes the image to one broker, from `run` until it is cancelled.

    After each connect the whole image is published as it is then. What the broker has missed, where there is a
    `backlog`, comes behind that, as history.
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
        backlog: Backlog | None = None,
    ) -> None:
        super().__init__(section, stats, clock, chance)
        self.name = section.origin
        self._section = section
        self._gateway = gateway
        self._introduced = client.introduction(section, gateway)
        self._publisher = Publisher(section, gateway, image, stats, door.controls if door is not None else {})
        self._events = Events(image)
        self._listener: Listener | None = None
        if backlog is not None:
            historian = Historian(section, gateway, backlog)
            forwarder = Forwarder(section.store.rate, historian.unpack)
            self._missed = Missed(backlog, image, lambda each: policies(section, each), forwarder, clock)
        image.subscribe(self._on_change)
        if door is not None and door.controls:
            self._listener = Listener(section, gateway, door, stats, clock, self._tell_event)
            door.on_event(self._on_event)
            door.on_result(self._on_result)

    # ---- the connection

    def _introduction(self) -> Introduction:
        return self._introduced

    def _begin(self, connection: Connection) -> None:
        self._publisher.owe_everything()
        listener, discovery, version = self._listener, self._publisher.discovery, self._section.version
        subscriptions = []
        if listener is not None:
            listener.begin(connection.outgoing)
            subscriptions += client.subscriptions(listener.filters, version)
        if discovery is not None:
            subscriptions += client.subscriptions(discovery.filters, version, wants_kept=True)
        if subscriptions:
            connection.listen(subscriptions, self._ears)

    def _end(self) -> None:
        if self._listener is not None:
            self._listener.end()

    # ---- what comes

    def _hear(self, message: Message) -> None:
        """Hand a message to whom it is for."""
        discovery = self._publisher.discovery
        if discovery is not None and discovery.takes(message.topic):
            self._publisher.hear(message, self._clock.now())
        elif self._listener is not None:
            self._listener.hear(message)

    def _hand_over(self, most: int) -> bool:
        return self._listener is not None and self._listener.hand_over(most)

    # ---- what goes

    def _look(self, now: float) -> None:
        self._publisher.look(now)
        if self._missed is not None:
            self._missed.look(None if self._connection is None else self._connection.outgoing.handed)
        self._tell_events(self._events.look(now))

    def _is_owing(self, _now: float) -> bool:
        return self._publisher.is_owing

    def _settle(self, wire: Outgoing, now: float) -> None:
        self._publisher.settle(wire, now, STEPS)

    def _on_change(self, image: DriveImage, names: Sequence[str]) -> None:
        """Publish what is news, before the answer's call chain ends."""
        connection, now = self._connection, self._clock.now()
        events = self._events.notice(image, names, now)
        if connection is None:
            if self._missed is not None:
                self._missed.note(image, names, None)
            self._tell_events(events)
            return
        try:
            has_room = connection.outgoing.room > PER_VALUE * (len(names) or len(image.names))
            self._publisher.tell(connection.outgoing, image, names, now)
            if self._missed is not None:
                self._missed.note(image, names, self._mark(connection, was_sent=has_room))
            self._tell_events(events)
            connection.flush_soon()
        except Exception as error:
            connection.fail(error)
        if self._publisher.is_owing:
            connection.wake()

    def _on_event(self, drive: str, _event: str, _reason: str) -> None:
        """Have it published who may command now, when whoever tells of it has come to an end."""
        self._publisher.owe_standing(drive)
        self._wake()

    def _on_result(self, result: Result) -> None:
        event = of_result(result)
        if event is not None:
            self._tell_events([event])

    def _tell_events(self, events: Sequence[Event]) -> None:
        for event in events:
            wall = self._clock.wall()
            self._tell_event(event.drive, outcome.event(event.kind, event.reason, wall, event.more), wall)

    def _tell_event(self, drive: str, text: str, wall: float) -> None:
        """Publish what happened to a drive; where that cannot be now it is kept for later, or counted."""
        topic = f"{self._section.base}/{self._gateway}/{drive}/{outcome.EVENT}"
        connection, keeps = self._connection, self._missed is not None
        was_told = connection is not None and connection.outgoing.say(
            topic, text, expiry=FORGET, is_event=True, is_remembered=keeps
        )
        if self._missed is None:
            self._stats.untold += not was_told
        elif connection is not None and was_told:
            mark, is_there = self._mark(connection, was_sent=True), connection.outgoing.last_event
            self._missed.note_event(drive, text, wall, mark, is_there)
        else:
            self._missed.note_event(drive, text, wall, None)

    # ---- what the broker has missed

    def _post(self, wire: Outgoing, what: tuple[str, str]) -> Callable[[], bool] | None:
        return wire.post(*what)

    def _say_farewell(self, wire: Outgoing) -> None:
        self._publisher.leave(wire, self._clock.now())
