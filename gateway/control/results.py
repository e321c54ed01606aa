"""What became of commands by their ids, so that a repeated one acts once (SAFETY.md H03)."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

from gateway.control.command import Answer, Command, Result, Source

REMEMBERED = 256  # ids of one drive; the oldest finished ones are forgotten first
ANSWERS = 16  # that may wait for one command under way


@dataclass(slots=True)
class _Known:
    answers: list[Answer]
    result: Result | None = None


@dataclass(slots=True)
class Results:
    """The results of one drive's commands by source and id. A command without an id is never a repetition."""

    _known: OrderedDict[tuple[Source, str], _Known] = field(default_factory=OrderedDict)

    def is_known(self, command: Command, answer: Answer) -> bool:
        """Say whether it came before; its first result then goes to `answer`, now or when it is there."""
        known = self._known.get((command.source, command.id)) if command.id else None
        if known is None:
            return False
        if known.result is not None:
            answer(known.result)
        elif len(known.answers) < ANSWERS:
            known.answers.append(answer)
        return True

    def remembering(self, command: Command, answer: Answer) -> Answer:
        """Return an answer that also remembers the result."""
        if not command.id:
            return answer
        known = _Known([answer])
        self._known[command.source, command.id] = known
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
