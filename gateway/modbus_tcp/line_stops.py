"""Stops of whole lines by unit 255: one register a line. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gateway.control.command import Result, Source, Status
from gateway.control.door import Door
from gateway.modbus_tcp.codes import ExceptionCode, Wrong
from gateway.modbus_tcp.mirror import is_stopped
from gateway.modbus_tcp.mirror_map import LINE_ORDERS, NOTHING

SEVERITY = (Status.UNKNOWN, Status.FAILED, Status.REFUSED, Status.DONE)  # the worst first

Stop = tuple[Source, int]
"""Who has written, and what."""

Tell = Callable[[Result | None], None]
"""Takes how a request ended; None where nothing had to be done."""


class LineStops:
    """The registers of the lines, in the order of the file. The same word again stops again only what moves."""

    def __init__(self, door: Door) -> None:
        self.lines = tuple(door.lines)
        self._door = door
        self._written: dict[str, Stop] = {}  # by line: the last one
        self._under_way: dict[str, Stop] = {}  # by line

    def word(self, line: str) -> int:
        """Return what was written last."""
        return self._written[line][1] if line in self._written else NOTHING

    def drives(self, line: str) -> list[str]:
        """Return the drives of a line that may be commanded."""
        return [drive for drive in self._door.lines[line] if drive in self._door.controls]

    def write(self, lines: Sequence[str], words: Sequence[int], source: Source, tell: Tell) -> None:
        """Stop all drives of some lines; `tell` takes the result of the drive that fared worst.

        Wrong (05) where the same is under way already: a stop that is begun anew takes longer.
        """
        asked = {line: (source, word) for line, word in zip(lines, words, strict=True) if word != NOTHING}
        if asked and all(self._under_way.get(line) == stop for line, stop in asked.items()):
            raise Wrong(ExceptionCode.ACKNOWLEDGE)
        wanted = {line: stop for line, stop in asked.items() if not self._holds(line, stop)}
        self._written |= {line: (source, word) for line, word in zip(lines, words, strict=True)}
        if not wanted:
            tell(None)
            return
        expected = sum(len(self.drives(line)) for line in wanted)
        results: list[Result] = []

        def take(result: Result) -> None:
            results.append(result)
            if len(results) == expected:
                ended = self._under_way.items() & wanted.items()
                self._under_way = dict(self._under_way.items() - ended)
                tell(min(results, key=lambda one: SEVERITY.index(one.status)))

        self._under_way |= wanted
        for line, (_, word) in wanted.items():
            self._door.stop_line(line, LINE_ORDERS[word].verb, source, take)

    def _holds(self, line: str, stop: Stop) -> bool:
        is_same = self._written.get(line) == stop
        return is_same and all(is_stopped(self._door.controls[drive].state) for drive in self.drives(line))
