"""Commands that wait to be handed on: few for each drive, in turn, and of a setpoint only the newest.

Pure. Order is kept but for setpoints: a newer one takes the place of an older one, unless another command came in
between. What finds no room is refused, so that a flood costs neither memory nor the drives that it is not for.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from gateway.control.command import Answer, Command, Reason, Result, Source, Status, Verb
from gateway.control.composing import COMMAND

MOST = 16  # commands of one drive
SETPOINTS = (Verb.FREQUENCY, Verb.SPEED, Verb.ANALOG, Verb.TERMINALS, Verb.SET)  # of which only the newest matters


@dataclass(frozen=True, slots=True)
class Waiting:
    """A command, and who is to be told what became of it."""

    command: Command
    answer: Answer

    def refused(self, reason: Reason, text: str) -> Result:
        """Return the result of a command that is not handed on."""
        return Result(self.command, Status.REFUSED, reason, text)


@dataclass(slots=True)
class Inbox:
    """The commands that wait, by drive; the drives take turns."""

    _queues: dict[str, deque[Waiting]] = field(default_factory=dict)

    def __len__(self) -> int:
        return sum(map(len, self._queues.values()))

    def put(self, waiting: Waiting) -> tuple[Waiting, Reason] | None:
        """Take a command; return what must be refused for it, an older setpoint or itself, and why."""
        queue = self._queues.setdefault(waiting.command.drive, deque())
        place = _place_of_older(queue, waiting.command)
        if place is not None:
            older, queue[place] = queue[place], waiting
            return older, Reason.SUPERSEDED
        if len(queue) >= MOST:
            return waiting, Reason.BUSY
        queue.append(waiting)
        return None

    def take(self) -> Waiting | None:
        """Return the next command; None where none waits."""
        if not self._queues:
            return None
        drive = next(iter(self._queues))
        queue = self._queues.pop(drive)
        waiting = queue.popleft()
        if queue:
            self._queues[drive] = queue  # behind the other drives
        return waiting

    def take_all(self, drive: str) -> deque[Waiting]:
        """Return all that waits for a drive, in order."""
        return self._queues.pop(drive, deque())


def _place_of_older(queue: deque[Waiting], command: Command) -> int | None:
    """Return the place of the setpoint that a newer one replaces, where no other command came in between."""
    wanted = _setpoint(command)
    if wanted is None:
        return None
    for place in reversed(range(len(queue))):
        other = queue[place].command
        if _setpoint(other) is None:
            return None
        if _setpoint(other) == wanted:
            is_repetition = other.id == command.id != ""
            return None if is_repetition else place
    return None


def _setpoint(command: Command) -> tuple[Verb, str, Source] | None:
    """Return what a command sets, and who; None where it is more than a setpoint, as the command word is."""
    is_setpoint = command.verb in SETPOINTS and not (command.verb is Verb.SET and command.name == COMMAND)
    return (command.verb, command.name, command.source) if is_setpoint else None


@dataclass(slots=True)
class Allowance:
    """So many a second, and so many at once; times are monotonic seconds."""

    rate: float
    most: float
    _left: float = field(init=False)
    _since: float | None = None

    def __post_init__(self) -> None:
        self._left = self.most

    def take(self, now: float) -> bool:
        """Take one; False where none is left."""
        if self._since is not None:
            self._left = min(self.most, self._left + (now - self._since) * self.rate)
        self._since = now
        if self._left < 1:
            return False
        self._left -= 1
        return True
