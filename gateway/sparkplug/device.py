"""Decides what a host must be told of one drive: its birth, what changed, its death. Pure.

What is owed is kept as names, never as values: whatever is sent is as it stands when it is sent.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from gateway.backlog import milliseconds
from gateway.control.drive_control import DriveControl
from gateway.drives.model import Model
from gateway.image import DriveImage, Quality
from gateway.mqtt.filters import unfiltered
from gateway.mqtt.payload import Spelling
from gateway.mqtt.report import Report
from gateway.sparkplug import drive_metrics
from gateway.sparkplug.definition import Teller, in_order
from gateway.sparkplug.drive_metrics import BUTTONS, INPUTS, DriveMetrics
from gateway.sparkplug.payload import Metric, Value, Written

FOR_EVER = float("inf")  # seconds: data is sent when it changes, and not merely since time passes
MOST_TOLD = 32  # results and events that may wait for one drive
MOST_VALUES = 64  # in one message


@dataclass(frozen=True, slots=True)
class Moment:
    """Now: monotonic seconds, and milliseconds of UTC."""

    now: float
    ms: int


class _Shown:
    """One value on its way to the hosts: all that is known of it, found once."""

    __slots__ = ("definition", "name", "number", "place", "teller", "text", "text_teller", "words")

    def __init__(self, image: DriveImage, metrics: DriveMetrics, name: str) -> None:
        self.name = name
        self.place = image.places[name]
        self.definition = metrics.values[name]
        self.teller = Teller(self.definition)
        self.number = drive_metrics.number_of(image, name, self.definition.datatype)
        self.text = metrics.texts.get(name)
        self.text_teller = Teller(self.text) if self.text is not None else None
        self.words = Spelling(image, name).words


class Device:
    """One drive on its way to the hosts of one edge node."""

    def __init__(
        self,
        image: DriveImage,
        metrics: DriveMetrics,
        deadband: Mapping[str, float],
        control: DriveControl | None = None,
    ) -> None:
        self.name = image.drive.name
        self.metrics = metrics
        self.is_born = False
        self.is_barred = False  # its birth is larger than the broker takes
        self._image = image
        self._control = control
        self._policies = unfiltered(deadband, FOR_EVER, image)
        self._report = Report(image, self._policies)
        self._shown = {name: _Shown(image, metrics, name) for name in image.names}
        self._owes_death = False
        self._owed: dict[str, None] = {}
        self._qualities: dict[str, Quality] = {}
        self._standing: dict[str, Value] = {}
        self._since: dict[str, int] = {}  # metric name -> when it came to be as it is
        self._told: deque[tuple[str, str, int]] = deque()
        self._last: dict[str, tuple[str, int]] = {}

    @property
    def model(self) -> Model:
        """Return what the drive is."""
        return self._image.drive.model

    # ---- what is owed

    def begin(self) -> None:
        """Take that hosts know nothing of it, since the edge node is born anew."""
        self.is_born = self.is_barred = self._owes_death = False
        self._owed.clear()
        self._told.clear()

    @property
    def owes_birth(self) -> bool:
        """Say whether the drive is there and hosts do not know it."""
        return not self.is_born and not self.is_barred and self._image.link.is_connected

    @property
    def owes_death(self) -> bool:
        """Say whether the drive was lost and hosts do not know that, even where it is back by now."""
        return self.is_born and (self._owes_death or not self._image.link.is_connected)

    @property
    def owes_data(self) -> bool:
        """Say whether anything has changed since it was told."""
        return self.is_born and bool(self._owed or self._told or self._is_standing_news)

    @property
    def is_owing(self) -> bool:
        """Say whether hosts lack anything."""
        return self.owes_death or self.owes_birth or self.owes_data

    @property
    def _is_standing_news(self) -> bool:
        return self._standing != drive_metrics.standing_of(self._image, self._control)

    # ---- what happens

    def take(self, names: Sequence[str], now: float) -> None:
        """Take that these values were read or turned; without names, that something else of the drive changed."""
        if not self.is_born:
            return
        if not self._image.link.is_connected:
            self._owes_death = True
            return
        image, values = self._image, self._report.values
        are_good = bool(names) and now <= image.good_until
        for name in names or image.names:
            if are_good:
                place = image.places[name]
                word, quality = place.numbers[place.offset], Quality.GOOD
            else:
                word, quality, _, _ = image.sample(name, now)
            if values[name].is_due(word, quality, now):
                self._owed[name] = None

    def note(self, name: str, text: str, ms: int) -> bool:
        """Take a result or an event; False where hosts do not know the drive, or there is no room for it."""
        if name not in self.metrics.told:
            return True
        self._last[name] = text, ms
        if not self.is_born or len(self._told) >= MOST_TOLD:
            return False
        self._told.append((name, text, ms))
        return True

    # ---- what is said

    def birth(self, moment: Moment) -> tuple[Metric, ...]:
        """Return every metric as it stands, for a DBIRTH; all of it counts as told then."""
        self.is_born, self._owes_death = True, False
        self._owed.clear()
        self._told.clear()
        self._report = Report(self._image, self._policies)
        self._qualities.clear()
        self._look(moment.ms)
        return in_order(self._all(moment))

    def _all(self, moment: Moment) -> Iterator[Metric]:
        metrics = self.metrics
        for definition, value in metrics.constants.values():
            yield definition.born(value, moment.ms)
        for name, definition in metrics.inputs.items():
            shown = False if name in BUTTONS else INPUTS[name][1]
            yield definition.born(shown, moment.ms)
        for name, definition in metrics.standing.items():
            yield definition.born(self._standing[name], self._since[name])
        for name, definition in metrics.told.items():
            text, ms = self._last.get(name, (None, moment.ms))
            yield definition.born(text, ms)
        for name in self._image.names:
            yield from self._value(self._shown[name], moment, is_birth=True)

    def data(self, moment: Moment) -> tuple[Metric | Written, ...]:
        """Return what changed, for a DDATA: at most as many values as go into one message."""
        metrics = self.metrics
        changed: list[Metric | Written] = [
            metrics.standing[name].told(self._standing[name], moment.ms) for name in self._look(moment.ms)
        ]
        changed += self.told()
        for name in list(self._owed)[:MOST_VALUES]:
            del self._owed[name]
            changed += self._told_value(self._shown[name], moment)
        return in_order(changed)

    def told(self) -> tuple[Metric, ...]:
        """Return results and events that were not told yet, in their order."""
        found = tuple(self.metrics.told[name].told(text, ms) for name, text, ms in self._told)
        self._told.clear()
        return found

    def death(self) -> None:
        """Take that hosts are told of the drive's death: all of its metrics are stale with them then."""
        self.is_born = self._owes_death = False
        self._owed.clear()
        self._told.clear()

    def _look(self, ms: int) -> list[str]:
        """Return what is new of the standing, and take it as told."""
        shown = drive_metrics.standing_of(self._image, self._control)
        news = [name for name, value in shown.items() if name not in self._since or self._standing[name] != value]
        self._standing = shown
        self._since |= dict.fromkeys(news, ms)
        return news

    def _told_value(self, shown: _Shown, moment: Moment) -> Iterable[Metric | Written]:
        """Return a value as data; what is as good as hosts were told, as nearly always, in bytes at once."""
        image, place = self._image, shown.place
        if self._qualities.get(shown.name) is not Quality.GOOD:
            return self._value(shown, moment, is_birth=False)
        if image.quality_of(place, moment.now) is not Quality.GOOD:
            return self._value(shown, moment, is_birth=False)
        word, ms = place.numbers[place.offset], milliseconds(image.wall_of(place))
        self._report.values[shown.name].note(word, Quality.GOOD, moment.now)
        told = [shown.teller.told(shown.number(word), ms)]
        if shown.text_teller is not None:
            told.append(shown.text_teller.told(shown.words(word), ms))
        return told

    def _value(self, shown: _Shown, moment: Moment, *, is_birth: bool) -> Iterator[Metric]:
        """Yield a value, and its words where it has some; what is not good is null, and so since now."""
        name = shown.name
        word, quality, _, wall = self._image.sample(name, moment.now)
        is_good = quality is Quality.GOOD
        ms = milliseconds(wall) if is_good else moment.ms
        tells_quality = is_birth or not is_good or self._qualities.get(name) is not quality
        code = quality if tells_quality else None
        self._report.values[name].note(word, quality, moment.now)
        self._qualities[name] = quality
        say = shown.definition.born if is_birth else shown.definition.told
        yield say(shown.number(word) if is_good else None, ms, code)
        if shown.text is not None:
            say = shown.text.born if is_birth else shown.text.told
            yield say(shown.words(word) if is_good else None, ms, code)
