"""What a controller can ask for, and what becomes of it: one Command in, exactly one Result out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from enum import StrEnum


class Channel(StrEnum):
    """The way a command came in; a drive's `sources` name those that may write to it."""

    MQTT = "mqtt"
    MODBUS_TCP = "modbus-tcp"
    SPARKPLUG = "sparkplug"
    GATEWAY = "gateway"


@dataclass(frozen=True, slots=True)
class Source:
    """Who commands: a lease has one as its owner. `name` is what the controller calls itself, or its address.

    `broker` is by which of several brokers it came: one name at two of them is two controllers, so that neither can
    keep, or lose, what the other holds.
    """

    channel: Channel
    name: str = ""
    broker: str = ""

    def __str__(self) -> str:
        way = f"{self.channel}/{self.broker}" if self.broker else self.channel
        return f"{way} {self.name}".strip()


GATEWAY = Source(Channel.GATEWAY)


class Verb(StrEnum):
    """What is asked for, by the names that payloads use."""

    RUN = "run"
    STOP = "stop"
    COAST = "coast"
    EMERGENCY_STOP = "emergency_stop"
    RESET = "reset"
    FREQUENCY = "frequency"
    SPEED = "speed"
    PRESET = "preset"
    JOG = "jog"
    ACCELERATION = "acceleration"
    TERMINALS = "terminals"
    ANALOG = "analog"
    SET = "set"
    WORDS = "words"
    ARM = "arm"
    TAKE = "take"
    RELEASE = "release"
    RELEASE_PRIORITY = "release_priority"

    @property
    def is_stopping(self) -> bool:
        """Say whether it goes ahead of everything, from any source that may write (SAFETY.md H04, H29)."""
        return self in (Verb.STOP, Verb.COAST, Verb.EMERGENCY_STOP)

    @property
    def is_about_permission(self) -> bool:
        """Say whether it changes who may command, and sends no frame."""
        return self in (Verb.ARM, Verb.TAKE, Verb.RELEASE)


class Status(StrEnum):
    """How a command ended. UNKNOWN: it was sent, and nobody can say whether it was done."""

    DONE = "done"
    REFUSED = "refused"
    FAILED = "failed"
    UNKNOWN = "unknown"


class Reason(StrEnum):
    """Why a command was refused or failed, in one word for programs."""

    NONE = ""
    MALFORMED = "malformed"
    RETAINED = "retained"
    EXPIRED = "expired"
    UNKNOWN_DRIVE = "unknown_drive"
    NOT_CONTROLLED = "not_controlled"
    NOT_PERMITTED = "not_permitted"
    NOT_OWNER = "not_owner"
    NOT_ARMED = "not_armed"
    NO_WATCHDOG = "no_watchdog"
    OFFLINE = "offline"
    QUIESCED = "quiesced"
    RANGE = "range"
    READ_ONLY = "read_only"
    FORBIDDEN = "forbidden"
    STORED = "stored"
    WORN = "worn"
    TOO_OFTEN = "too_often"
    NO_STORE = "no_store"
    NOT_IN_MODEL = "not_in_model"
    BUSY = "busy"
    SUPERSEDED = "superseded"
    STOPPED = "stopped"
    REFUSED_BY_DRIVE = "refused_by_drive"
    NOT_READ_BACK = "not_read_back"
    NO_ANSWER = "no_answer"
    LINE_DOWN = "line_down"
    STILL_TRIPPED = "still_tripped"
    ENDING = "ending"


@dataclass(frozen=True, slots=True)
class Command:
    """One request of a controller.

    `received` and `deadline` are monotonic seconds; no frame is sent after the deadline, but for stopping.
    `value` is in the register's unit; `text` is a code or bits by name. `id` is the controller's own: a known
    one gets the first result again and sends nothing (SAFETY.md H03).
    """

    drive: str
    verb: Verb
    source: Source
    received: float
    deadline: float
    id: str = ""
    is_reverse: bool = False
    value: Decimal | None = None
    text: str = ""
    name: str = ""
    address: int = 0
    words: tuple[int, ...] = ()

    def older_by(self, seconds: float, *, is_stop: bool = False) -> Command:
        """Return it as it is if it has lain unread for so long: its time began, and ends, that much sooner.

        A stop does not end: `is_stop` says so of a raw one.
        """
        if seconds <= 0:
            return self
        deadline = self.deadline if is_stop or self.verb.is_stopping else self.deadline - seconds
        return replace(self, received=self.received - seconds, deadline=deadline)


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a command: by register name the words known before, those written, and what the drive holds."""

    command: Command
    status: Status
    reason: Reason = Reason.NONE
    text: str = ""
    raw: Mapping[str, int] = field(default_factory=dict)
    read_back: Mapping[str, int] = field(default_factory=dict)
    before: Mapping[str, int] = field(default_factory=dict)


Answer = Callable[[Result], None]
