"""Decides when what is in the ring is worth a file: after a fault, not too often, with what followed it."""

from __future__ import annotations

from collections import deque

from gateway.image import LinkState
from gateway.trace.record import Record, Told, Verdict

FOLLOWING = 2.0  # seconds after a fault that are still to be in the file
BURST = 5  # bad replies ...
BURST_WITHIN = 10.0  # ... in so many seconds
LOST = (LinkState.OFFLINE, LinkState.STRANGER, LinkState.LINE_DOWN)
EVENTS = ("lease_lost", "quiesced")  # of the door: on_loss acts, or a drive is left to its F803


class BadReplies:
    """Finds bursts of bad replies on a line."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=BURST)

    def take(self, told: Told) -> bool:
        """Take what a line told; say whether a burst is full, which begins a new one."""
        if not isinstance(told, Record) or told.verdict is not Verdict.BAD_REPLY:
            return False
        self._times.append(told.done)
        if len(self._times) < BURST or told.done - self._times[0] > BURST_WITHIN:
            return False
        self._times.clear()
        return True


class DriveWatch:
    """Finds faults in what is known of one drive: its link is lost, it trips."""

    def __init__(self) -> None:
        self._was_connected = False
        self._was_sound = False

    def take(self, link: LinkState, is_tripped: bool | None) -> str | None:
        """Take what is known now; return the fault that it is, None where it is none."""
        fault = None
        if link in LOST and self._was_connected:
            fault = link.word.replace("_", " ")
        elif is_tripped and self._was_sound:
            fault = "tripped"
        self._was_connected = link.is_connected
        if is_tripped is not None:
            self._was_sound = not is_tripped
        return fault


class Occasions:
    """Gathers faults into files: one file some time after the first fault, the next not before `pause` seconds."""

    def __init__(self, pause: float) -> None:
        self._pause = pause
        self._next = float("-inf")
        self._reasons: list[str] = []
        self._passed_over = 0
        self.due = float("inf")

    def fault(self, reason: str, now: float) -> None:
        """Take a fault; within the pause after a file it is only counted."""
        if self._reasons:
            self._reasons.append(reason)
        elif now < self._next:
            self._passed_over += 1
        else:
            self._reasons.append(reason)
            self.due = now + FOLLOWING

    def take(self, now: float) -> str | None:
        """Return why a file is to be written now; None where none is."""
        if now < self.due:
            return None
        reasons = list(dict.fromkeys(self._reasons))
        text = "; ".join(reasons[:10]) + (f"; and {len(reasons) - 10} more" if len(reasons) > 10 else "")
        if self._passed_over:
            text += f" (since the file before: {self._passed_over} faults without a file)"
        self._reasons, self._passed_over = [], 0
        self.due, self._next = float("inf"), now + self._pause
        return text
