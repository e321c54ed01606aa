"""The one door for every write: commands go in here, and each comes out as exactly one result."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gateway.clock import Clock
from gateway.control.command import Answer, Command, Reason, Result, Source, Status
from gateway.control.drive_control import DriveControl
from gateway.control.settings import settings_of
from gateway.site import Drive, Site

audit = logging.getLogger("gateway.audit")

Listener = Callable[[str, str, str], None]  # drive, event, reason
ResultListener = Callable[[Result], None]


@dataclass(slots=True)
class Door:
    """All controlled drives of a gateway. `ring` wakes the line of a drive when something waits for it."""

    clock: Clock
    controls: dict[str, DriveControl] = field(default_factory=dict)
    _known: frozenset[str] = frozenset()
    _rings: dict[str, Callable[[], None]] = field(default_factory=dict)
    _listeners: list[Listener] = field(default_factory=list)
    _result_listeners: list[ResultListener] = field(default_factory=list)

    @classmethod
    def of(cls, site: Site, clock: Clock) -> Door:
        """Make the door of a site."""
        door = cls(clock, _known=frozenset(drive.name for drive in site.drives))
        for drive in site.drives:
            door._add(drive)
        return door

    def _add(self, drive: Drive) -> None:
        settings = settings_of(drive.section) if drive.section is not None else None
        if settings is None:
            return

        def tell(event: str, reason: str) -> None:
            self._tell(drive.name, event, reason)

        self.controls[drive.name] = DriveControl(drive, settings, tell)

    def on_event(self, listener: Listener) -> None:
        """Call `listener(drive, event, reason)` when a drive is armed, disarmed, its lease lost, or left alone."""
        self._listeners.append(listener)

    def on_result(self, listener: ResultListener) -> None:
        """Call `listener(result)` for every result, whoever asked."""
        self._result_listeners.append(listener)

    def connect(self, rings: Mapping[str, Callable[[], None]]) -> None:
        """Take how each drive's line is woken, by drive name."""
        self._rings = dict(rings)

    def _tell(self, drive: str, event: str, reason: str) -> None:
        audit.info("%s: %s%s", drive, event, f": {reason}" if reason else "")
        for listener in self._listeners:
            listener(drive, event, reason)

    def submit(self, command: Command, answer: Answer) -> None:
        """Take a command; its one result goes to `answer` and to every listener, at once where it is refused."""

        def told(result: Result) -> None:
            answer(result)
            self.tell_result(result)

        control = self.controls.get(command.drive)
        if control is None:
            told(self._refused(command))
            return
        control.submit(command, told, self.clock.now())
        self._ring(command.drive)

    def tell_result(self, result: Result) -> None:
        """Tell every listener, and the audit, of a result: also of what was refused before it came here."""
        audit.info("%s", _in_words(result))
        for listener in self._result_listeners:
            listener(result)

    def _refused(self, command: Command) -> Result:
        if command.drive in self._known:
            return Result(command, Status.REFUSED, Reason.NOT_CONTROLLED, 'control = "off": this drive is read only')
        return Result(command, Status.REFUSED, Reason.UNKNOWN_DRIVE, f"no drive {command.drive!r}")

    def beat(self, drive: str, source: Source, beat: object) -> None:
        """Take a heartbeat of a controller."""
        control = self.controls.get(drive)
        if control is not None:
            control.beat(source, beat, self.clock.now())

    def _ring(self, drive: str) -> None:
        if drive in self._rings:
            self._rings[drive]()


def _in_words(result: Result) -> str:
    """Write one line of the audit: who asked what of whom, with which words, and how it ended."""
    command = result.command
    raw = " ".join(f"{name}={word:04X}H" for name, word in result.raw.items())
    read_back = " ".join(f"{name}={word:04X}H" for name, word in result.read_back.items())
    parts = [
        f"{command.drive}: {command.verb} from {command.source}",
        f"id {command.id}" if command.id else "",
        f"value {command.value}" if command.value is not None else "",
        f"wrote {raw}" if raw else "",
        f"read back {read_back}" if read_back else "",
        f"{result.status}{f' ({result.reason})' if result.reason else ''}",
        result.text,
    ]
    return "; ".join(part for part in parts if part)
