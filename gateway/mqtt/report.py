"""Decides which readings are worth publishing: what changed, and what has been silent for long."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal

from gateway.image import DriveImage, Quality, Sample
from gateway.mqtt.topics import has_text


@dataclass(slots=True)
class _Said:
    """What was published last of a value, and when."""

    word: int
    quality: Quality
    at: float


class Report:
    """Report by exception for the values of one drive.

    A value is due when it has never been said, when its quality changed, when it moved by more than its
    deadband, or when it is read `longest_silence` or more after it was said. Bit fields and codes have no deadband.
    """

    def __init__(self, image: DriveImage, deadband: Mapping[str, float], longest_silence: float) -> None:
        self._image = image
        self._longest_silence = longest_silence
        self._said: dict[str, _Said] = {}
        self._deadband = {
            name: Decimal(str(band))
            for name, band in {**deadband, **image.drive.deadband}.items()
            if name in image.names and not has_text(image, name)
        }

    def is_due(self, name: str, sample: Sample, now: float) -> bool:
        """Say whether a reading is to be published."""
        said = self._said.get(name)
        if said is None or said.quality is not sample.quality:
            return True
        if sample.quality is not Quality.GOOD:
            return False
        return now - said.at >= self._longest_silence or self._has_moved(name, said.word, sample.word)

    def has_turned(self, name: str, quality: Quality) -> bool:
        """Say whether the quality is another than the one that was published."""
        said = self._said.get(name)
        return said is None or said.quality is not quality

    def _has_moved(self, name: str, said: int, word: int) -> bool:
        if word == said:
            return False
        band = self._deadband.get(name)
        if band is None:
            return True
        return abs(self._image.number(name, word) - self._image.number(name, said)) > band

    def note(self, name: str, sample: Sample, now: float) -> None:
        """Remember a value as published."""
        self._said[name] = _Said(sample.word, sample.quality, now)
