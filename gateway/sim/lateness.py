"""How late the simulation itself was: what the instrument adds to what it measures."""

from __future__ import annotations

from collections import deque

KEPT = 10_000  # latest measurements that the percentile is taken from


class Lateness:
    """Collects by how many seconds bytes left later than they should have."""

    def __init__(self) -> None:
        self._latest: deque[float] = deque(maxlen=KEPT)
        self.maximum = 0.0

    def add(self, seconds: float) -> None:
        """Count one delivery."""
        self._latest.append(seconds)
        self.maximum = max(self.maximum, seconds)

    def percentile(self, share: float) -> float:
        """Return what that share of the latest deliveries stayed below; 0 where there are none."""
        ordered = sorted(self._latest)
        return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else 0.0
