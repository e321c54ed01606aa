"""What the gateway's own unit id answers: the compact map, 16 registers a drive, and the gateway's counters."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

from gateway.image import DriveImage, Image, LinkState, Missing, Quality, Reading
from gateway.metrics import Stats
from gateway.modbus_tcp.user_map import UserMap

UNIT = 255
REGISTERS_PER_DRIVE = 16
NO_VALUE = 0x8000
NEVER_HEARD = 0xFFFF  # the age in milliseconds saturates here
AGE_AT = 2
VALUES_AT = 3
PRESENT_AT = 15
VALUES = (
    "status",
    "output_frequency",
    "output_current",
    "output_voltage",
    "alarm",
    "trip_code",
    "frequency_command_value",
    "input_voltage",
    "torque",
    "output_power",
    "input_terminals",
    "output_terminals",
)
WORD = struct.Struct(">H")
REVISION = attrgetter("revision")
AHEAD = 0.000_001  # seconds that a kept age ends before its millisecond does: more than a time is rounded by


@dataclass(frozen=True, slots=True)
class Counter:
    """One of the gateway's counters: 16 bits, or 32 with the high word first."""

    name: str
    title: str
    is_long: bool = False
    unit: str = ""


COUNTERS_AT = 0xF000
COUNTERS = (
    Counter("map_version", "version of this map"),
    Counter("gateway_version", "version of the gateway: 10203 is 1.2.3"),
    Counter("uptime", "time since the server was made", is_long=True, unit="s"),
    Counter("drives", "drives configured"),
    Counter("drives_online", "drives that answer (link state 0 or 1)"),
    Counter("lines", "RS485 lines configured"),
    Counter("lines_up", "RS485 lines whose port is open"),
    Counter("exchanges", "exchanges on all lines", is_long=True),
    Counter("errors", "errors of every kind on all lines", is_long=True),
    Counter("mqtt_connected", "1 while connected to every broker"),
    Counter("tcp_connections", "MODBUS-TCP connections open"),
    Counter("tcp_requests", "MODBUS-TCP requests answered", is_long=True),
    Counter("tcp_exceptions", "of these, answered with an exception", is_long=True),
    Counter("tcp_turned_away", "connections beyond the limit, closed at once", is_long=True),
    Counter("mqtt_published", "messages given to brokers", is_long=True),
    Counter("mqtt_dropped", "messages dropped because too many waited", is_long=True),
)
COUNTERS_FORM = struct.Struct(">" + "".join("I" if counter.is_long else "H" for counter in COUNTERS))
MAP_VERSION = 2


class DriveBlock:
    """The 16 registers of one drive, built anew only when its values, its link or their freshness have changed."""

    def __init__(self, image: DriveImage) -> None:
        self._image = image
        self._revision = -1
        self._valid_until = float("-inf")
        self._before_age = self._after_age = b""

    def words(self, now: float) -> bytes:
        """Return the registers as they stand on the wire."""
        image = self._image
        if image.revision != self._revision or self._valid_until < now:
            self._build(now)
        age = now - image.changed_at
        milliseconds = int(max(age, 0.0) * 1000) if age * 1000 < NEVER_HEARD else NEVER_HEARD
        return self._before_age + WORD.pack(milliseconds) + self._after_age

    def holds_until(self, now: float) -> float:
        """Return up to when (monotonic) the words of this moment stay as they are, unless the drive changes."""
        milliseconds = (now - self._image.changed_at) * 1000
        if milliseconds >= NEVER_HEARD:
            return self._valid_until
        return min(self._valid_until, self._image.changed_at + (int(milliseconds) + 1) / 1000 - AHEAD)

    def _build(self, now: float) -> None:
        image = self._image
        self._revision = image.revision
        self._valid_until = image.next_expiry(now)
        values = [self._value(name, now) for name in VALUES]
        present = sum(1 << VALUES_AT + i for i, value in enumerate(values) if value is not None)
        words = [NO_VALUE if value is None else value for value in values]
        self._before_age = struct.pack(">HH", image.link, image.worst_quality(now))
        self._after_age = struct.pack(f">{len(words)}HH", *words, present)

    def _value(self, name: str, now: float) -> int | None:
        if name not in self._image.points:
            return None
        sample = self._image.sample(name, now)
        return sample.word if sample.quality is Quality.GOOD else None


