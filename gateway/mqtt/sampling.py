"""Decides which readings are worth keeping for a broker that misses them, and how they are written down. Pure.

By the same rules as what is published: a deadband, a shortest and a longest interval for each value.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import NamedTuple

from gateway.backlog import HistoricalReading, Kind, milliseconds
from gateway.image import DriveImage, Quality
from gateway.mqtt import payload
from gateway.mqtt.filters import Policy
from gateway.mqtt.report import Report


class Taken(NamedTuple):
    """What one answer brought of a drive, as words: cheap to make, since most of it the broker gets at once.

    `ms` is when that was, in milliseconds of UTC. `bases` are those of then: a drive that comes back may have others.
    """

    image: DriveImage
    bases: Mapping[str, Decimal]
    ms: int
    words: Sequence[tuple[str, int, Quality]]

    def written(self) -> HistoricalReading:
        """Return it as it is kept: numbers as text in `v`, null where not good, qualities in `q`, words in `t`."""
        image, values, texts, qualities = self.image, {}, {}, {}
        for name, word, quality in self.words:
            is_good = quality is Quality.GOOD
            values[name] = image.show(name, word, self.bases) if is_good else None
            text = image.text(name, word) if is_good else None
            if not is_good:
                qualities[name] = quality.word
            elif text is not None:
                texts[name] = text or payload.NO_BITS
        body: dict[str, Mapping[str, object]] = {"v": values}
        if qualities:
            body["q"] = qualities
        if texts:
            body["t"] = texts
        text = json.dumps(body, ensure_ascii=False, separators=(",", ":"))
        return HistoricalReading(image.drive.name, Kind.VALUES, self.ms, text)


class Sampler:
    """The values of one drive: which of them are due."""

    def __init__(self, image: DriveImage, policies: Mapping[str, Policy]) -> None:
        self._image = image
        self._report = Report(image, policies)

    def take(self, names: Sequence[str], now: float, wall: float) -> Taken | None:
        """Take an answer, or, without names, a change of the link; None where nothing of it is due.

        `now` and `wall` are monotonic and UTC seconds.
        """
        image, values = self._image, self._report.values
        if not names:
            turned = [name for name in image.names if values[name].quality is not image.quality(name, now)]
            return self._take(turned, now, wall)
        if now > image.good_until:
            return self._take(names, now, wall)
        found = []
        for name in names:
            said, place = values[name], image.places[name]
            word = place.numbers[place.offset]
            if said.is_due(word, Quality.GOOD, now):
                said.note(word, Quality.GOOD, now)
                found.append((name, word, Quality.GOOD))
        return Taken(image, image.bases, milliseconds(image.newest_wall or wall), found) if found else None

    def _take(self, names: Sequence[str], now: float, wall: float) -> Taken | None:
        """Take values of which each may be of another quality and age."""
        found, newest = [], 0.0
        for name in names:
            word, quality, _, read_at = self._image.sample(name, now)
            said = self._report.values[name]
            if quality is Quality.NEVER_READ or not said.is_due(word, quality, now):
                continue
            said.note(word, quality, now)
            found.append((name, word, quality))
            if quality is Quality.GOOD:
                newest = max(newest, read_at)
        return Taken(self._image, self._image.bases, milliseconds(newest or wall), found) if found else None

    def release(self, now: float, wall: float) -> Taken | None:
        """Take what had to wait for its turn, when that has come."""
        names = self._report.released(now)
        return self._take(names, now, wall) if names else None
