"""Stops of whole lines by unit 255: one register a line. Pure."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gateway.control.command import Result, Source, Status
from gateway.control.door import Door
from gateway.modbus_tcp.mirror import is_stopped
from gateway.modbus_tcp.mirror_map import LINE_ORDERS, NOTHING

SEVERITY = (Status.UNKNOWN, Status.FAILED, Status.REFUSED, Status.DONE)  # the worst first

Tell = Callable[[Result | None], None]
"""Takes how a request ended; None where nothing had to be done."""


class LineStops:
    """The registers of the lines, in the order of the file. The same word again stops again only what moves."""

    def __init__(self, door: Door) -> None:
        self.lines = tuple(door.lines)
        self._door = door
        self._written: dict[str, tuple[Source, int]] = {}  # by line: who wrote last, and what

    def word(self, line: str) -> int:
        """Return what was written last."""
        return self._written[line][1] if line in self._written else NOTHING

    def drives(self, line: str) -> list[str]:
        """Return the drives of a line that may be commanded."""
        return [drive for drive in self._door.lines[line] if drive in self._door.controls]

    def write(self, lines: Sequence[str], words: Sequence[int], source: Source, tell: Tell) -> None:
        """Stop all drives of some lines; `tell` takes the result of the drive that fared worst."""
        wanted = [
            (line, word)
            for line, word in zip(lines, words, strict=True)
            if word != NOTHING and not self._holds(line, word, source)
        ]
        self._written |= {line: (source, word) for line, word in zip(lines, words, strict=True)}
        if not wanted:
            tell(None)
            return
        expected = sum(len(self.drives(line)) for line, _ in wanted)
        results: list[Result] = []

        def take(result: Result) -> None:
            results.append(result)
            if len(results) == expected:
                tell(min(results, key=lambda one: SEVERITY.index(one.status)))

        for line, word in wanted:
            self._door.stop_line(line, LINE_ORDERS[word].verb, source, take)

    def _holds(self, line: str, word: int, source: Source) -> bool:
        is_same = self._written.get(line) == (source, word)
        return is_same and all(is_stopped(self._door.controls[drive].state) for drive in self.drives(line))
