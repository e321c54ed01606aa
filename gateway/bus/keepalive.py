"""Which drive has to be talked to now, so that its communication time-out F803 does not run out (SAFETY.md H06, H30).

A keepalive is no task but a deadline: every good exchange pushes it on by a third of F803. Where polls and commands
keep ahead of it, nothing is ever due here. `lead` is how long a good exchange may take to be had when much happens
at once (`refresh.worst_case`): a drive falls due that long before its deadline, and then goes first.

    due(now)        the drive whose exchange is to begin now: a short read, or a command that waits for it anyway
    heard, missed   what came of each exchange with any drive, whoever asked for it
    goes_ahead      whether a stop may go before what is due; `went_ahead` after each frame of a stop, and broadcast
    lets_through    whether anything else may; `let_through` before each exchange that is neither stop nor keepalive

Premise: within one lead at most ONE exchange of the line is lost beside the one that is under way: a frame spoilt by
noise, or a neighbour that has just died. One drive is stopped by itself; whoever stops all has the broadcast.

Why it holds: of what is let through, one exchange at most is under way when a drive falls due, or begins until its
turn. No other drive has two deadlines within one lead, so each has one turn before it. One turn may be lost, one stop
and the broadcasts go ahead. Then its own turn ends within the lead: the reckoning adds up just these.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

PER_TIMEOUT = 3  # good exchanges in one F803
TRIES = 2  # exchanges that a drive may lose in a row before it no longer goes ahead: it may be dead
STOPS_AHEAD = 1  # of one drive within a lead: the stop itself; read-back and repetitions take their turn
BROADCASTS_AHEAD = 1  # of one protocol within a lead


@dataclass(slots=True)
class Keepalive:
    """The deadlines of the armed drives of one line. Times are monotonic seconds, `lead` is in seconds."""

    lead: float
    _timeouts: dict[str, float] = field(default_factory=dict)
    _heard: dict[str, float] = field(default_factory=dict)
    _missed: dict[str, int] = field(default_factory=dict)
    _ahead: dict[str, deque[float]] = field(default_factory=dict)
    _let_through: float = float("-inf")

    def arm(self, drive: str, timeout: float) -> None:
        """Watch over a drive whose F803 is that many seconds, from its last good exchange on; 0 disarms it."""
        if timeout > 0:
            self._timeouts[drive] = timeout
        else:
            self.disarm(drive)

    def disarm(self, drive: str) -> None:
        """Leave a drive to itself: it is offline, or left alone so that its F803 acts, or has none."""
        self._timeouts.pop(drive, None)

    def heard(self, drive: str, now: float) -> None:
        """Take that an exchange with a drive ended well, whether it is armed or not."""
        self._heard[drive] = now
        self._missed.pop(drive, None)

    def missed(self, drive: str) -> None:
        """Take that an exchange with a drive came to nothing."""
        self._missed[drive] = self._missed.get(drive, 0) + 1

    def due(self, now: float) -> str | None:
        """Return the armed drive that is to be talked to now, the earliest deadline first; None where none is.

        A drive that has lost two exchanges in a row is left to the schedule until it is heard again. One whose
        F803 cannot be kept goes behind those whose can.
        """
        ready = [drive for drive in self._timeouts if self._falls_due(drive) <= now]
        return min(ready, key=lambda drive: (not self.is_kept(drive), self._deadline(drive)), default=None)

    def next_time(self) -> float:
        """Return when a drive falls due next, or fell due; infinite where none will."""
        return min(map(self._falls_due, self._timeouts), default=float("inf"))

    def is_kept(self, drive: str) -> bool:
        """Say whether the F803 of an armed drive can be kept whatever the line is doing."""
        return self._interval(drive) >= self.lead

    def margin(self, drive: str, now: float) -> float:
        """Return how many seconds of its F803 an armed drive has left; infinite where it is not armed."""
        if drive not in self._timeouts:
            return float("inf")
        return self._timeouts[drive] - (now - self._heard.get(drive, now))

    def _interval(self, drive: str) -> float:
        return self._timeouts[drive] / PER_TIMEOUT

    def _deadline(self, drive: str) -> float:
        """Return when the next good exchange is to be over; one that was never heard comes before all others."""
        return self._heard.get(drive, float("-inf")) + self._interval(drive)

    def _falls_due(self, drive: str) -> float:
        """Return when a drive goes first; an F803 that cannot be kept gets half its interval, not the whole line."""
        if self._missed.get(drive, 0) >= TRIES:
            return float("inf")
        return self._deadline(drive) - (self.lead if self.is_kept(drive) else self._interval(drive) / 2)

    def goes_ahead(self, who: str, now: float, at_most: int = STOPS_AHEAD) -> bool:
        """Say whether a frame of a stop goes before what is due, so that a flood of stops trips no other drive.

        `who` is the drive, or the protocol of a broadcast (`BROADCASTS_AHEAD`).
        """
        return self.due(now) in (None, who) or len(self._lately(who, now)) < at_most

    def went_ahead(self, who: str, now: float) -> None:
        """Take note that a frame of a stop, or a broadcast, begins."""
        self._lately(who, now).append(now)

    def lets_through(self, now: float) -> bool:
        """Say whether a poll, a probe or any command may begin: nothing is due, or none began within the last lead.

        So drives that are due without end leave the others one exchange in each lead.
        """
        return self.due(now) is None or self._let_through + self.lead <= now

    def let_through(self, now: float) -> None:
        """Take note that such an exchange begins, whether anything is due or not."""
        self._let_through = now

    def _lately(self, who: str, now: float) -> deque[float]:
        """Return when the stops of the last lead began."""
        times = self._ahead.setdefault(who, deque())
        while times and times[0] <= now - self.lead:
            times.popleft()
        return times
