"""Decides which readings are worth keeping for a broker that misses them, and how they are written down. Pure.

By the same rules as what is published: a deadband, a shortest and a longest interval for each value.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gateway.backlog import Kind, Reading
from gateway.image import DriveImage, Quality
from gateway.mqtt import payload
from gateway.mqtt.filters import Policy
from gateway.mqtt.report import Report


@dataclass(frozen=True, slots=True)
class Taken:
    """What one answer brought of a drive, as words: cheap to make, since most of it the broker gets at once.

    `ms` is when that was, in milliseconds of UTC.
    """

    image: DriveImage
    ms: int
    words: Sequence[tuple[str, int, Quality]]

    def written(self) -> Reading:
        """Return it as it is kept: numbers as text in `v`, null where not good, qualities in `q`, words in `t`."""
        image, values, texts, qualities = self.image, {}, {}, {}
        for name, word, quality in self.words:
            is_good = quality is Quality.GOOD
            values[name] = image.show(name, word) if is_good else None
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
        return Reading(image.drive.name, Kind.VALUES, self.ms, text)


class Sampler:
    """The values of one drive: which of them are due."""

    def __init__(self, image: DriveImage, policies: Mapping[str, Policy]) -> None:
        self._image = image
        self._report = Report(image, policies)

    def take(self, names: Sequence[str], now: float, wall: float) -> Taken | None:
        """Take an answer, or, without names, a change of the link; None where nothing of it is due.

        `now` and `wall` are monotonic and UTC seconds.
        """
        image, report = self._image, self._report
        found, newest = [], 0.0
        for name in names or image.names:
            sample = image.sample(name, now)
            if not names and not report.has_turned(name, sample.quality):
                continue
            if sample.quality is Quality.NEVER_READ or not report.is_due(name, sample, now):
                continue
            report.note(name, sample, now)
            found.append((name, sample.word, sample.quality))
            if sample.quality is Quality.GOOD:
                newest = max(newest, sample.wall)
        return Taken(image, round((newest or wall) * 1000), found) if found else None

    def release(self, now: float, wall: float) -> Taken | None:
        """Take what had to wait for its turn, when that has come."""
        names = self._report.released(now)
        return self.take(names, now, wall) if names else None
