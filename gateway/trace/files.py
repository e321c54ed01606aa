"""Writes captures: all that goes over the lines from the start, or what the ring holds after a fault."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import IO

from gateway.clock import Clock
from gateway.errors import GatewayError
from gateway.trace.capture import Capture
from gateway.trace.frames import Frame, frames
from gateway.trace.meaning import Meaning
from gateway.trace.record import Told

log = logging.getLogger("gateway.trace")

QUEUE = 20_000  # things told that may wait for a slow disk
EVERY = 0.2  # seconds between two writes
LAST_WORDS = 5.0  # seconds that the end of the gateway waits for the disk
AT_ONCE = 5  # things told that are worked on before others are let to the processor: a millisecond
BREATH = 0.001  # seconds
LARGEST = 1 << 30  # bytes of a capture: whoever forgets it shall not fill the disk

Lines = Sequence[tuple[str, Told]]


def frames_of(told: Iterable[tuple[str, Told]], meanings: Mapping[str, Meaning], offset: float) -> list[Frame]:
    """Return the frames of what several lines told, in the order of time."""
    found = (frame for line, one in told for frame in frames(line, one, meanings[line], offset))
    return sorted(found, key=lambda frame: frame.end)


class Recording:
    """A capture of everything, written by a thread of its own: whoever tells never waits for the disk.

    With `is_continued` it goes on behind what the file holds: a new section of the same capture.
    """

    def __init__(self, path: Path, meanings: Mapping[str, Meaning], clock: Clock, *, is_continued: bool) -> None:
        self._meanings = meanings
        self._clock = clock
        self._capture = Capture(list(meanings))
        self._waiting: deque[tuple[str, Told]] = deque()
        self._dropped = 0
        self._is_ending = threading.Event()
        try:
            self._file: IO[bytes] = path.open("ab" if is_continued else "wb", buffering=0)
            self._file.write(self._capture.begin())
        except OSError as error:
            raise GatewayError(f"--trace {path}: {error.strerror}") from error
        self._writer = threading.Thread(target=self._write, name="trace writer", daemon=True)
        self._writer.start()

    def take(self, line: str, told: Told) -> None:
        """Have it written; where too much waits it is dropped and counted."""
        if len(self._waiting) < QUEUE:
            self._waiting.append((line, told))
        else:
            self._dropped += 1

    def close(self) -> None:
        """Write what waits, for a limited time, and end the file."""
        self._is_ending.set()
        self._writer.join(LAST_WORDS)

    def _write(self) -> None:
        try:
            while not self._is_ending.wait(EVERY):
                self._write_waiting()
            self._write_waiting()
        except OSError as error:
            log.warning("the capture of --trace ends here: %s", error.strerror)
        finally:
            self._waiting = deque(maxlen=0)
            self._file.close()

    def _write_waiting(self) -> None:
        offset = self._clock.wall() - self._clock.now()
        while self._waiting:
            batch = [self._waiting.popleft() for _ in range(min(AT_ONCE, len(self._waiting)))]
            self._file.write(self._capture.packets(frames_of(batch, self._meanings, offset)))
            time.sleep(BREATH)
        if self._dropped:
            log.warning("%d exchanges are missing in the capture of --trace: the disk is too slow", self._dropped)
            self._dropped = 0
        if self._file.tell() > LARGEST:
            raise OSError(0, f"it has {LARGEST >> 20} MiB")


def write_ring(
    path: Path, told: Lines, meanings: Mapping[str, Meaning], offset: float, reason: str, breath: float = BREATH
) -> None:
    """Write what the ring held to a file of its own, which appears whole; to be called in a thread."""
    capture = Capture(list(meanings))
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    with part.open("wb") as file:
        file.write(capture.begin(reason))
        for batch in _batches(told):
            file.write(capture.packets(frames_of(batch, meanings, offset)))
            time.sleep(breath)  # the lines are served meanwhile
    part.replace(path)


def _batches(told: Lines) -> Iterator[Lines]:
    left = iter(told)
    while batch := list(islice(left, AT_ONCE)):
        yield batch


def name_of(gateway: str, wall: float) -> str:
    """Return the name of a file that is written at that time (UTC seconds)."""
    stamp = datetime.fromtimestamp(wall, UTC).strftime("%Y%m%dT%H%M%S.%f")[:-3]
    return f"{gateway}-{stamp}Z.pcapng"


def prune(directory: Path, gateway: str, most: int) -> None:
    """Remove the oldest files of a gateway, so that no more than that are left."""
    stamps = "[0-9]" * 8 + "T" + "[0-9]" * 6 + ".[0-9][0-9][0-9]Z.pcapng"
    own = sorted(directory.glob(f"{gateway}-{stamps}"))
    for old in own[: max(0, len(own) - most)]:
        old.unlink(missing_ok=True)
