"""How one drive may be commanded, as configured; times in seconds."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from enum import Enum
from fnmatch import fnmatchcase

from gateway.config import DriveSection, FallbackSection, RightSection, StoredWritesSection
from gateway.control.command import GATEWAY, Channel, Command, Source
from gateway.drives.register import Register

NO_LIMIT = 500  # Hz: what no drive exceeds, and `frequency.max` by default
TIMEOUT_ACTIONS = {"alarm": 0, "coast": 1, "stop": 2}  # F804 (E6581657 6.3)
TIMEOUT_DETECTIONS = {"always": 0, "communication": 1, "running": 2}  # F808


class OnLoss(Enum):
    """What is done when nobody keeps the lease alive any more."""

    STOP = "stop"
    COAST = "coast"
    EMERGENCY_STOP = "emergency-stop"
    QUIESCE = "quiesce"
    HOLD = "hold"
    FREQUENCY = "frequency"


@dataclass(frozen=True, slots=True)
class Right:
    """What one source may write; `*` and `?` stand for any."""

    channel: Channel
    name: str
    commands: tuple[str, ...]
    registers: tuple[str, ...]
    least: Decimal | None
    greatest: Decimal | None
    broker: str = "*"

    def covers(self, command: Command) -> bool:
        """Say whether it is this source's, and permits the command itself."""
        source = command.source
        is_source = source.channel is self.channel and fnmatchcase(source.name, self.name)
        is_source = is_source and fnmatchcase(source.broker, self.broker)
        return is_source and any(fnmatchcase(command.verb, pattern) for pattern in self.commands)

    def permits(self, register: Register, word: int) -> bool:
        """Say whether it permits that word in that register."""
        if not any(fnmatchcase(register.name, pattern) for pattern in self.registers):
            return False
        value = register.decode(word)
        return (self.least is None or self.least <= value) and (self.greatest is None or value <= self.greatest)


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """The control of one drive. `is_leased`: commands need a lease."""

    is_leased: bool
    sources: frozenset[Channel]
    rights: tuple[Right, ...]
    lease: float
    on_loss: OnLoss
    fallback: Decimal | None
    stops_on_exit: bool
    communication_timeout: float | None
    timeout_action: int | None
    timeout_detection: int | None
    is_unwatched: bool
    allow_stored: bool
    stored_writes: StoredWritesSection
    least_frequency: Decimal
    greatest_frequency: Decimal
    command_timeout: float

    @property
    def has_frequency_limits(self) -> bool:
        """Say whether the configuration limits the frequency more than any drive does."""
        return self.least_frequency > 0 or self.greatest_frequency < NO_LIMIT

    def may_write(self, source: Source) -> bool:
        """Say whether a source may command at all."""
        return source.channel in self.sources

    def rights_of(self, command: Command) -> tuple[Right, ...] | None:
        """Return the rights that cover a command; None where none are configured, so that all is permitted."""
        if not self.rights or command.source == GATEWAY:
            return None
        return tuple(right for right in self.rights if right.covers(command))

    def permits_verb(self, command: Command) -> bool:
        """Say whether the source may ask for this; stopping needs no right but that of writing."""
        return command.verb.is_stopping or self.rights_of(command) != ()

    def permits(self, command: Command, register: Register, word: int) -> bool:
        """Say whether the source may write that word."""
        rights = self.rights_of(command)
        return rights is None or command.verb.is_stopping or any(right.permits(register, word) for right in rights)


def settings_of(section: DriveSection) -> ControlSettings | None:
    """Return the control of a configured drive; None where it is off."""
    if section.control == "off":
        return None
    loss = section.on_loss
    action, detection = section.timeout_action, section.timeout_detection
    return ControlSettings(
        is_leased=section.control == "leased",
        sources=frozenset(Channel(name) for name in section.sources),
        rights=tuple(_right(right) for right in section.right),
        lease=section.lease,
        on_loss=OnLoss.FREQUENCY if isinstance(loss, FallbackSection) else OnLoss(loss),
        fallback=_exact(loss.frequency) if isinstance(loss, FallbackSection) else None,
        stops_on_exit=section.on_exit == "stop",
        communication_timeout=section.communication_timeout,
        timeout_action=None if action is None else TIMEOUT_ACTIONS[action],
        timeout_detection=None if detection is None else TIMEOUT_DETECTIONS[detection],
        is_unwatched=section.unwatched,
        allow_stored=section.allow_stored,
        stored_writes=section.stored_writes,
        least_frequency=_exact(section.frequency.min),
        greatest_frequency=_exact(section.frequency.max),
        command_timeout=section.command_timeout,
    )


def _right(section: RightSection) -> Right:
    least, greatest = section.min, section.max
    return Right(
        channel=Channel(section.source),
        name=section.name,
        commands=tuple(section.commands),
        registers=tuple(section.registers),
        least=None if least is None else _exact(least),
        greatest=None if greatest is None else _exact(greatest),
        broker=section.broker,
    )


def _exact(value: float) -> Decimal:
    """Return the number as it was written."""
    return Decimal(str(value))
