"""A run of consecutive communication numbers: words as they stand on a MODBUS wire, with their times."""

from __future__ import annotations

from struct import Struct

NEVER = float("-inf")


class Segment:
    """Words with the time of their last answer and the time past which they are stale.

    `numbers`, `read_at` and `expires` stay the same lists, so that whoever has a `Place` may look into them.
    `fresh_until` bounds the expiry of every word from below, so that one comparison mostly tells freshness.
    """

    __slots__ = ("_pack", "count", "expires", "fresh_until", "numbers", "read_at", "words")

    def __init__(self, count: int) -> None:
        self.count = count
        self.words = bytes(2 * count)
        self.numbers = [0] * count
        self.read_at = [NEVER] * count
        self.expires = [NEVER] * count
        self.fresh_until = NEVER
        self._pack = Struct(f">{count}H").pack

    def put(self, offset: int, word: int, now: float, expires: float) -> None:
        """Replace one word; it appears in `words` with the others of its answer, when `seal` is called."""
        self.numbers[offset] = word
        self.read_at[offset] = now
        self.expires[offset] = expires
        if expires < self.fresh_until:
            self.fresh_until = expires

    def seal(self) -> None:
        """Let the words that were put appear at once."""
        self.words = self._pack(*self.numbers)

    def end_freshness(self) -> None:
        """Make every word stale."""
        self.expires[:] = [NEVER] * self.count
        self.fresh_until = NEVER

    def is_fresh(self, offset: int, end: int, now: float) -> bool:
        """Say whether none of these words is past its time."""
        if self.fresh_until < now:
            self.fresh_until = min(self.expires)
        return self.fresh_until >= now or min(self.expires[offset:end]) >= now

    def is_read(self) -> bool:
        """Say whether every word has been read at least once."""
        return min(self.read_at) != NEVER


class Place:
    """Where the word of one value stands; found once, so that a reader of many values need not look for each.

    A derived value stands where the register behind it does, and needs the `base` named here.
    """

    __slots__ = ("base", "expires", "mask", "max_age", "name", "numbers", "offset", "read_at", "segment")

    def __init__(
        self, name: str, segment: Segment, offset: int, *, mask: int, max_age: float, base: str | None = None
    ) -> None:
        self.name = name
        self.segment = segment
        self.offset = offset
        self.numbers = segment.numbers
        self.read_at = segment.read_at
        self.expires = segment.expires
        self.mask = mask
        self.max_age = max_age  # seconds
        self.base = base
