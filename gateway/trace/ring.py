"""The latest exchanges of all lines, in memory: what is left is what was before a fault."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from gateway.trace.record import Told, cost

MOST_BYTES = 2_000_000  # of frames, whatever their number


class Ring:
    """Keeps the latest frames, bounded in their number and their bytes; 0 frames: keeps none."""

    def __init__(self, most_frames: int, most_bytes: int = MOST_BYTES) -> None:
        self._most = (most_frames, most_bytes)
        self._kept: deque[tuple[str, Told]] = deque()
        self._frames = 0
        self._bytes = 0

    def add(self, line: str, told: Told) -> None:
        """Keep what a line told; the oldest goes where there is too much."""
        self._kept.append((line, told))
        frames, size = cost(told)
        self._frames += frames
        self._bytes += size
        most_frames, most_bytes = self._most
        while self._kept and (self._frames > most_frames or self._bytes > most_bytes):
            frames, size = cost(self._kept.popleft()[1])
            self._frames -= frames
            self._bytes -= size

    def all(self) -> Sequence[tuple[str, Told]]:
        """Return what is kept, the oldest first, each with its line."""
        return tuple(self._kept)
