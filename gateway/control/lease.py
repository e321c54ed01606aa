"""The permission to command one drive: held by one source, kept alive by that source itself (SAFETY.md H04, H05)."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.control.command import Source


@dataclass(slots=True)
class Lease:
    """The lease of one drive. Times are monotonic seconds; `duration` is how long it lasts without a sign of life.

    A heartbeat counts only when it has changed: a retained or repeated one is no sign of life, and the first one
    after taking has nothing to differ from.
    """

    duration: float
    owner: Source | None = None
    until: float = 0.0
    _beat: object = None

    def is_held(self, now: float) -> bool:
        """Say whether somebody may command now."""
        return self.owner is not None and now < self.until

    def is_over(self, now: float) -> bool:
        """Say whether it was held and ran out: the loss is still to be dealt with."""
        return self.owner is not None and now >= self.until

    def take(self, source: Source, now: float) -> bool:
        """Give it to a source, or renew it; False where another holds it, or it has just run out."""
        if self.is_over(now) or self.owner not in (None, source):
            return False
        if self.owner is None:
            self._beat, self.until = None, now
        self.owner, self.until = source, max(self.until, now + self.duration)
        return True

    def renew(self, now: float) -> None:
        """Take a command of the owner as a sign of life; what has ended stays ended."""
        if self.is_held(now):
            self.until = max(self.until, now + self.duration)

    def beat(self, source: Source, beat: object, now: float) -> bool:
        """Take a heartbeat: a changed one of the owner renews; say whether it did."""
        if source != self.owner or not self.is_held(now):
            return False
        before, self._beat = self._beat, beat
        if before is None or before == beat:
            return False
        self.until = max(self.until, now + self.duration)
        return True

    def end(self) -> None:
        """End it: it was given back, or its loss is being dealt with."""
        self.owner, self._beat = None, None
