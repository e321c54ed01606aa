"""What the wire knows of a scenario: when something happens next, and how to let it happen."""

from __future__ import annotations

from typing import Protocol


class Script(Protocol):
    """What is to happen to the line by itself."""

    @property
    def next_time(self) -> float | None:
        """Return when something is to happen; None for never."""
        ...

    def play(self, now: float) -> None:
        """Let happen what is due."""
        ...

    def exchange_over(self, now: float) -> None:
        """Note that no exchange is under way, or that the master goes on to the next one."""
        ...
