"""The permission to command one drive: held by one source, kept alive by that source itself (SAFETY.md H04, H05)."""

from __future__ import annotations

from dataclasses import dataclass, field

from gateway.control.command import Source


@dataclass(slots=True)
class Lease:
    """The lease of one drive. Times are monotonic seconds; `duration` is how long it lasts without a sign of life.

    A heartbeat counts only when it has changed: a retained or repeated one is no sign of life.
    """

    duration: float
    owner: Source | None = None
    until: float = 0.0
    _beats: dict[Source, object] = field(default_factory=dict)

    def is_held(self, now: float) -> bool:
        """Say whether somebody may command now."""
        return self.owner is not None and now < self.until

    def is_over(self, now: float) -> bool:
        """Say whether it was held and ran out: the loss is still to be dealt with."""
        return self.owner is not None and now >= self.until

    def may_take(self, source: Source, now: float) -> bool:
        """Say whether a source holds it already, or may take it."""
        return self.owner in (None, source) or not self.is_held(now)

    def take(self, source: Source, now: float) -> bool:
        """Give it to a source, or renew it; False where another source holds it."""
        if self.is_over(now) or not self.may_take(source, now):
            return False
        self.owner, self.until = source, now + self.duration
        return True

    def beat(self, source: Source, beat: object, now: float) -> bool:
        """Take a heartbeat: a changed one of the owner renews; say whether it did."""
        is_first, is_changed = source not in self._beats, self._beats.get(source) != beat
        self._beats[source] = beat
        if is_first or not is_changed or source != self.owner or not self.is_held(now):
            return False
        self.until = now + self.duration
        return True

    def release(self, source: Source) -> bool:
        """Give it back; False where the source does not hold it."""
        if source != self.owner:
            return False
        self.end()
        return True

    def end(self) -> None:
        """End it: the loss is dealt with, or time has jumped (SAFETY.md H23)."""
        self.owner = None
        self._beats.clear()
