"""Says how values, qualities and times are spelt in payloads."""

from __future__ import annotations

import json
from datetime import UTC, datetime

from gateway.image import DriveImage, Quality, Sample
from gateway.mqtt.topics import has_text

ONLINE = "online"
OFFLINE = "offline"
NOTHING = ""  # the payload that makes a broker forget what it retains on a topic
NO_BITS = "none"  # a bit field without a set bit, in words

RESERVED_KEYS = frozenset({"time", "quality", "tripped", "reset_needed"})
TRUTH = {True: "true", False: "false", None: NOTHING}
WORDS = {quality: quality.word for quality in Quality}


def presence(is_there: bool) -> str:
    """Return "online" or "offline"."""
    return ONLINE if is_there else OFFLINE


def value(image: DriveImage, name: str, sample: Sample) -> str:
    """Return the engineering value as text, "60.00"; nothing where it is not good."""
    return image.show(name, sample.word) if sample.quality is Quality.GOOD else NOTHING


def text(image: DriveImage, name: str, sample: Sample) -> str:
    """Return the words of a bit field or a code; nothing where it is not good."""
    if sample.quality is not Quality.GOOD:
        return NOTHING
    return image.text(name, sample.word) or NO_BITS


def left_behind(sample: Sample) -> Sample:
    """Return what a sample is to others once the gateway has gone: whatever was read is offline."""
    return sample._replace(quality=max(sample.quality, Quality.OFFLINE))


def timestamp(wall: float) -> str:
    """Return UTC seconds as ISO 8601 with milliseconds: "2026-03-01T12:00:00.250Z"."""
    return datetime.fromtimestamp(wall, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def key(name: str) -> str:
    """Return the key of a value in the JSON state; a name that is taken gets "_value" behind it."""
    return f"{name}_value" if name in RESERVED_KEYS else name


class StateWriter:
    """Writes the JSON state of one drive: a flat object of all values, with `time` and `quality`.

    A value's part is made anew only when the value has changed, so that a state costs little per answer.
    """

    def __init__(self, image: DriveImage) -> None:
        self._image = image
        self._parts: dict[str, tuple[object, str]] = {}
        self._keys = {name: _keys(image, name) for name in image.names}

    def write(self, now: float, *, is_leaving: bool = False) -> str:
        """Return the state as it is now, or as it is for others once the gateway has gone."""
        image = self._image
        worst, newest = Quality.GOOD, 0.0
        parts = []
        for name in self._keys:
            sample = image.sample(name, now)
            if is_leaving:
                sample = left_behind(sample)
            word, quality, _, wall = sample
            if quality > worst:
                worst = quality
            if wall > newest:
                newest = wall
            parts.append(self._part(name, word, quality))
        time = f'"{timestamp(newest)}"' if newest else "null"
        tripped = (None if is_leaving else TRUTH[image.is_tripped]) or "null"
        needed = TRUTH[image.is_reset_needed]
        head = f'"time":{time},"quality":"{WORDS[worst]}","tripped":{tripped},"reset_needed":{needed}'
        return f"{{{head},{','.join(parts)}}}"

    def _part(self, name: str, word: int, quality: Quality) -> str:
        derived = self._image.derived.get(name)
        base = derived and self._image.bases.get(derived.base)
        made_of = (word, quality is Quality.GOOD, base)
        known = self._parts.get(name)
        if known is None or known[0] != made_of:
            known = self._parts[name] = (made_of, self._make(name, word, quality))
        return known[1]

    def _make(self, name: str, word: int, quality: Quality) -> str:
        key, text_key = self._keys[name]
        is_good = quality is Quality.GOOD
        part = f"{key}:{self._image.show(name, word) if is_good else 'null'}"
        if not text_key:
            return part
        words = json.dumps(self._image.text(name, word) or NO_BITS, ensure_ascii=False) if is_good else "null"
        return f"{part},{text_key}:{words}"


def _keys(image: DriveImage, name: str) -> tuple[str, str]:
    """Return the keys of a value and of its words as JSON; the second is empty where a number says all."""
    return json.dumps(key(name)), json.dumps(f"{key(name)}_text") if has_text(image, name) else ""
