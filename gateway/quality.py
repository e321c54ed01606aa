"""What a value is worth: how far it can be trusted, what is known of its drive, and why there is none."""

from __future__ import annotations

from enum import Enum, IntEnum
from typing import NamedTuple


class Quality(IntEnum):
    """How far a value can be trusted; the numbers stand in the MODBUS-TCP map."""

    GOOD = 0
    STALE = 1
    OFFLINE = 2
    NEVER_READ = 3

    @property
    def word(self) -> str:
        """Return the name as payloads spell it: "never_read"."""
        return self.name.lower()


class LinkState(IntEnum):
    """What is known of the connection to a drive; the numbers stand in the MODBUS-TCP map."""

    ONLINE = 0
    SUSPECT = 1
    OFFLINE = 2
    STARTING = 3
    STRANGER = 4
    LINE_DOWN = 5

    @property
    def word(self) -> str:
        """Return the name as payloads spell it: "line_down"."""
        return self.name.lower()

    @property
    def is_connected(self) -> bool:
        """Say whether the drive's values may be believed."""
        return self in (LinkState.ONLINE, LinkState.SUSPECT)


class Missing(Enum):
    """Why a range of words cannot be given."""

    UNMAPPED = "no such value is read from this drive"
    NOT_FRESH = "stale, never read, or the drive is silent"
    LINE_DOWN = "the line is down"
    NOT_FITTING = "the value does not fit the type that it is mapped as"


class Sample(NamedTuple):
    """A value at one moment: its word, quality, age in seconds, and UTC source time in seconds (0: none)."""

    word: int
    quality: Quality
    age: float
    wall: float
