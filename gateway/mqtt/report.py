"""Decides which readings are worth publishing: what changed, and what has been silent for long."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from decimal import Decimal

from gateway.drives.scaling import WORD, Scaling
from gateway.image import DriveImage, Quality
from gateway.mqtt.filters import Policy

Moved = Callable[[int, int], bool]
"""Says whether a change from one word to another is worth telling."""


class Said:
    """What was published last of one value, and when; and how often it may be published."""

    __slots__ = ("_held", "_longest", "_moved", "_soonest", "at", "name", "quality", "word")

    def __init__(self, name: str, policy: Policy, moved: Moved | None, held: dict[str, Said]) -> None:
        self.name = name
        self.word = 0
        self.quality: Quality | None = None  # as long as it has never been published
        self.at = 0.0  # monotonic seconds
        self._longest = policy.max_interval
        self._soonest = policy.soonest
        self._moved = moved  # None: every change is worth telling
        self._held = held  # those that have to wait, of all values of the drive

    def is_due(self, word: int, quality: Quality, now: float) -> bool:
        """Say whether a reading is to be published."""
        if quality is not self.quality:
            return True
        if quality is not Quality.GOOD:
            return False
        since = now - self.at
        if since >= self._longest:
            return True
        if word == self.word or (self._moved is not None and not self._moved(self.word, word)):
            if self._held:
                self._held.pop(self.name, None)
            return False
        if since < self._soonest:
            self._held[self.name] = self
            return False
        return True

    def is_released(self, now: float) -> bool:
        """Say whether it need not wait any longer."""
        return now - self.at >= self._soonest

    def note(self, word: int, quality: Quality, now: float) -> None:
        """Remember the value as published."""
        if self._held:
            self._held.pop(self.name, None)
        self.word, self.quality, self.at = word, quality, now


class Report:
    """Report by exception for the values of one drive.

    A value is due when it has never been said, when its quality changed, when it moved by more than its deadband and
    was not said just now, or when it is read long after it was said. What has to wait for its turn is held, and
    released when its time has come, as it is then.
    """

    def __init__(self, image: DriveImage, policies: Mapping[str, Policy]) -> None:
        self._held: dict[str, Said] = {}
        self.values = {
            name: Said(name, policy, _moved(image, name, policy), self._held) for name, policy in policies.items()
        }

    def released(self, now: float) -> list[str]:
        """Return the values that were held and need not wait any longer; most often none."""
        return [name for name, said in self._held.items() if said.is_released(now)] if self._held else []


def _moved(image: DriveImage, name: str, policy: Policy) -> Moved | None:
    """Return what tells a change by a policy from one that is none; None where every change is one."""
    if not policy.band and not policy.share:
        return None
    if not policy.share and name in image.points:
        return _counted(image.points[name].register.scaling, policy.band)
    return lambda before, after: policy.has_moved(image.number(name, before), image.number(name, after))


def _counted(scaling: Scaling, band: Decimal) -> Moved:
    """Return what compares two words in counts: the same as in the value's unit, at a fraction of the cost."""
    counts = int(min(band / scaling.scale, Decimal(WORD)))
    if not scaling.signed:
        return lambda before, after: abs(after - before) > counts
    return lambda before, after: abs(scaling.raw(after) - scaling.raw(before)) > counts
