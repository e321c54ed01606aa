"""Decides what an edge node may publish now, and with which numbers (Sparkplug 3.0, 5.4 to 5.6). Pure.

Births come before data, the primary host before births, and every message has the number after the one before.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

NUMBERS = 256  # bdSeq and seq count from 0 to 255


class Phase(Enum):
    """How far the session of an edge node has come.

    AWAY: no connection. WAITING: the primary host is not known to be online. NODE_BIRTH and DEVICE_BIRTHS: births are
    owed. LIVE: data may be sent. LEAVING: the primary host went offline, so the session is to be ended.
    """

    AWAY = auto()
    WAITING = auto()
    NODE_BIRTH = auto()
    DEVICE_BIRTHS = auto()
    LIVE = auto()
    LEAVING = auto()


class Happening(Enum):
    """What moves a session on. HOST_ONLINE is said at once where no primary host is waited for."""

    CONNECTED = auto()
    LOST = auto()
    HOST_ONLINE = auto()
    HOST_OFFLINE = auto()
    NODE_BORN = auto()
    DEVICES_BORN = auto()
    REBIRTH = auto()


IN_SESSION = (Phase.NODE_BIRTH, Phase.DEVICE_BIRTHS, Phase.LIVE)

TRANSITIONS: dict[tuple[Phase, Happening], Phase] = {
    **{(phase, happening): phase for phase in Phase for happening in Happening},  # the rest changes nothing
    **{(phase, Happening.CONNECTED): Phase.WAITING for phase in Phase},
    **{(phase, Happening.LOST): Phase.AWAY for phase in Phase},
    **{(phase, Happening.REBIRTH): Phase.NODE_BIRTH for phase in IN_SESSION},
    **{(phase, Happening.HOST_OFFLINE): Phase.LEAVING for phase in IN_SESSION},
    (Phase.WAITING, Happening.HOST_ONLINE): Phase.NODE_BIRTH,
    (Phase.NODE_BIRTH, Happening.NODE_BORN): Phase.DEVICE_BIRTHS,
    (Phase.DEVICE_BIRTHS, Happening.DEVICES_BORN): Phase.LIVE,
}


@dataclass(slots=True)
class Session:
    """The session of the edge node: its phase, the number of its connection, and the number of the next message."""

    phase: Phase = Phase.AWAY
    bd_seq: int = -1  # of the newest CONNECT; none was sent yet
    seq: int = 0

    @property
    def next_bd_seq(self) -> int:
        """Return the number that the will of the next CONNECT must have."""
        return (self.bd_seq + 1) % NUMBERS

    @property
    def is_in_session(self) -> bool:
        """Say whether hosts are, or are about to be, told of this edge node."""
        return self.phase in IN_SESSION

    def connecting(self) -> None:
        """Take that a CONNECT was sent, accepted or not."""
        self.bd_seq = self.next_bd_seq

    def take(self, happening: Happening) -> None:
        """Move on; an NBIRTH begins to count anew."""
        self.phase = TRANSITIONS[self.phase, happening]
        if self.phase is Phase.NODE_BIRTH:
            self.seq = 0

    def sent(self) -> None:
        """Take that the message with the number `seq` is on its way."""
        self.seq = (self.seq + 1) % NUMBERS
