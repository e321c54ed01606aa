"""Decides how long to wait before the next try to connect."""

from __future__ import annotations

import random


class Backoff:
    """Pauses between `least` and `most` seconds that grow, by chance, so that not all clients come back at once."""

    def __init__(self, least: float, most: float, chance: random.Random) -> None:
        self._least = min(least, most)
        self._most = most
        self._chance = chance
        self._ceiling = self._least

    def next(self) -> float:
        """Return the next pause: at least half of a ceiling that doubles each time."""
        self._ceiling = min(self._most, 2 * self._ceiling)
        return self._chance.uniform(max(self._least, self._ceiling / 2), self._ceiling)

    def reset(self) -> None:
        """Begin with short pauses again."""
        self._ceiling = self._least
