"""Hears what controllers send, and says what became of it.

Messages are read as they come, so that a stop is never behind others; `intake` takes them to the door.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol

from gateway.clock import Clock
from gateway.config import MqttSection
from gateway.control.command import Channel, Result, Source
from gateway.control.door import Door
from gateway.metrics import MqttStats
from gateway.mqtt import commands, outcome
from gateway.mqtt.intake import Intake
from gateway.mqtt.message import Message, Moment

GOOD_FOR = 1.0  # seconds of a command for a drive that nobody may command
LONGEST_LEVEL = 128  # characters; longer ones name nothing here, and no result could be told by them
FORGET = 60  # seconds after which the broker may forget a result or an event


class Wire(Protocol):
    """The way back to those who asked; it never waits, and says False where there is no room."""

    def say(self, topic: str, text: str, *, expiry: int, is_event: bool = False) -> bool:
        """Publish something that happened, not to be retained; an event is to arrive (QoS 1)."""
        ...

    def reply(self, topic: str, text: str, correlation: bytes) -> bool:
        """Publish an answer to one who named a topic for it."""
        ...


class Listener:
    """What controllers send to one gateway by one broker.

    `tell` publishes an event of a drive, as text and with its time in UTC seconds, and keeps it where that cannot be
    now; by default none is kept.
    """

    def __init__(
        self,
        section: MqttSection,
        gateway: str,
        door: Door,
        stats: MqttStats,
        clock: Clock,
        tell: Callable[[str, str, float], None] | None = None,
    ) -> None:
        self._tell = tell
        self._root = f"{section.base}/{gateway}/"
        self._max_age = section.command_max_age
        self._takes_commands = section.commands
        self._origin = Source(Channel.MQTT, broker=section.origin)
        self._door = door
        self._stats = stats
        self._clock = clock
        self._wire: Wire | None = None
        self._intake = Intake(door, stats, clock)
        door.on_result(self._on_result)
        door.on_event(self._on_event)

    @property
    def filters(self) -> list[str]:
        """Return the topic filters to subscribe to; none where nobody may command by this broker."""
        if not self._takes_commands:
            return []
        levels = (f"+/{commands.COMMAND}", f"+/{commands.SET}/+", f"+/{commands.HEARTBEAT}")
        return [self._root + each for each in (*levels, f"{commands.LINE}/+/{commands.COMMAND}")]

    @property
    def is_waiting(self) -> bool:
        """Say whether a command waits to be handed on."""
        return self._intake.is_waiting

    def begin(self, wire: Wire) -> None:
        """Take the way back for as long as the connection lasts."""
        self._wire = wire

    def end(self) -> None:
        """Take that the connection is lost: what came by it is still carried out, and its results are counted."""
        self._wire = None
        while self.hand_over(1):
            pass

    # ---- what comes in

    def hear(self, message: Message) -> None:
        """Take one message."""
        self._stats.heard += 1
        if not self._takes_commands or not message.topic.startswith(self._root):
            self._stats.ignored += 1
            return
        levels = message.topic.removeprefix(self._root).split("/")
        if max(map(len, levels)) > LONGEST_LEVEL:
            self._stats.ignored += 1
            return
        control = self._door.controls.get(levels[0])
        good_for = GOOD_FOR if control is None else control.settings.command_timeout
        moment = Moment(self._since(), self._clock.wall(), good_for, self._max_age)
        read = commands.read(message, levels, moment, None if control is None else control.drive.model, self._origin)
        answer = partial(self._answer, message)
        if read is None:
            self._stats.ignored += 1
        else:
            self._intake.take(read, answer)

    def _since(self) -> float:
        """Return since when a message may have been there: since before the event loop stood still, if it did."""
        return self._door.since(self._clock.now())

    def hand_over(self, most: int) -> bool:
        """Hand on that many commands; say whether more wait."""
        return self._intake.hand_over(most)

    # ---- what goes out

    def _answer(self, message: Message, result: Result) -> None:
        """Answer to the one who asked, where the message names a topic for it (MQTT 5)."""
        topic = message.response_topic
        if not topic:
            return
        if not _may_be_answered_on(topic):
            self._stats.untold += 1
            return
        text = outcome.result(result, self._clock.wall())
        if self._wire is None or not self._wire.reply(topic, text, message.correlation):
            self._stats.untold += 1

    def _on_result(self, result: Result) -> None:
        self._say(f"{result.command.drive}/{outcome.RESULT}", outcome.result(result, self._clock.wall()))

    def _on_event(self, drive: str, event: str, reason: str) -> None:
        wall = self._clock.wall()
        text = outcome.event(event, reason, wall)
        if self._tell is not None:
            self._tell(drive, text, wall)
        else:
            self._say(f"{drive}/{outcome.EVENT}", text, is_event=True)

    def _say(self, topic: str, text: str, *, is_event: bool = False) -> None:
        """Publish what happened, with its time; it is counted, and not kept, where that cannot be now."""
        if self._wire is None or not self._wire.say(self._root + topic, text, expiry=FORGET, is_event=is_event):
            self._stats.untold += 1


def _may_be_answered_on(topic: str) -> bool:
    """Say whether an answer may go to a topic: not where any gateway takes it for a command."""
    levels = topic.split("/")
    is_taken = levels[-1] in (commands.COMMAND, commands.HEARTBEAT) or commands.SET in levels[-2:-1]
    is_name = not any(character in topic for character in "+#\0") and not topic.startswith("$")
    return is_name and not is_taken and len(topic.encode(errors="replace")) <= 65_535
