"""When a drive's communication timer runs out: F803 from one acknowledged message to the next (E6581657 6.3)."""

from __future__ import annotations


class CommunicationTimer:
    """The timer of F803. Setting it waits for the next message; that and every later one starts it anew."""

    def __init__(self) -> None:
        self._period = 0.0
        self._started: float | None = None
        self.least_margin: float | None = None  # seconds that were left, when least were

    def set(self, period: float) -> None:
        """Take a new F803 in seconds, 0 for off; the timer stands until the next acknowledged message."""
        self._period = period
        self._started = None
        self.least_margin = None

    def acknowledge(self, now: float) -> None:
        """Start anew: a message to this drive was acknowledged, whatever it said."""
        if self.deadline is not None:
            margin = max(0.0, self.deadline - now)
            self.least_margin = margin if self.least_margin is None else min(self.least_margin, margin)
        self._started = now

    @property
    def deadline(self) -> float | None:
        """Return when the time is out; None while the timer is off or stands."""
        if self._period <= 0 or self._started is None:
            return None
        return self._started + self._period
