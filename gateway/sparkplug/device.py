"""Decides what a host must be told of one drive: its birth, what changed, its death. Pure.

What is owed is kept as names, never as values: whatever is sent is as it stands when it is sent.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from gateway.control.drive_control import DriveControl
from gateway.drives.model import Model
from gateway.image import DriveImage, Quality, Sample
from gateway.mqtt.filters import unfiltered
from gateway.mqtt.report import Report
from gateway.sparkplug import drive_metrics
from gateway.sparkplug.definition import in_order
from gateway.sparkplug.drive_metrics import BUTTONS, INPUTS, DriveMetrics
from gateway.sparkplug.payload import Metric, Value

FOR_EVER = float("inf")  # seconds: data is sent when it changes, and not merely since time passes
MOST_TOLD = 32  # results and events that may wait for one drive
MOST_VALUES = 64  # in one message


@dataclass(frozen=True, slots=True)
class Moment:
    """Now: monotonic seconds, and milliseconds of UTC."""

    now: float
    ms: int


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
        for name in names or self._image.names:
            if self._report.is_due(name, self._image.sample(name, now), now):
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
            yield from self._value(name, moment, is_birth=True)

    def data(self, moment: Moment) -> tuple[Metric, ...]:
        """Return what changed, for a DDATA: at most as many values as go into one message."""
        metrics = self.metrics
        changed = [metrics.standing[name].told(self._standing[name], moment.ms) for name in self._look(moment.ms)]
        while self._told:
            name, text, ms = self._told.popleft()
            changed.append(metrics.told[name].told(text, ms))
        for name in list(self._owed)[:MOST_VALUES]:
            del self._owed[name]
            changed += self._value(name, moment, is_birth=False)
        return in_order(changed)

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

    def _value(self, name: str, moment: Moment, *, is_birth: bool) -> Iterator[Metric]:
        """Yield a value, and its words where it has some; what is not good is null, and so since now."""
        sample = self._image.sample(name, moment.now)
        quality, ms = sample.quality, _time_of(sample, moment.ms)
        tells_quality = is_birth or quality is not Quality.GOOD or self._qualities.get(name) is not quality
        shown = quality if tells_quality else None
        self._report.note(name, sample, moment.now)
        self._qualities[name] = quality
        definition, text = self.metrics.values[name], self.metrics.texts.get(name)
        say = definition.born if is_birth else definition.told
        yield say(drive_metrics.value_of(self._image, name, definition.datatype, sample.word, quality), ms, shown)
        if text is not None:
            say = text.born if is_birth else text.told
            yield say(drive_metrics.text_of(self._image, name, sample.word, quality), ms, shown)


def _time_of(sample: Sample, ms: int) -> int:
    return round(sample.wall * 1000) if sample.quality is Quality.GOOD else ms


