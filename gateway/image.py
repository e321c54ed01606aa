"""The process image: the one place where values live, as words with quality and age.

Words of one answer appear together, under one version. A reader gets a fresh value or the reason why not;
an old number is never handed out as if it were new.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from decimal import Decimal
from functools import partial

from gateway.drives.register import Derived
from gateway.quality import LinkState, Missing, Quality, Sample
from gateway.segment import NEVER, Place, Segment
from gateway.site import Drive, Point

__all__ = ["NEVER", "DriveImage", "Image", "LinkState", "Listener", "Missing", "Quality", "Reading", "Sample"]

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
        self.bases: dict[str, Decimal] = {}  # replaced as a whole when a drive is known anew
        self.version = 0  # of the words: one more with each answer
        self.revision = 0  # of words and link: one more with each change of either
        self.changed_at = NEVER  # monotonic time of the last answer
        self._unreadable: Missing | None = Missing.NOT_FRESH  # why the link lets nothing be read
        self._listeners: list[Listener] = []
        self._wall_offset = 0.0  # UTC minus monotonic seconds at the last answer
        self._newest_at = NEVER  # monotonic time of the last answer that brought a value
        self._segments: list[Segment] = []
        self._at: dict[int, tuple[Segment, int]] = {}
        self.names = (*self.points, *self.derived)  # of all values, derived ones behind the registers
        self.places: dict[str, Place] = {}
        self.good_until = NEVER  # the values that listeners are just told of are all good until then; NEVER: ask each
        self._turned = dict.fromkeys(self.names, Quality.NEVER_READ)  # what was told of those that are not good
        self._calm_until = NEVER  # no value turns before, unless by an answer, the link or a base
        self._known_bases: Mapping[str, Decimal] = {}  # at the last sweep
        self._lay_out()
        self._place_at = {point.register.address: self.places[name] for name, point in self.points.items()}

    def _lay_out(self) -> None:
        """Make a segment of each run of numbers."""
        runs: list[list[int]] = []
        for address in sorted(point.register.address for point in self.points.values()):
            if not runs or address != runs[-1][-1] + 1:
                runs.append([])
            runs[-1].append(address)
        for run in runs:
            segment = Segment(len(run))
            self._segments.append(segment)
            self._at.update((address, (segment, offset)) for offset, address in enumerate(run))
        for name in self.points:
            self.places[name] = self._place(name, name)
        for name, derived in self.derived.items():
            self.places[name] = self._place(name, derived.of, derived.base)

    def _place(self, name: str, of: str, base: str | None = None) -> Place:
        point = self.points[of]
        segment, offset = self._at[point.register.address]
        return Place(name, segment, offset, mask=point.register.mask, max_age=point.max_age, base=base)

    def subscribe(self, listener: Listener) -> None:
        """Call `listener(image, names)` after each answer with values; without names after a change of the link."""
        self._listeners.append(listener)

    def apply(self, words: Iterable[tuple[int, int]], now: float, wall: float) -> None:
        """Take the (communication number, word) pairs of one answer; what is no point is passed over."""
        places = self._place_at
        answer = [(place, word & place.mask) for address, word in words if (place := places.get(address)) is not None]
        until = float("inf")
        for place, word in answer:
            expires = now + place.max_age
            place.segment.put(place.offset, word, now, expires)
            if expires < until:
                until = expires
        for segment in {place.segment for place, _ in answer}:
            segment.seal()
        self.changed_at = now
        self._wall_offset = wall - now
        self.version += 1
        self.revision += 1
        self.good_until = until if self._unreadable is None else NEVER
        if self.good_until < self._calm_until:
            self._calm_until = self.good_until
        names = [place.name for place, _ in answer]
        if names:
            self._newest_at = now
        if self.bases and self.derived:
            read = set(names)
            names += [d.name for d in self.derived.values() if d.of in read and d.base in self.bases]
        if self._turned:
            for name in names:
                self._turned.pop(name, None)
        if names:  # without any it would be told as a change of the link
            self._tell(names)

    def set_link(self, link: LinkState, reason: str = "") -> None:
        """Take the link's state; a lost link ends the freshness of every value for good, however often it is told."""
        is_new = (link, reason) != (self.link, self.reason)
        if link.is_connected and not is_new:
            return
        self.link, self.reason = link, reason
        self.revision += 1
        self.good_until = self._calm_until = NEVER
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
        if now <= self._calm_until and self.bases == self._known_bases:
            return
        turned = []
        for name in self.names:
            quality = self.quality(name, now)
            if quality is not self._turned.get(name, Quality.GOOD):
                self._turned[name] = quality
                turned.append(name)
        self._turned = {name: quality for name, quality in self._turned.items() if quality is not Quality.GOOD}
        self._calm_until, self._known_bases = self.next_expiry(now), dict(self.bases)
        if turned:
            self.good_until = NEVER
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
        return Quality.GOOD if self.is_fresh(now) else Quality.STALE

    def is_fresh(self, now: float) -> bool:
        """Say whether every register is good; a derived value is as well where its base is known."""
        if self._unreadable is not None:
            return False
        for segment in self._segments:
            if segment.fresh_until < now and not segment.is_fresh(0, segment.count, now):
                return False
        return True

    @property
    def newest_wall(self) -> float:
        """Return when the newest value was read, in UTC seconds; 0 where none was, or before 1970."""
        return max(0.0, self._newest_at + self._wall_offset)

    def next_expiry(self, now: float) -> float:
        """Return when the first of the values that are fresh now turns stale; infinity when none is."""
        times = (when for segment in self._segments for when in segment.expires if when >= now)
        return min(times, default=float("inf"))

    def quality(self, name: str, now: float) -> Quality:
        """Return the quality of a value."""
        return self.quality_of(self.places[name], now)

    def quality_of(self, place: Place, now: float) -> Quality:
        """Return the quality of the value that stands there."""
        if place.read_at[place.offset] == NEVER or (place.base is not None and place.base not in self.bases):
            return Quality.NEVER_READ
        if self._unreadable is not None:
            return Quality.OFFLINE
        return Quality.STALE if place.expires[place.offset] < now else Quality.GOOD

    def sample(self, name: str, now: float) -> Sample:
        """Return a value as it is now; a derived value has the word of the register behind it."""
        place = self.places[name]
        quality = self.quality_of(place, now)
        if quality is Quality.NEVER_READ:
            return Sample(0, quality, float("inf"), 0.0)
        read_at = place.read_at[place.offset]
        return Sample(place.numbers[place.offset], quality, max(0.0, now - read_at), read_at + self._wall_offset)

    def wall_of(self, place: Place) -> float:
        """Return when the value that stands there was read, in UTC seconds."""
        return place.read_at[place.offset] + self._wall_offset

    def expiry(self, name: str) -> float:
        """Return the monotonic time past which a value is stale; NEVER where it has not been read."""
        place = self.places[name]
        return place.expires[place.offset]

    def number(self, name: str, word: int, bases: Mapping[str, Decimal] | None = None) -> Decimal:
        """Return the engineering value that a word of it stands for, by earlier bases where some are given."""
        derived = self.derived.get(name)
        if derived is None:
            return self.points[name].register.decode(word)
        value = self.points[derived.of].register.decode(word)
        base = (self.bases if bases is None else bases)[derived.base]
        return (value * base / 100).quantize(Decimal(1).scaleb(-derived.digits))

    def show(self, name: str, word: int, bases: Mapping[str, Decimal] | None = None) -> str:
        """Return the engineering value as text, with the decimals that it has; see `number` for `bases`."""
        if name in self.derived:
            return f"{self.number(name, word, bases):f}"
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