class GatewayUnit:
    """Unit 255. It answers as long as the gateway runs: what is missing is told by link, quality and 8000H."""

    link = LinkState.ONLINE

    def __init__(
        self,
        image: Image,
        stats: Stats,
        identity: Mapping[str, str],
        started: float,
        user_map: UserMap | None = None,
    ) -> None:
        self._user_map = user_map
        self.identity = identity
        self._image = image
        self._stats = stats
        self._started = started
        self._version = version_number(identity["version"])
        self._blocks = [DriveBlock(drive) for drive in image.drives]
        self._drives_end = REGISTERS_PER_DRIVE * len(self._blocks)

    def reading(self, start: int, count: int) -> Reading:
        """Return what reads these registers again and again."""
        if start + count <= self._drives_end:
            return self._reading(start, count)
        if self._user_map is None or start >= COUNTERS_AT:
            return partial(self.read, start, count)
        return self._user_map.reading(start, count)

    def _reading(self, start: int, count: int) -> Reading:
        """Return what reads the same registers of drives again: built anew when a drive or an age has changed.

        An answer that brings no value is told to nobody, and yet the drive was heard: hence the revisions.
        """
        asked = slice(start // REGISTERS_PER_DRIVE, -(-(start + count) // REGISTERS_PER_DRIVE))
        blocks, images = self._blocks[asked], self._image.drives[asked]
        words: bytes | Missing = b""
        revisions, holds_until = -1, 0.0

        def read(now: float) -> bytes | Missing:
            nonlocal words, revisions, holds_until
            current = sum(map(REVISION, images))
            if now > holds_until or revisions != current:
                words = self.read(start, count, now)
                revisions = current
                holds_until = min([block.holds_until(now) for block in blocks])
            return words

        return read

    def read(self, start: int, count: int, now: float) -> bytes | Missing:
        """Return `count` registers from `start`, or UNMAPPED where they leave what this unit has."""
        end = start + count
        if end <= self._drives_end:
            first = start // REGISTERS_PER_DRIVE
            blocks = self._blocks[first : -(-end // REGISTERS_PER_DRIVE)]
            words = b"".join([block.words(now) for block in blocks])
            return _cut(words, start - REGISTERS_PER_DRIVE * first, count)
        if start >= COUNTERS_AT and 2 * (end - COUNTERS_AT) <= COUNTERS_FORM.size:
            return _cut(self._counters(now), start - COUNTERS_AT, count)
        return Missing.UNMAPPED if self._user_map is None else self._user_map.read(start, count, now)

    def _counters(self, now: float) -> bytes:
        stats, lines, brokers = self._stats, self._stats.lines.values(), self._stats.brokers.values()
        numbers = (
            MAP_VERSION,
            self._version,
            int(now - self._started),
            len(self._image.drives),
            sum(drive.link.is_connected for drive in self._image.drives),
            len(lines),
            sum(line.is_up for line in lines),
            sum(line.exchanges for line in lines),
            sum(line.errors.total() for line in lines),
            bool(brokers) and all(broker.is_connected for broker in brokers),
            stats.tcp.connections,
            stats.tcp.requests.total(),
            stats.tcp.exceptions.total(),
            stats.tcp.turned_away,
            sum(broker.published for broker in brokers),
            sum(broker.dropped for broker in brokers),
        )
        return COUNTERS_FORM.pack(*(_fit(*pair) for pair in zip(COUNTERS, numbers, strict=True)))


def version_number(version: str) -> int:
    """Return a version as one decimal number, two digits a part: "1.2.3" is 10203."""
    major, minor, patch = ([int(part) for part in version.split(".")[:3] if part.isdigit()] + [0, 0, 0])[:3]
    return major * 10_000 + minor * 100 + patch


def _fit(counter: Counter, number: int) -> int:
    """Let 32-bit counters run over and 16-bit ones saturate."""
    return number % 2**32 if counter.is_long else min(number, 0xFFFF)


def _cut(words: bytes, offset: int, count: int) -> bytes:
    return words[2 * offset : 2 * (offset + count)]
