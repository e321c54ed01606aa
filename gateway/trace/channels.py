"""The three log channels of a line: points (values), frames (in words), bytes (as they came)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

from gateway import logs
from gateway.image import DriveImage, Image
from gateway.trace.frames import frames
from gateway.trace.meaning import Meaning
from gateway.trace.record import Told
from gateway.trace.text import pieces_of, remark

points_log = logging.getLogger(logs.POINTS)
frames_log = logging.getLogger(logs.FRAMES)
bytes_log = logging.getLogger(logs.BYTES)


class FramesChannel:
    """Logs every frame by its fields: drive, register, value, times, verdict."""

    def __init__(self, meanings: Mapping[str, Meaning]) -> None:
        self._meanings = meanings

    def take(self, line: str, told: Told) -> None:
        """Log the frames of what a line told."""
        for frame in frames(line, told, self._meanings[line], 0.0):
            frames_log.debug("%s %s %s", line, frame.way.value, remark(frame))


def log_bytes(line: str, told: Told) -> None:
    """Log every byte, piece by piece as it came."""
    for text in pieces_of(line, told):
        bytes_log.debug("%s", text)


def log_points(image: Image) -> None:
    """Log every value from now on, as an answer brings it."""
    image.subscribe(_log_values)


def _log_values(image: DriveImage, names: Sequence[str]) -> None:
    for name in names:
        sample = image.sample(name, image.changed_at)
        value = f"{image.show(name, sample.word)} {image.unit(name)}".rstrip()
        points_log.debug("%s %s = %s (%s)", image.drive.name, name, value, sample.quality.word)
