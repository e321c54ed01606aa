"""What the commanded drives of one line want next: stops, then drives whose F803 would run out, then other commands.

Pure: the worker carries out what is said here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from gateway.bus.keepalive import BROADCASTS_AHEAD, Keepalive
from gateway.control.drive_control import DriveControl
from gateway.control.state import Errand
from gateway.protocol.codec import Codec, NoSuchForm
from gateway.protocol.pdu import WriteRam

FRAMES_IN_A_ROW = 2  # of commands, a write and its read-back, behind which a poll that is overdue goes first
SOON = 0.2  # seconds behind a command, beyond which no shorter deadline of another drive's goes ahead of it


@dataclass(frozen=True, slots=True)
class Broadcast:
    """A command word for every drive of the line that speaks a protocol; nobody answers."""

    codec: Codec
    request: WriteRam


@dataclass(frozen=True, slots=True)
class Commanded:
    """A frame for one drive."""

    drive: str
    errand: Errand


@dataclass(slots=True)
class LineControls:
    """The controls of one line, and the deadlines of their communication time-outs. Times are monotonic seconds."""

    controls: Mapping[str, DriveControl]
    keepalive: Keepalive
    _broadcasts: list[Broadcast] = field(default_factory=list)
    _last_stopped: str = ""
    _last_served: str = ""
    _was_command: bool = False  # and not a look

    def tick(self, now: float) -> None:
        """Let every control see the time."""
        for control in self.controls.values():
            control.tick(now)

    def next_time(self) -> float:
        """Return when something has to be looked at again at the latest."""
        times = [control.next_time() for control in self.controls.values()]
        return min([*times, self.keepalive.next_time()], default=float("inf"))

    def announce(self, codec: Codec, request: WriteRam) -> bool:
        """Let a broadcast go ahead of everything; False where the protocol has none."""
        try:
            codec.encode(request)
        except NoSuchForm:
            return False
        if Broadcast(codec, request) not in self._broadcasts:
            self._broadcasts.append(Broadcast(codec, request))
        return True

    def drop_broadcasts(self) -> None:
        """Send none of them any more: the line is down, and they would be old when it is back (SAFETY.md H11)."""
        self._broadcasts.clear()

    def watch(self, drive: str) -> float:
        """Watch over the drive's F803 as it is known now, or leave it to itself; return its seconds."""
        control = self.controls[drive]
        is_watched = control.state.is_online and not control.is_quiet and not control.is_exclusive
        timeout = control.state.shortest_timeout if is_watched else 0.0
        self.keepalive.arm(drive, timeout)
        return timeout

    def next_broadcast(self, now: float) -> Broadcast | None:
        """Return the broadcast that is to go now; none while a drive has to be left alone."""
        if any(control.is_quiet for control in self.controls.values()):
            self._broadcasts.clear()
        if not self._broadcasts:
            return None
        who = self._broadcasts[0].codec.name
        if not self.keepalive.goes_ahead(who, now, BROADCASTS_AHEAD):
            return None
        self.keepalive.went_ahead(who, now)
        return self._broadcasts.pop(0)

    def next_stop(self, now: float) -> Commanded | None:
        """Return the frame of a stop, of each drive in turn."""
        stopped = [name for name, control in self.controls.items() if control.has_stop]
        for name in _after(stopped, self._last_stopped):
            if not self.keepalive.goes_ahead(name, now):
                continue
            errand = self.controls[name].errands.next(now)
            if errand is not None:
                self._last_stopped = name
                self.keepalive.went_ahead(name, now)
                return Commanded(name, errand)
        return None

    def next_due(self, now: float) -> str | None:
        """Return the drive that has to be talked to now, whatever it is about."""
        return self.keepalive.due(now)

    def next_of(self, drive: str, now: float) -> Commanded | None:
        """Return what one drive wants."""
        errand = self.controls[drive].errands.next(now)
        return Commanded(drive, errand) if errand is not None else None

    def next_command(self, now: float) -> Commanded | None:
        """Return the next frame of any command, the one with the earliest deadline first; of equal ones in turn.

        A deadline counts as no later than `SOON` behind the command: shorter ones without end put none off for ever.
        Looks at drives that nobody commands just now have their turn behind each frame of a command.
        """
        turns = _after(list(self.controls), self._last_served)
        commanded = sorted((name for name in turns if self.controls[name].has_command), key=self._urgency)
        looked_at = [name for name in turns if not self.controls[name].has_command]
        for name in (*looked_at, *commanded) if self._was_command else (*commanded, *looked_at):
            errand = self.controls[name].errands.next(now)
            if errand is not None:
                self._last_served, self._was_command = name, name in commanded
                return Commanded(name, errand)
        return None

    def _urgency(self, drive: str) -> tuple[float, bool, float]:
        return self.controls[drive].urgency(SOON)


def _after(names: Sequence[str], last: str) -> list[str]:
    """Return names in turn, beginning behind the last one served."""
    place = names.index(last) + 1 if last in names else 0
    return [*names[place:], *names[:place]]
