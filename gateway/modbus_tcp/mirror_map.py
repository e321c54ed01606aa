"""The command mirror of unit 255: its registers, and the numbers that stand for words in it. Pure data.

The numbers are part of the map: they stay when words are added.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

from gateway.control.command import Channel, Reason, Status, Verb
from gateway.control.state import Standing

MIRROR_AT = 0x8000
PER_DRIVE = 16
LINES_AT = 0xE000  # one register a line: a stop for all of its drives


class Place(IntEnum):
    """The registers of one drive in the mirror."""

    COMMAND = 0
    HEARTBEAT = 1
    FREQUENCY = 2
    PARAMETER = 3
    SEQUENCE = 4
    ECHO = 5
    RESULT = 6
    REASON = 7
    STANDING = 8
    OWNER = 9
    OWNER_HIGH = 10
    OWNER_LOW = 11
    LEASE_LEFT = 12
    DRIVE_STATUS = 13
    OUTPUT_FREQUENCY = 14
    TRIP_CODE = 15

    @property
    def is_written(self) -> bool:
        """Say whether a controller writes it; the others it can only read."""
        return self <= Place.SEQUENCE


@dataclass(frozen=True, slots=True)
class Order:
    """What a code in a command register asks for. `has_number`: the parameter register is part of it."""

    verb: Verb
    is_reverse: bool = False
    has_number: bool = False

    @property
    def word(self) -> str:
        """Return it in a word: "run_reverse"."""
        return f"{self.verb}_reverse" if self.is_reverse else str(self.verb)


NOTHING = 0
ORDERS: Mapping[int, Order] = {
    1: Order(Verb.TAKE),
    2: Order(Verb.ARM),
    3: Order(Verb.RELEASE),
    4: Order(Verb.STOP),
    5: Order(Verb.COAST),
    6: Order(Verb.EMERGENCY_STOP),
    7: Order(Verb.RESET),
    8: Order(Verb.RUN),
    9: Order(Verb.RUN, is_reverse=True),
    10: Order(Verb.JOG),
    11: Order(Verb.JOG, is_reverse=True),
    12: Order(Verb.PRESET, has_number=True),
    13: Order(Verb.ACCELERATION, has_number=True),
    14: Order(Verb.RELEASE_PRIORITY),
}
LINE_ORDERS: Mapping[int, Order] = {code: order for code, order in ORDERS.items() if order.verb.is_stopping}

UNDER_WAY = 5  # the result of a command that has none yet
ENDED = 6  # of one that was done, and holds no longer: a motor that was stopped since, a lease that is over
STATUSES: Mapping[Status, int] = {Status.DONE: 1, Status.REFUSED: 2, Status.FAILED: 3, Status.UNKNOWN: 4}
STANDINGS: Mapping[Standing, int] = {
    Standing.ARMED: 1,
    Standing.DISARMED: 2,
    Standing.LOST: 3,
    Standing.QUIET: 4,
}
OWNERS: Mapping[Channel, int] = {Channel.MQTT: 1, Channel.MODBUS_TCP: 2, Channel.GATEWAY: 3, Channel.SPARKPLUG: 4}
REASONS: Mapping[Reason, int] = {
    Reason.NONE: 0,
    Reason.MALFORMED: 1,
    Reason.RETAINED: 2,
    Reason.EXPIRED: 3,
    Reason.UNKNOWN_DRIVE: 4,
    Reason.NOT_CONTROLLED: 5,
    Reason.NOT_PERMITTED: 6,
    Reason.NOT_OWNER: 7,
    Reason.NOT_ARMED: 8,
    Reason.NO_WATCHDOG: 9,
    Reason.OFFLINE: 10,
    Reason.QUIESCED: 11,
    Reason.RANGE: 12,
    Reason.READ_ONLY: 13,
    Reason.FORBIDDEN: 14,
    Reason.STORED: 15,
    Reason.WORN: 16,
    Reason.TOO_OFTEN: 17,
    Reason.NO_STORE: 18,
    Reason.NOT_IN_MODEL: 19,
    Reason.BUSY: 20,
    Reason.SUPERSEDED: 21,
    Reason.STOPPED: 22,
    Reason.REFUSED_BY_DRIVE: 23,
    Reason.NOT_READ_BACK: 24,
    Reason.NO_ANSWER: 25,
    Reason.LINE_DOWN: 26,
    Reason.STILL_TRIPPED: 27,
    Reason.ENDING: 28,
}
