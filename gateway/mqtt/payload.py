"""Says how values, qualities and times are spelt in payloads."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from datetime import UTC, datetime
from functools import lru_cache, partial

from gateway.image import DriveImage, Quality
from gateway.mqtt.topics import has_text

ONLINE = "online"
OFFLINE = "offline"
NOTHING = ""  # the payload that makes a broker forget what it retains on a topic
NO_BITS = "none"  # a bit field without a set bit, in words

RESERVED_KEYS = frozenset({"time", "quality", "tripped", "reset_needed"})
TRUTH = {True: "true", False: "false", None: NOTHING}
WORDS = {quality: quality.word for quality in Quality}
KEPT_SECONDS = 16  # whose text is not made anew each time
MICROSECONDS, IN_MILLISECOND = 1_000_000, 1000
NO_WORD = -1


def presence(is_there: bool) -> str:
    """Return "online" or "offline"."""
    return ONLINE if is_there else OFFLINE


class Spelling:
    """How the words of one value are spelt, found once."""

    __slots__ = ("_text", "number")

    def __init__(self, image: DriveImage, name: str) -> None:
        point = image.points.get(name)
        # the image holds defined bits alone, so that the register's mask need not be asked
        self.number: Callable[[int], str] = point.register.scaling.format if point else partial(image.show, name)
        self._text = partial(image.text, name)

    def value(self, word: int, quality: Quality) -> str:
        """Return the engineering value as text, "60.00"; nothing where it is not good."""
        return self.number(word) if quality is Quality.GOOD else NOTHING

    def text(self, word: int, quality: Quality) -> str:
        """Return the words of a bit field or a code; nothing where it is not good."""
        return self.words(word) if quality is Quality.GOOD else NOTHING

    def words(self, word: int) -> str:
        """Return the words of a bit field or a code that is good."""
        return self._text(word) or NO_BITS


def left_behind(quality: Quality) -> Quality:
    """Return what a quality is to others once the gateway has gone: whatever was read is offline."""
    return max(quality, Quality.OFFLINE)


def timestamp(wall: float) -> str:
    """Return UTC seconds as ISO 8601 with milliseconds: "2026-03-01T12:00:00.250Z"."""
    second = math.floor(wall)
    microsecond = round((wall - second) * MICROSECONDS)
    if microsecond == MICROSECONDS:
        second, microsecond = second + 1, 0
    return f"{_second(second)}.{microsecond // IN_MILLISECOND:03d}Z"


@lru_cache(KEPT_SECONDS)
def _second(wall: int) -> str:
    """Return whole UTC seconds up to their point: readings of the same second share all but the milliseconds."""
    return datetime.fromtimestamp(wall, UTC).isoformat(timespec="seconds").removesuffix("+00:00")


def key(name: str) -> str:
    """Return the key of a value in the JSON state; a name that is taken gets "_value" behind it."""
    return f"{name}_value" if name in RESERVED_KEYS else name


class StateWriter:
    """Writes the JSON state of one drive: a flat object of all values, with `time` and `quality`.

    A value's part is made anew only when the value has changed, so that a state costs little per answer.
    """

    def __init__(self, image: DriveImage) -> None:
        self._image = image
        self._read = [_Part(image, name) for name in image.points]
        self._derived = [_Part(image, name) for name in image.derived]

    def write(self, now: float, *, is_leaving: bool = False) -> str:
        """Return the state as it is now, or as it is for others once the gateway has gone."""
        if self._image.is_fresh(now) and not is_leaving:
            worst, parts = self._fresh()
        else:
            worst, parts = self._each(now, is_leaving=is_leaving)
        newest = self._image.newest_wall
        time = f'"{timestamp(newest)}"' if newest else "null"
        tripped = (None if is_leaving else TRUTH[self._image.is_tripped]) or "null"
        needed = TRUTH[self._image.is_reset_needed]
        head = f'"time":{time},"quality":"{WORDS[worst]}","tripped":{tripped},"reset_needed":{needed}'
        return f"{{{head},{','.join(parts)}}}"

    def _fresh(self) -> tuple[Quality, list[str]]:
        """Return the worst quality and all parts where every register is good, as nearly always."""
        worst, parts, bases = Quality.GOOD, [part.good() for part in self._read], self._image.bases
        for part in self._derived:
            if part.base in bases:
                parts.append(part.good())
            else:
                parts.append(part.nothing)
                worst = Quality.NEVER_READ
        return worst, parts

    def _each(self, now: float, *, is_leaving: bool) -> tuple[Quality, list[str]]:
        """Return the worst quality and all parts, null where they are not good: never an old number as if new."""
        every = (*self._read, *self._derived)
        qualities = [self._image.quality_of(part.place, now) for part in every]
        if is_leaving:
            qualities = [left_behind(quality) for quality in qualities]
        of_each = zip(every, qualities, strict=True)
        return max(qualities), [part.good() if quality is Quality.GOOD else part.nothing for part, quality in of_each]


class _Part:
    """The part of a state that is one value: its number, and its words where a number does not say all."""

    __slots__ = ("_image", "_key", "_rated", "_spelling", "_text", "_text_key", "_word", "base", "nothing", "place")

    def __init__(self, image: DriveImage, name: str) -> None:
        self.place = image.places[name]
        self._image = image
        self.base = self.place.base
        self._key = json.dumps(key(name))
        self._text_key = json.dumps(f"{key(name)}_text") if has_text(image, name) else ""
        self.nothing = f"{self._key}:null,{self._text_key}:null" if self._text_key else f"{self._key}:null"
        self._spelling = Spelling(image, name)
        self._word = NO_WORD  # of which the text below is made
        self._rated: object = None
        self._text = ""

    def good(self) -> str:
        """Return it as it is, where it is good."""
        place = self.place
        word = place.numbers[place.offset]
        if word != self._word or (self.base is not None and self._image.bases[self.base] != self._rated):
            self._make(word)
        return self._text

    def _make(self, word: int) -> None:
        self._word = word
        if self.base is not None:
            self._rated = self._image.bases[self.base]
        self._text = f"{self._key}:{self._spelling.number(word)}"
        if self._text_key:
            words = json.dumps(self._spelling.words(word), ensure_ascii=False)
            self._text += f",{self._text_key}:{words}"
