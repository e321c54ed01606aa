"""What a user-defined map answers: values of drives at addresses of the user's own, in the forms that a PLC wants.

The registers are encoded anew when a drive has told something, at the next read; all other reads are a comparison and
a slice. A value of 32 bits comes from one sample and is read whole or not at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from functools import partial

from gateway.config import MapSection, ModbusTcpSection
from gateway.image import NEVER, DriveImage, Image, LinkState, Missing, Quality, Reading
from gateway.wire_forms import FORMS, WORD, encoder

SEVERITY = (Missing.LINE_DOWN, Missing.NOT_FRESH, Missing.NOT_FITTING)  # the first of them is told


class MappedValue:
    """One entry: its registers as they were at `refresh`, how long they hold, and why they cannot be given."""

    __slots__ = (
        "_encode",
        "_fits",
        "_image",
        "_name",
        "_revision",
        "_shown",
        "address",
        "expires",
        "missing",
        "words",
    )

    def __init__(self, entry: MapSection, image: DriveImage) -> None:
        form = FORMS[entry.type]
        self.address = entry.address
        self.words = bytes(2 * form.words)
        self.expires = NEVER
        self.missing: Missing | None = Missing.NOT_FRESH
        self._image = image
        self._name = entry.value
        self._encode = None if entry.type == WORD else encoder(form, entry.factor, entry.word_order)
        self._revision = -1
        self._shown: Decimal | int | None = None  # what was encoded last
        self._fits = False

    @property
    def end(self) -> int:
        """Return the address behind its last register."""
        return self.address + len(self.words) // 2

    def refresh(self, now: float) -> None:
        """Take the value as it is now, unless its drive has told nothing since."""
        image = self._image
        if image.revision == self._revision:
            return
        self._revision = image.revision
        sample = image.sample(self._name, now)
        if sample.quality is not Quality.GOOD:
            self.missing = Missing.LINE_DOWN if image.link is LinkState.LINE_DOWN else Missing.NOT_FRESH
            return
        self.expires = image.expiry(self._name)
        self._show(sample.word)

    def _show(self, word: int) -> None:
        value = word if self._encode is None else self._image.number(self._name, word)
        if value != self._shown:
            self._shown = value
            encoded = word.to_bytes(2, "big") if self._encode is None else self._encode(Decimal(value))
            self._fits = encoded is not None
            self.words = encoded or self.words
        self.missing = None if self._fits else Missing.NOT_FITTING

    def reason(self, now: float) -> Missing | None:
        """Return why the value cannot be given, None where it can; what is old is old, whether it fits or not."""
        if self.missing is Missing.LINE_DOWN:
            return self.missing
        return Missing.NOT_FRESH if self.expires < now else self.missing


class Run:
    """Values whose registers follow each other without a hole, in the order of their addresses."""

    __slots__ = ("_fresh_until", "_values", "_words", "ends", "is_due", "start")

    def __init__(self, values: Sequence[MappedValue]) -> None:
        self.start = values[0].address
        self.ends: Mapping[int, int] = {value.end: place for place, value in enumerate(values, 1)}
        self.is_due = True  # a drive has told something
        self._values = values
        self._words = b""
        self._fresh_until = NEVER  # of all values; NEVER as long as one cannot be given

    def read(self, first: int, end: int, now: float) -> bytes | Missing:
        """Return the registers from the value at place `first` up to the address `end`, which is behind a value."""
        if self.is_due:
            self._refresh(now)
        if self._fresh_until < now:
            reasons = {value.reason(now) for value in self._values[first : self.ends[end]]}
            for missing in SEVERITY:
                if missing in reasons:
                    return missing
        return self._words[2 * (self._values[first].address - self.start) : 2 * (end - self.start)]

    def reading(self, first: int, end: int) -> Reading:
        """Return what reads these registers again and again."""
        start = self._values[first].address
        begin, stop = 2 * (start - self.start), 2 * (end - self.start)
        whole = self._words
        words = whole[begin:stop]

        def read(now: float) -> bytes | Missing:
            nonlocal whole, words
            if self.is_due or self._fresh_until < now:
                return self.read(first, end, now)
            if self._words is not whole:
                whole = self._words
                words = whole[begin:stop]
            return words

        return read

    def _refresh(self, now: float) -> None:
        self.is_due = False
        for value in self._values:
            value.refresh(now)
        self._words = b"".join([value.words for value in self._values])
        self._fresh_until = min(NEVER if value.missing else value.expires for value in self._values)


class UserMap:
    """The entries of one unit. Where it is a unit of its own it answers as the gateway, as long as that runs."""

    link = LinkState.ONLINE

    def __init__(self, entries: Iterable[MapSection], image: Image, identity: Mapping[str, str]) -> None:
        self.identity = identity
        self._at: dict[int, tuple[Run, int]] = {}  # by the first address of a value: its run, and its place there
        self._runs_of: dict[str, list[Run]] = {}  # by drive
        run: list[MapSection] = []
        for entry in sorted(entries, key=lambda entry: entry.address):
            if run and run[-1].address + FORMS[run[-1].type].words != entry.address:
                self._add(run, image)
                run = []
            run.append(entry)
        self._add(run, image)
        image.subscribe(self._on_change)

    def _add(self, entries: Sequence[MapSection], image: Image) -> None:
        values = [MappedValue(entry, image.by_name[entry.drive]) for entry in entries]
        run = Run(values)
        self._at.update((value.address, (run, place)) for place, value in enumerate(values))
        for drive in {entry.drive for entry in entries}:
            self._runs_of.setdefault(drive, []).append(run)

    def _on_change(self, image: DriveImage, _names: Sequence[str]) -> None:
        for run in self._runs_of.get(image.drive.name, ()):
            run.is_due = True

    def reading(self, start: int, count: int) -> Reading:
        """Return what reads these registers again and again."""
        found = self._at.get(start)
        if found is None or start + count not in found[0].ends:
            return partial(self.read, start, count)
        return found[0].reading(found[1], start + count)

    def read(self, start: int, count: int, now: float) -> bytes | Missing:
        """Return registers as they stand on the wire; UNMAPPED for holes and for a part of a value."""
        found = self._at.get(start)
        if found is None:
            return Missing.UNMAPPED
        run, place = found
        end = start + count
        return run.read(place, end, now) if end in run.ends else Missing.UNMAPPED


def user_maps(section: ModbusTcpSection, image: Image, identity: Mapping[str, str]) -> dict[int, UserMap]:
    """Return the maps of a configuration by their unit ids."""
    entries: dict[int, list[MapSection]] = {}
    for entry in section.map:
        entries.setdefault(section.unit_of(entry), []).append(entry)
    return {unit: UserMap(found, image, identity) for unit, found in entries.items()}
