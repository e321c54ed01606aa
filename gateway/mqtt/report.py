"""Decides which readings are worth publishing: what changed, and what has been silent for long."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.image import DriveImage, Quality, Sample
from gateway.mqtt.filters import Policy


@dataclass(slots=True)
class _Said:
    """What was published last of a value, and when."""

    word: int
    quality: Quality
    at: float


class Report:
    """Report by exception for the values of one drive.

    A value is due when it has never been said, when its quality changed, when it moved by more than its deadband and
    was not said just now, or when it is read long after it was said. What has to wait for its turn is held, and
    released when its time has come, as it is then.
    """

    def __init__(self, image: DriveImage, policies: Mapping[str, Policy]) -> None:
        self._image = image
        self._policies = policies
        self._said: dict[str, _Said] = {}
        self._held: dict[str, None] = {}

    def is_due(self, name: str, sample: Sample, now: float) -> bool:
        """Say whether a reading is to be published."""
        said = self._said.get(name)
        if said is None or said.quality is not sample.quality:
            return True
        if sample.quality is not Quality.GOOD:
            return False
        policy, since = self._policies[name], now - said.at
        if policy.is_long_ago(since):
            return True
        if not self._has_moved(name, said.word, sample.word):
            self._held.pop(name, None)
            return False
        if policy.is_too_soon(since):
            self._held[name] = None
            return False
        return True

    def has_turned(self, name: str, quality: Quality) -> bool:
        """Say whether the quality is another than the one that was published."""
        said = self._said.get(name)
        return said is None or said.quality is not quality

    def _has_moved(self, name: str, said: int, word: int) -> bool:
        if word == said:
            return False
        policy = self._policies[name]
        if not policy.band and not policy.share:
            return True
        return policy.has_moved(self._image.number(name, said), self._image.number(name, word))

    def released(self, now: float) -> list[str]:
        """Return the values that were held and need not wait any longer; most often none."""
        if not self._held:
            return []
        return [name for name in self._held if not self._policies[name].is_too_soon(now - self._said[name].at)]

    def note(self, name: str, sample: Sample, now: float) -> None:
        """Remember a value as published."""
        self._held.pop(name, None)
        self._said[name] = _Said(sample.word, sample.quality, now)
