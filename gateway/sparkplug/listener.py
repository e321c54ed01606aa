"""Hears what hosts send to the edge node: their commands, and whether the primary host is online.

An offline primary host ends the leases that were taken by Sparkplug, at once. An online one renews none: the broker
keeps that message, and a heartbeat must come from the controller itself (SAFETY.md H05).
"""

from __future__ import annotations

import logging

from gateway.clock import Clock
from gateway.config import SparkplugSection
from gateway.control.command import Channel, Result, Source
from gateway.control.door import Door
from gateway.metrics import MqttStats
from gateway.mqtt.exact import NotExact
from gateway.mqtt.inbox import Allowance
from gateway.mqtt.intake import Intake
from gateway.mqtt.message import Message, Moment
from gateway.sparkplug import host
from gateway.sparkplug.commands import Asked, Rebirth, Target, read_device, read_node
from gateway.sparkplug.host import PrimaryHost
from gateway.sparkplug.node import REBIRTH, Node
from gateway.sparkplug.protobuf import BadPayload
from gateway.sparkplug.session import Happening

log = logging.getLogger("gateway.sparkplug")

GOOD_FOR = 1.0  # seconds of a stop of a line
WARNINGS = 0.1  # a second that are logged of states that cannot be understood
WARNINGS_AT_ONCE = 5.0


class Listener:
    """What hosts send to one edge node by one broker."""

    def __init__(
        self, section: SparkplugSection, node: Node, stats: MqttStats, clock: Clock, door: Door | None = None
    ) -> None:
        self._node = node
        self._stats = stats
        self._clock = clock
        self._max_age = section.command_max_age
        self._door = door
        self._intake = Intake(door, stats, clock) if door is not None and section.commands else None
        self._host = PrimaryHost(section.primary_host) if section.primary_host is not None else None
        self._source = Source(Channel.SPARKPLUG, section.primary_host or "")
        self._warnings = Allowance(WARNINGS, WARNINGS_AT_ONCE)
        self._node_topic = node.topics.of_node("NCMD")
        self._targets = {
            node.topics.of_device("DCMD", name): Target(name, device.metrics.writable, device.model)
            for name, device in node.devices.items()
            if device.metrics.writable and self._intake is not None
        }

    @property
    def command_topics(self) -> list[str]:
        """Return the topics of commands, of the node and of every drive that can be commanded."""
        return [self._node_topic, *self._targets]

    @property
    def state_topic(self) -> str | None:
        """Return where the primary host says whether it is online; None where none is waited for."""
        return None if self._host is None else self._host.topic

    def begin(self) -> None:
        """Take that there is a connection: without a primary host, births may be sent at once."""
        if self._host is None:
            self._node.take(Happening.HOST_ONLINE)
        else:
            self._host.forget()

    def end(self) -> None:
        """Take that the connection is lost: what came by it is still carried out."""
        while self.hand_over(1):
            pass

    def hand_over(self, most: int) -> bool:
        """Hand on that many commands; say whether more wait."""
        return self._intake is not None and self._intake.hand_over(most)

    def hear(self, message: Message) -> None:
        """Take one message."""
        self._stats.heard += 1
        if self._host is not None and message.topic == self._host.topic:
            self._hear_state(self._host, message)
        elif message.topic == self._node_topic:
            self._hear_node(message)
        elif message.topic in self._targets:
            self._hear_device(message, self._targets[message.topic])
        else:
            self._stats.ignored += 1

    def _hear_state(self, primary: PrimaryHost, message: Message) -> None:
        try:
            state = host.read(message.payload)
        except NotExact as error:
            self._pass_over(f"{message.topic}: no state of a host: {error}")
            return
        if not primary.hear(state):
            self._pass_over(f"{message.topic}: older than what the host said before, so it counts for nothing")
            return
        log.info("the primary host %s is %s", primary.name, "online" if state.is_online else "offline")
        self._node.take(Happening.HOST_ONLINE if state.is_online else Happening.HOST_OFFLINE)
        if not state.is_online and self._door is not None:
            self._door.end_leases(Channel.SPARKPLUG, f"the primary host {primary.name} is offline")

    def _pass_over(self, why: str) -> None:
        """Count a message that counts for nothing, and log it, but no flood of them."""
        self._stats.ignored += 1
        log.log(logging.WARNING if self._warnings.take(self._clock.now()) else logging.DEBUG, "%s", why)

    def _hear_node(self, message: Message) -> None:
        lines = self._node.line_inputs if self._intake is not None else {}
        try:
            asked = read_node(message, lines, REBIRTH, self._asked(GOOD_FOR))
        except BadPayload as error:
            log.debug("%s: %s", message.topic, error)
            asked = []
        self._stats.ignored += not asked
        for each in asked:
            if isinstance(each, Rebirth):
                self._node.rebirth()
            elif self._intake is not None:
                self._intake.take(each, _nobody)

    def _hear_device(self, message: Message, target: Target) -> None:
        if self._intake is None or self._door is None:
            return
        settings = self._door.controls[target.drive].settings
        for each in read_device(message, target, self._asked(settings.command_timeout)):
            self._intake.take(each, _nobody)

    def _asked(self, good_for: float) -> Asked:
        """Return who asks, and since when a message may lie here: since before a standstill, if there was one."""
        now = self._clock.now()
        since = self._door.since(now) if self._door is not None else now
        moment = Moment(since, self._clock.wall(), good_for, self._max_age)
        return Asked(self._source, moment, self._host is None or self._host.is_online is True)


def _nobody(_result: Result) -> None:
    """Tell nobody: every result of a drive is told by its metric."""
