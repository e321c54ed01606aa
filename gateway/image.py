"""The process image: the one place where values live, as words with quality and age.

Words of one answer appear together, under one version. A reader gets a fresh value or the reason why not;
an old number is never handed out as if it were new.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from decimal import Decimal
from enum import Enum, IntEnum
from functools import partial
from typing import NamedTuple

from gateway.drives.register import Derived
from gateway.segment import NEVER, Segment
from gateway.site import Drive, Point

__all__ = ["NEVER", "DriveImage", "Image", "LinkState", "Listener", "Missing", "Quality", "Reading", "Sample"]


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


Listener = Callable[["DriveImage", Sequence[str]], None]
Reading = Callable[[float], bytes | Missing]
"""Reads one range of words that was found beforehand, as it is at a monotonic time."""


class DriveImage:
    """The values of one drive. Every point is a polled register; segments are runs of their numbers."""

    def __init__(self, drive: Drive) -> None:
        self.drive = drive
        self.points: Mapping[str, Point] = drive.points
        self.derived: Mapping[str, Derived] = {d.name: d for d in drive.derived}
        self.link = LinkState.STARTING
        self.reason = "not heard yet"
        self.identity: Mapping[str, str] = {}
        self.is_tripped: bool | None = None  # by the last answer of any kind; None while that is not known
        self.is_reset_needed = False  # settings wait for a reset of the drive
        self.bases: dict[str, Decimal] = {}
        self.version = 0  # of the words: one more with each answer
        self.revision = 0  # of words and link: one more with each change of either
        self.changed_at = NEVER  # monotonic time of the last answer
        self._unreadable: Missing | None = Missing.NOT_FRESH  # why the link lets nothing be read
        self._listeners: list[Listener] = []
        self._wall_offset = 0.0  # UTC minus monotonic seconds at the last answer
        self._name_at = {point.register.address: name for name, point in self.points.items()}
        self._segments: list[Segment] = []
        self._at: dict[int, tuple[Segment, int]] = {}
        self._places: dict[str, tuple[Segment, int, str | None]] = {}  # by value, and what a derived one needs
        self._swept: dict[str, Quality] = dict.fromkeys(self.points, Quality.NEVER_READ)
        self._lay_out()

    def _lay_out(self) -> None:
        """Make a segment of each run of numbers."""
        runs: list[list[int]] = []
        for address in sorted(self._name_at):
            if not runs or address != runs[-1][-1] + 1:
                runs.append([])
            runs[-1].append(address)
        for run in runs:
            segment = Segment(len(run))
            self._segments.append(segment)
            self._at.update((address, (segment, offset)) for offset, address in enumerate(run))
        for name, point in self.points.items():
            self._places[name] = (*self._at[point.register.address], None)
        for name, derived in self.derived.items():
            self._places[name] = (*self._at[self.points[derived.of].register.address], derived.base)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of all values, derived ones behind the registers."""
        return (*self.points, *self.derived)

    def subscribe(self, listener: Listener) -> None:
        """Call `listener(image, names)` after each answer; without names after a change of the link."""
        self._listeners.append(listener)

    def apply(self, words: Iterable[tuple[int, int]], now: float, wall: float) -> None:
        """Take the (communication number, word) pairs of one answer; what is no point is passed over."""
        answer = [(self._name_at[address], address, word) for address, word in words if address in self._name_at]
        for name, address, word in answer:
            point = self.points[name]
            segment, offset = self._at[address]
            segment.put(offset, word & point.register.mask, now, now + point.max_age)
        self.changed_at = now
        self._wall_offset = wall - now
        self.version += 1
        self.revision += 1
        names = [name for name, _, _ in answer]
        read = set(names)
        names += [d.name for d in self.derived.values() if d.of in read and d.base in self.bases]
        for name in names:
            self._swept[name] = Quality.GOOD
        self._tell(names)

    def set_link(self, link: LinkState, reason: str = "") -> None:
        """Take the link's state; a lost link ends the freshness of every value for good, however often it is told."""
        is_new = (link, reason) != (self.link, self.reason)
        if link.is_connected and not is_new:
            return
        self.link, self.reason = link, reason
        self.revision += 1
        self._unreadable = None
        if not link.is_connected:
            self._unreadable = Missing.LINE_DOWN if link is LinkState.LINE_DOWN else Missing.NOT_FRESH
            self.is_tripped = None
            for segment in self._segments:
                segment.end_freshness()
        if is_new:
            self._tell(())

    def set_tripped(self, is_tripped: bool | None) -> None:
        """Take whether the drive is tripped; the listeners are told of a change as of one of the link."""
        if is_tripped is not self.is_tripped:
            self.is_tripped = is_tripped
            self.revision += 1
            self._tell(())

    def set_reset_needed(self, is_needed: bool) -> None:
        """Take whether settings wait for a reset of the drive; told like a change of the link."""
        if is_needed is not self.is_reset_needed:
            self.is_reset_needed = is_needed
            self.revision += 1
            self._tell(())

    def sweep(self, now: float) -> None:
        """Tell the listeners which values turned stale or went offline since they were last told."""
        turned = []
        for name in self.names:
            quality = self.quality(name, now)
            if quality is not self._swept.get(name, Quality.NEVER_READ):
                self._swept[name] = quality
                turned.append(name)
        if turned:
            self._tell(turned)

    def _tell(self, names: Sequence[str]) -> None:
        for listener in self._listeners:
            listener(self, names)

    def read(self, start: int, count: int, now: float) -> bytes | Missing:
        """Return `count` words from `start` as they stand on a MODBUS wire, or why not."""
        found = self._at.get(start)
        if found is None:
            return Missing.UNMAPPED
        segment, offset = found
        end = offset + count
        if end > segment.count:
            return Missing.UNMAPPED
        if self._unreadable is not None:
            return self._unreadable
        if segment.fresh_until < now and not segment.is_fresh(offset, end, now):
            return Missing.NOT_FRESH
        return segment.words[2 * offset : 2 * end]

    def reading(self, start: int, count: int) -> Reading:
        """Return what reads these words again and again: `read` for masters that always ask the same."""
        segment, offset = self._at.get(start, (None, 0))
        if segment is None or offset + count > segment.count:
            return partial(self.read, start, count)
        first, end = 2 * offset, 2 * (offset + count)
        whole = segment.words
        words = whole[first:end]

        def read(now: float) -> bytes | Missing:
            nonlocal whole, words
            if self._unreadable is None and segment.fresh_until >= now:
                if segment.words is not whole:
                    whole = segment.words
                    words = whole[first:end]
                return words
            return self.read(start, count, now)

        return read

    def worst_quality(self, now: float) -> Quality:
        """Return the worst quality of all values."""
        if not all(segment.is_read() for segment in self._segments):
            return Quality.NEVER_READ
        if not self.link.is_connected:
            return Quality.OFFLINE
        are_fresh = all(segment.is_fresh(0, segment.count, now) for segment in self._segments)
        return Quality.GOOD if are_fresh else Quality.STALE

    def next_expiry(self, now: float) -> float:
        """Return when the first of the values that are fresh now turns stale; infinity when none is."""
        times = (when for segment in self._segments for when in segment.expires if when >= now)
        return min(times, default=float("inf"))

    def quality(self, name: str, now: float) -> Quality:
        """Return the quality of a value."""
        return self.sample(name, now).quality

    def sample(self, name: str, now: float) -> Sample:
        """Return a value as it is now; a derived value has the word of the register behind it."""
        segment, offset, base = self._places[name]
        read_at = segment.read_at[offset]
        if read_at == NEVER or (base is not None and base not in self.bases):
            return Sample(0, Quality.NEVER_READ, float("inf"), 0.0)
        word = segment.words[2 * offset] << 8 | segment.words[2 * offset + 1]
        quality = Quality.GOOD
        if not self.link.is_connected:
            quality = Quality.OFFLINE
        elif segment.expires[offset] < now:
            quality = Quality.STALE
        return Sample(word, quality, max(0.0, now - read_at), read_at + self._wall_offset)

    def expiry(self, name: str) -> float:
        """Return the monotonic time past which a value is stale; NEVER where it has not been read."""
        derived = self.derived.get(name)
        segment, offset = self._at[self.points[derived.of if derived else name].register.address]
        return segment.expires[offset]

    def number(self, name: str, word: int) -> Decimal:
        """Return the engineering value that a word of this value stands for."""
        derived = self.derived.get(name)
        if derived is None:
            return self.points[name].register.decode(word)
        value = self.points[derived.of].register.decode(word)
        return (value * self.bases[derived.base] / 100).quantize(Decimal(1).scaleb(-derived.digits))

    def show(self, name: str, word: int) -> str:
        """Return the engineering value as text, with the decimals that it has."""
        if name in self.derived:
            return f"{self.number(name, word):f}"
        return self.points[name].register.format(word)

    def unit(self, name: str) -> str:
        """Return the engineering unit of a value."""
        derived = self.derived.get(name)
        return derived.unit if derived else self.points[name].register.unit

    def text(self, name: str, word: int) -> str | None:
        """Say a bit field or a code in words; None for a plain number."""
        return None if name in self.derived else self.points[name].register.text(word)


class Image:
    """The values of every drive, by name and by MODBUS-TCP unit id, in the order of the file."""

    def __init__(self, drives: Iterable[Drive]) -> None:
        self.drives: tuple[DriveImage, ...] = tuple(DriveImage(drive) for drive in drives)
        self.by_name: Mapping[str, DriveImage] = {image.drive.name: image for image in self.drives}
        self.by_unit: Mapping[int, DriveImage] = {
            image.drive.unit: image for image in self.drives if image.drive.unit
        }

    def subscribe(self, listener: Listener) -> None:
        """Subscribe to every drive; see DriveImage.subscribe."""
        for image in self.drives:
            image.subscribe(listener)

    def sweep(self, now: float) -> None:
        """Let every drive tell what turned stale; to be called several times a second."""
        for image in self.drives:
            image.sweep(now)
