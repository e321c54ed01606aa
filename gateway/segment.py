"""A run of consecutive communication numbers: words as they stand on a MODBUS wire, with their times."""

from __future__ import annotations

from array import array

NEVER = float("-inf")


class Segment:
    """Words with the time of their last answer and the time past which they are stale.

    `fresh_until` bounds the expiry of every word from below, so that one comparison mostly tells freshness.
    """

    __slots__ = ("count", "expires", "fresh_until", "read_at", "words")

    def __init__(self, count: int) -> None:
        self.count = count
        self.words = bytes(2 * count)
        self.read_at = array("d", [NEVER] * count)
        self.expires = array("d", [NEVER] * count)
        self.fresh_until = NEVER

    def put(self, offset: int, word: int, now: float, expires: float) -> None:
        """Replace one word."""
        self.words = self.words[: 2 * offset] + word.to_bytes(2, "big") + self.words[2 * offset + 2 :]
        self.read_at[offset] = now
        self.expires[offset] = expires
        self.fresh_until = min(self.fresh_until, expires)

    def end_freshness(self) -> None:
        """Make every word stale."""
        self.expires = array("d", [NEVER] * self.count)
        self.fresh_until = NEVER

    def is_fresh(self, offset: int, end: int, now: float) -> bool:
        """Say whether none of these words is past its time."""
        if self.fresh_until < now:
            self.fresh_until = min(self.expires)
        return self.fresh_until >= now or min(self.expires[offset:end]) >= now

    def is_read(self) -> bool:
        """Say whether every word has been read at least once."""
        return min(self.read_at) != NEVER
