"""Takes what controllers send to the door: a stop at once, everything else in its turn (SAFETY.md H24).

Pure. A stop takes what waits for its drive along, which the door then ends in its favour. All else waits in a bounded
inbox, and a flood of what is refused is told of in part only.
"""

from __future__ import annotations

from collections import defaultdict
from functools import partial

from gateway.clock import Clock
from gateway.control.command import Answer, Command, Reason, Result
from gateway.control.door import Door
from gateway.control.results import Results
from gateway.metrics import MqttStats
from gateway.mqtt.commands import Read
from gateway.mqtt.inbox import Allowance, Inbox, Waiting
from gateway.mqtt.message import Beat, LineStop

REFUSALS = 50.0  # a second that are answered; more are counted only
REFUSALS_AT_ONCE = 100.0
TEXTS = {
    Reason.SUPERSEDED: "a newer value came before it was sent",
    Reason.BUSY: "too many commands at once for this drive",
}


class Intake:
    """The way from what was read to the door."""

    def __init__(self, door: Door, stats: MqttStats, clock: Clock) -> None:
        self._door = door
        self._stats = stats
        self._clock = clock
        self._inbox = Inbox()
        self._superseded: defaultdict[str, Results] = defaultdict(Results)
        self._refusals = Allowance(REFUSALS, REFUSALS_AT_ONCE)

    @property
    def is_waiting(self) -> bool:
        """Say whether a command waits to be handed on."""
        return len(self._inbox) > 0

    def take(self, read: Read, answer: Answer) -> None:
        """Take what was read; `answer` is told what becomes of a command."""
        match read:
            case Beat(drive, source, beat):
                self._door.beat(drive, source, beat)
            case LineStop(line, command):
                self._stop_line(line, Waiting(command, answer))
            case Command():
                self._take(Waiting(read, answer))
            case Result():
                self._refuse(Waiting(read.command, answer), read)

    def _take(self, waiting: Waiting) -> None:
        """Hand a stop on at once, and let anything else wait for its turn."""
        command = waiting.command
        control = self._door.controls.get(command.drive)
        if control is None:
            self._turn_away(waiting)
        elif control.state.admission.is_stop(command):
            self._hand_over_all(command.drive)
            self._door.submit(command, waiting.answer)
        elif not self._superseded[command.drive].is_known(command, partial(self._refuse, waiting)):
            displaced = self._inbox.put(waiting)
            if displaced is not None:
                self._displace(*displaced)

    def _turn_away(self, waiting: Waiting) -> None:
        """Let the door say why nobody may command this drive, but not for ever."""
        if self._refusals.take(self._clock.now()):
            self._door.submit(waiting.command, waiting.answer)
        else:
            self._stats.refused[Reason.UNKNOWN_DRIVE.value] += 1
            self._stats.untold += 1

    def _displace(self, waiting: Waiting, reason: Reason) -> None:
        """Refuse what found no room, or a setpoint that is history: if it comes again it is still refused."""
        self._stats.inbox_dropped += 1
        result = waiting.refused(reason, TEXTS[reason])
        if reason is Reason.SUPERSEDED:
            known = self._superseded[waiting.command.drive]
            known.remembering(waiting.command, _nobody)(result)
        self._refuse(waiting, result)

    def _refuse(self, waiting: Waiting, result: Result) -> None:
        """Say that a command is refused before it came to the door; a flood is told of in part only."""
        self._stats.refused[result.reason.value] += 1
        if self._refusals.take(self._clock.now()):
            waiting.answer(result)
            self._door.tell_result(result)
        else:
            self._stats.untold += 1

    def _stop_line(self, line: str, waiting: Waiting) -> None:
        for drive in self._door.lines.get(line, ()):
            self._hand_over_all(drive)
        command = waiting.command
        self._door.stop_line(line, command.verb, command.source, waiting.answer, command.id)

    def _hand_over_all(self, drive: str) -> None:
        """Hand on what waits for a drive, so that the door can end it in favour of a stop (SAFETY.md H10)."""
        for waiting in self._inbox.take_all(drive):
            self._door.submit(waiting.command, waiting.answer)

    def hand_over(self, most: int) -> bool:
        """Hand on that many commands; say whether more wait."""
        for _ in range(most):
            waiting = self._inbox.take()
            if waiting is None:
                return False
            self._door.submit(waiting.command, waiting.answer)
        return self.is_waiting


def _nobody(_result: Result) -> None:
    """Tell nobody."""
