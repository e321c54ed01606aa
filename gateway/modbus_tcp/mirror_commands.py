"""Commands by the mirror of unit 255: from words in a drive's registers to the door, and the results back. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from gateway.control.command import Command, Result, Source
from gateway.control.door import Door
from gateway.modbus_tcp.codes import ExceptionCode, Wrong
from gateway.modbus_tcp.line_stops import Tell
from gateway.modbus_tcp.mirror import Sheet, Sheets, Wish, Words
from gateway.modbus_tcp.mirror_map import ENDED, NOTHING, ORDERS, REASONS, STATUSES, UNDER_WAY, Place

ASKING = frozenset((Place.COMMAND, Place.FREQUENCY, Place.PARAMETER))  # the others ask for nothing by themselves
SHOWN_BY_RESULT = (ExceptionCode.ACKNOWLEDGE, ExceptionCode.SERVER_DEVICE_BUSY)


class MirrorCommands:
    """The registers of all drives, as each controller has written them."""

    def __init__(self, door: Door) -> None:
        self._door = door
        self._sheets = Sheets()
        self._shown: dict[str, Sheet] = {}

    def words(self, drive: str, reader: Source | None, now: float) -> Mapping[Place, int]:
        """Return what was written, and what became of the last command.

        Of the reader, where it is known and has written; else of the owner; while nobody owns the drive, of who
        commanded last.
        """
        own = None if reader is None else self._sheets.find(drive, reader)
        sheet = own or self._shown.get(drive)
        if sheet is None or sheet.last is None:
            return {} if sheet is None else sheet.words
        result = sheet.last.result
        end = UNDER_WAY if result is None else STATUSES[result.status]
        if result is not None and sheet.has_ended(self._door.controls[drive].state, now):
            end = ENDED
        reason = 0 if result is None else REASONS[result.reason]
        return {**sheet.words, Place.ECHO: sheet.last.sequence, Place.RESULT: end, Place.REASON: reason}

    def write(self, drive: str, words: Words, source: Source, tell: Tell) -> None:
        """Take the heartbeat first, then the command that the words make, if any; Wrong where there is no result."""
        if drive not in self._door.controls:
            raise Wrong(ExceptionCode.ILLEGAL_FUNCTION)
        if words.get(Place.COMMAND, NOTHING) not in (NOTHING, *ORDERS):
            raise Wrong(ExceptionCode.ILLEGAL_DATA_VALUE)
        sheet = self._sheets.of(drive, source)
        if Place.HEARTBEAT in words:
            self._door.beat(drive, source, words[Place.HEARTBEAT])
        if words.keys() & ASKING:
            self._command(drive, sheet, words, tell)
        else:
            sheet.words.update(words)
            tell(None)

    def write_and_show(self, drive: str, words: Words, source: Source) -> None:
        """Take the same from a controller that reads the end from its registers; Wrong for a wrong request only."""
        try:
            self.write(drive, words, source, lambda _: None)
        except Wrong as wrong:
            if wrong.code not in SHOWN_BY_RESULT:
                raise

    def _command(self, drive: str, sheet: Sheet, words: Words, tell: Tell) -> None:
        state, now = self._door.controls[drive].state, self._door.clock.now()
        wish = sheet.write(words, state, now)
        attempt = sheet.current
        if wish is None and attempt is not None and attempt.result is None:
            raise Wrong(ExceptionCode.ACKNOWLEDGE)
        if wish is None and Place.COMMAND in words:
            wish = sheet.stop_again(state, now)  # also one that was refused, or failed
        if wish is not None:
            self._make(drive, sheet, wish, tell)
        elif attempt is not None and not attempt.is_done:
            tell(attempt.result)
        elif Place.COMMAND in words and sheet.has_ended(state, now):
            raise Wrong(ExceptionCode.SERVER_DEVICE_BUSY)
        else:
            tell(None)

    def _make(self, drive: str, sheet: Sheet, wish: Wish, tell: Tell) -> None:
        control, now = self._door.controls[drive], self._door.clock.now()
        attempt = sheet.begun()
        if not control.lease.is_held(now) or control.lease.owner == sheet.source:
            self._shown[drive] = sheet

        def ended(result: Result) -> None:
            attempt.result = result
            tell(result)

        command = Command(
            drive,
            wish.verb,
            sheet.source,
            now,
            now + control.settings.command_timeout,
            is_reverse=wish.is_reverse,
            value=wish.value,
        )
        self._door.submit(command, ended)
