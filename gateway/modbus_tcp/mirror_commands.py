"""Commands by the mirror of unit 255: from words in a drive's registers to the door, and the results back. Pure."""

from __future__ import annotations

from gateway.control.command import Command, Source
from gateway.control.door import Door
from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.line_stops import Tell
from gateway.modbus_tcp.mirror import BrokenOff, Sheet, Sheets, Wish, Words
from gateway.modbus_tcp.mirror_map import NOTHING, ORDERS, Place

ASKING = frozenset((Place.COMMAND, Place.FREQUENCY, Place.PARAMETER))  # the others ask for nothing by themselves


class Wrong(Exception):
    """A request that is not carried out, and the exception that says so."""

    def __init__(self, code: ExceptionCode) -> None:
        super().__init__(code.name)
        self.code = code


class MirrorCommands:
    """The registers of all drives, as each controller has written them."""

    def __init__(self, door: Door) -> None:
        self._door = door
        self._sheets = Sheets()
        self._shown: dict[str, Sheet] = {}

    def shown(self, drive: str) -> Sheet | None:
        """Return the registers to be read: the owner's; while nobody owns the drive, whose command came last."""
        return self._shown.get(drive)

    def write(self, drive: str, words: Words, source: Source, tell: Tell) -> None:
        """Take the heartbeat first, then the command that the words make, if any."""
        if drive not in self._door.controls:
            raise Wrong(ExceptionCode.ILLEGAL_FUNCTION)
        if words.get(Place.COMMAND, NOTHING) not in (NOTHING, *ORDERS):
            raise Wrong(ExceptionCode.ILLEGAL_DATA_VALUE)
        sheet = self._sheets.of(drive, source)
        if Place.HEARTBEAT in words:
            self._door.beat(drive, source, words[Place.HEARTBEAT])
        if not words.keys() & ASKING:
            sheet.words.update(words)
            tell(None)
            return
        wish = sheet.write(words, self._door.controls[drive].state, source, self._door.clock.now())
        attempt = sheet.current
        if wish is not None:
            self._make(drive, sheet, wish, source, tell)
        elif attempt is not None and attempt.result is None:
            attempt.answers.append(tell)
        elif attempt is not None and not attempt.is_done:
            tell(attempt.result)
        else:
            self._again(drive, sheet, words, source, tell)

    def _again(self, drive: str, sheet: Sheet, words: Words, source: Source, tell: Tell) -> None:
        """Take words that make no new command: what they made was done, and may have ended since."""
        try:
            wish = sheet.renewed(self._door.controls[drive].state, source, self._door.clock.now(), words)
        except BrokenOff:
            raise Wrong(ExceptionCode.SERVER_DEVICE_BUSY) from None
        if wish is None:
            tell(None)
        else:
            self._make(drive, sheet, wish, source, tell)

    def _make(self, drive: str, sheet: Sheet, wish: Wish, source: Source, tell: Tell) -> None:
        control, now = self._door.controls[drive], self._door.clock.now()
        attempt = sheet.begun()
        attempt.answers.append(tell)
        if not control.lease.is_held(now) or control.lease.owner == source:
            self._shown[drive] = sheet
        command = Command(
            drive,
            wish.verb,
            source,
            now,
            now + control.settings.command_timeout,
            is_reverse=wish.is_reverse,
            value=wish.value,
        )
        self._door.submit(command, attempt.end)
