"""What became of commands by their ids, so that a repeated one acts once (SAFETY.md H03)."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

from gateway.control.command import Answer, Command, Reason, Result, Source, Status, Verb

REMEMBERED = 256  # ids of one drive; the oldest finished ones are forgotten first
REMEMBERED_FOR = 600.0  # seconds, more than any repetition of a message takes
ANSWERS = 16  # that may wait for one command under way


Key = tuple[Source, str, Verb]


def _key(command: Command) -> Key:
    """Return what is the same for a repetition: an id that comes with another verb is a new command."""
    return command.source, command.id, command.verb


@dataclass(slots=True)
class _Known:
    answers: list[Answer]
    received: float
    result: Result | None = None

    def is_over(self, again: Command) -> bool:
        """Say whether the same id is a new command by now: a stop is one as soon as the first has its result."""
        is_old = again.received > self.received + REMEMBERED_FOR
        return self.result is not None and (again.verb.is_stopping or is_old)


@dataclass(slots=True)
class Results:
    """The results of one drive's commands by source and id. A command without an id is never a repetition.

    Nor is a stop whose result was given: stopping twice does no harm, and not stopping does.
    """

    _known: OrderedDict[Key, _Known] = field(default_factory=OrderedDict)

    def is_known(self, command: Command, answer: Answer) -> bool:
        """Say whether it came before; its first result then goes to `answer`, now or when it is there."""
        known = self._known.get(_key(command)) if command.id else None
        if known is None or known.is_over(command):
            return False
        if known.result is not None:
            answer(known.result)
        elif len(known.answers) < ANSWERS:
            known.answers.append(answer)
        else:
            answer(Result(command, Status.REFUSED, Reason.BUSY, f"{ANSWERS} of this id wait for its result already"))
        return True

    def remembering(self, command: Command, answer: Answer) -> Answer:
        """Return an answer that also remembers the result."""
        if not command.id:
            return answer
        known = _Known([answer], command.received)
        self._known[_key(command)] = known
        self._known.move_to_end(_key(command))
        self._forget()

        def told(result: Result) -> None:
            known.result = result
            waiting, known.answers = known.answers, []
            for one in waiting:
                one(result)

        return told

    def _forget(self) -> None:
        """Drop the oldest results; a command under way is kept."""
        while len(self._known) > REMEMBERED:
            oldest = next((key for key, known in self._known.items() if known.result is not None), None)
            if oldest is None:
                return
            del self._known[oldest]
