"""Decides how often each value of a drive may be published, from the settings of all drives and of this one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from fnmatch import fnmatchcase

from gateway.config import FilterSection, MqttSection
from gateway.image import DriveImage
from gateway.mqtt.topics import has_text

NO_BAND = Decimal(0)
EARLY = 0.05  # share of `min_interval` by which a reading may come early: what is read each second is not halved


@dataclass(frozen=True, slots=True)
class Policy:
    """How often one value is published; times in seconds.

    A change counts when it is larger than `band`, in the value's unit, and than `share` of what was published last.
    """

    band: Decimal = NO_BAND
    share: Decimal = NO_BAND
    min_interval: float = 0.0
    max_interval: float = 60.0

    def has_moved(self, before: Decimal, after: Decimal) -> bool:
        """Say whether a change is worth telling."""
        return abs(after - before) > max(self.band, abs(before) * self.share)

    @property
    def soonest(self) -> float:
        """Return for how many seconds after it was published a change has to wait."""
        return self.min_interval * (1 - EARLY)


def policies(section: MqttSection, image: DriveImage) -> Mapping[str, Policy]:
    """Return the policy of each value.

    `mqtt.deadband` is general, filters are finer, the later the more, and the drive's own `deadband` has the last
    word. Bits and codes have no deadband: each of them is something else.
    """
    general = unfiltered(section.deadband, section.longest_silence, image)
    return {name: _policy(section, image, name, policy) for name, policy in general.items()}


def unfiltered(deadband: Mapping[str, float], longest_silence: float, image: DriveImage) -> Mapping[str, Policy]:
    """Return the policy of each value where there are no filters."""
    return {
        name: _for_drive(Policy(_exact(deadband.get(name, 0.0)), max_interval=longest_silence), image, name)
        for name in image.names
    }


def _policy(section: MqttSection, image: DriveImage, name: str, policy: Policy) -> Policy:
    for each in section.filter:
        if applies(each, image.drive.name, name):
            policy = _refined(policy, each)
    return _for_drive(policy, image, name)


def _for_drive(policy: Policy, image: DriveImage, name: str) -> Policy:
    if name in image.drive.deadband:
        policy = replace(policy, band=_exact(image.drive.deadband[name]), share=NO_BAND)
    if has_text(image, name):
        policy = replace(policy, band=NO_BAND, share=NO_BAND)
    if policy.min_interval > policy.max_interval:
        policy = replace(policy, max_interval=policy.min_interval)
    return policy


def applies(section: FilterSection, drive: str, name: str) -> bool:
    """Say whether a filter speaks of this value of this drive."""
    is_drive = any(fnmatchcase(drive, pattern) for pattern in section.drives)
    return is_drive and any(fnmatchcase(name, pattern) for pattern in section.values)


def _refined(policy: Policy, section: FilterSection) -> Policy:
    """Return a policy with what a filter says; what it does not speak of stays. One deadband replaces the other."""
    if section.deadband is not None or section.deadband_percent is not None:
        share = _exact(section.deadband_percent or 0.0) / 100
        policy = replace(policy, band=_exact(section.deadband or 0.0), share=share)
    if section.min_interval is not None:
        policy = replace(policy, min_interval=section.min_interval)
    if section.max_interval is not None:
        policy = replace(policy, max_interval=section.max_interval)
    return policy


def _exact(value: float) -> Decimal:
    """Return the number as it was written."""
    return Decimal(str(value))
