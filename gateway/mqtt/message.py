"""What comes by MQTT, when it came, and what it turns out to be."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.control.command import Command, Reason, Source


@dataclass(frozen=True, slots=True)
class Message:
    """A message as it came, and what the broker says of it.

    `is_retained`: the broker had kept it. `is_repeated`: it may have been delivered before. `is_early`: it came
    before the subscription was confirmed. `expiry`: seconds for which it is still good. `response_topic` and
    `correlation` are for the answer (MQTT 5).
    """

    topic: str
    payload: bytes
    is_retained: bool = False
    is_repeated: bool = False
    is_early: bool = False
    expiry: int | None = None
    response_topic: str = ""
    correlation: bytes = b""


@dataclass(frozen=True, slots=True)
class Moment:
    """When a message came, monotonic and UTC seconds; how long a command is good for, and how old it may be."""

    now: float
    wall: float
    good_for: float
    max_age: float


@dataclass(frozen=True, slots=True)
class Beat:
    """A sign of life of a controller."""

    drive: str
    source: Source
    beat: bytes


@dataclass(frozen=True, slots=True)
class LineStop:
    """A stop of every drive of a line."""

    line: str
    command: Command


class NotTaken(Exception):
    """A message that is understood and yet not carried out; `reason` is for programs."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason = reason
