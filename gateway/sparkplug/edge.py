"""The connection of the edge node to its broker: carries what the node sends and the listener hears."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping, Sequence

from gateway.backlog import Backlog, Kept
from gateway.clock import Clock
from gateway.config import SparkplugSection
from gateway.control.command import Result
from gateway.control.door import Door
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.mqtt import client, outcome
from gateway.mqtt.client import Introduction
from gateway.mqtt.connection import Connection
from gateway.mqtt.filters import Policy, unfiltered
from gateway.mqtt.forwarding import Forwarder, Parcel
from gateway.mqtt.message import Message
from gateway.mqtt.missed import Missed
from gateway.mqtt.outgoing import Outgoing
from gateway.mqtt.uplink import Uplink
from gateway.sparkplug import history
from gateway.sparkplug.device import FOR_EVER, Moment
from gateway.sparkplug.listener import Listener
from gateway.sparkplug.memory import Keeper, Memory
from gateway.sparkplug.node import Node
from gateway.sparkplug.session import Happening, Phase

WINDOW = 1000  # messages of what was missed that are not known to be there: that is asked some times a second
STEPS = 1  # messages sent at a stretch: a birth takes 0.3 ms, and a line's timing must not suffer


class EdgeNode(Uplink):
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
        keeper: Keeper | None = None,
        backlog: Backlog | None = None,
    ) -> None:
        super().__init__(section, stats, clock, chance)
        self._section = section
        controls = door.controls if door is not None else {}
        self.node = Node(section, gateway, image, stats, controls, door.lines if door is not None else {})
        self._memory = None if keeper is None else Memory(keeper, self.node.topics)
        self._listener = Listener(section, self.node, stats, clock, door)
        if backlog is not None:
            forwarder = Forwarder(section.store.rate, self._unpack, window=WINDOW)
            self._missed = Missed(backlog, image, self._policies, forwarder, clock)
        image.subscribe(self._on_change)
        if controls and door is not None:
            door.on_result(self._on_result)
            door.on_event(self._on_event)

    def _policies(self, image: DriveImage) -> Mapping[str, Policy]:
        return unfiltered(self._section.deadband, FOR_EVER, image)

    # ---- the connection

    async def run(self) -> None:
        """Go on counting connections from the last one, then do as any uplink."""
        last = await self._memory.last() if self._memory is not None else None
        if last is not None:
            self.node.session.bd_seq = last
        await super().run()

    def _introduction(self) -> Introduction:
        """Return as what the edge node connects: its will is the NDEATH of this very connection."""
        topics = self.node.topics
        name = self._section.client_id or f"sparkplug-{topics.group}-{topics.node}".replace(" ", "-")
        will = self.node.will(self._ms())
        return Introduction(name, topics.of_node("NDEATH"), will, 1, retain=False, wills_at_leave=True)

    def _knocked(self) -> None:
        self.node.session.connecting()
        if self._memory is not None:
            self._memory.keep(self.node.session.bd_seq)

    def _begin(self, connection: Connection) -> None:
        self.node.take(Happening.CONNECTED)
        listener, version = self._listener, self._section.version
        subscriptions = client.subscriptions(listener.command_topics, version)
        if listener.state_topic is not None:
            subscriptions.append(client.subscription_to_state(listener.state_topic, version))
        connection.listen(subscriptions, self._ears)
        listener.begin()

    def _end(self) -> None:
        self.node.take(Happening.LOST)
        self._listener.end()

    def _farewell(self) -> str:
        is_leaving = self.node.session.phase is Phase.LEAVING
        return f"the primary host {self._section.primary_host} is offline" if is_leaving else ""

    def _say_farewell(self, wire: Outgoing) -> None:
        wire.carry(self.node.topics.of_node("NDEATH"), self.node.death(self._ms()))

    # ---- what comes

    def _hear(self, message: Message) -> None:
        self._listener.hear(message)
        self._wake()  # it may have been a rebirth, or the primary host

    def _hand_over(self, most: int) -> bool:
        return self._listener.hand_over(most)

    # ---- what goes

    def _look(self, _now: float) -> None:
        self.node.look()

    def _is_owing(self, now: float) -> bool:
        return self.node.is_owing(now)

    def _settle(self, wire: Outgoing, now: float) -> None:
        self.node.settle(wire, Moment(now, self._ms()), STEPS)

    def _patience(self, now: float) -> float:
        most = super()._patience(now)
        return min(most, self.node.held_back(now) or most)

    def _on_change(self, image: DriveImage, names: Sequence[str]) -> None:
        """Publish what is news, before the answer's call chain ends."""
        connection, drive = self._connection, image.drive.name
        if connection is None:
            if self._missed is not None:
                self._missed.note(image, names, None)
            return
        try:
            moment = Moment(self._clock.now(), self._ms())
            self.node.note_change(image, names, moment.now)
            self.node.settle_drive(connection.outgoing, drive, moment)
            if self._missed is not None:
                self._missed.note(image, names, self._mark(connection, was_sent=self.node.is_told(drive)))
            connection.flush_soon()
        except Exception as error:
            connection.fail(error)
        if self.node.is_owing(self._clock.now()):
            connection.wake()

    def _on_result(self, result: Result) -> None:
        self.node.note_result(result, self._clock.wall())
        self._wake()

    def _on_event(self, drive: str, event: str, reason: str) -> None:
        """Tell what happened to a drive; it is kept until hosts are known to have it."""
        wall = self._clock.wall()
        can_be_told = self.node.note_event(drive, event, reason, wall)
        if self._missed is None:
            self._stats.untold += not can_be_told
        elif self.node.tells_events(drive):
            mark = self._tell(drive) if can_be_told else None
            self._missed.note_event(drive, outcome.event(event, reason, wall), wall, mark)
        self._wake()

    def _tell(self, drive: str) -> int | None:
        """Send what happened to a drive; return by which message it is known to be there, None: it was not sent."""
        connection = self._connection
        if connection is None:
            return None
        try:
            was_sent = self.node.send_told(connection.outgoing, drive, Moment(self._clock.now(), self._ms()))
            connection.flush_soon()
        except Exception as error:
            connection.fail(error)
            return None
        return self._mark(connection, was_sent=was_sent)

    # ---- what the broker has missed

    def _unpack(self, kept: Kept) -> list[Parcel[history.Missed]]:
        return history.unpack(self.node.devices, kept)

    def _may_post(self, _now: float) -> bool:
        if self._missed is not None and self.node.is_live:
            self._missed.pass_over(self.node.unborn)
        return self.node.is_live

    def _post(self, wire: Outgoing, what: history.Missed) -> Callable[[], bool] | None:
        """Send what was missed; the broker has it when it has read so many messages."""
        if not self.node.send_missed(wire, what, Moment(self._clock.now(), self._ms())):
            return None
        mark = wire.handed
        return lambda: wire.there >= mark

    def _ms(self) -> int:
        return round(self._clock.wall() * 1000)
