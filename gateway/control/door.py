"""The one door for every write: commands go in here, and each comes out as exactly one result."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gateway.clock import Clock
from gateway.control.budget import Budget
from gateway.control.command import Answer, Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.composing import COMMAND
from gateway.control.drive_control import DriveControl
from gateway.control.ledger import Entry, Ledger, MemoryLedger
from gateway.control.settings import settings_of
from gateway.control.state import DriveState
from gateway.control.stored import StoredWrites
from gateway.site import Drive, Site

audit = logging.getLogger("gateway.audit")

STALLED = 0.3  # seconds between two signs of life of the event loop, beyond which it stood still
LINE_STOP_WITHIN = 1.0  # seconds for a stop of a whole line to be begun
ANNOUNCED = ("emergency_stop", "command_priority")  # the bits of FA00 that are broadcast

Listener = Callable[[str, str, str], None]  # drive, event, reason
ResultListener = Callable[[Result], None]


@dataclass(frozen=True, slots=True)
class LineBell:
    """How the line of some drives is reached: woken, or told a command word for all of them at once."""

    name: str
    drives: tuple[str, ...]
    ring: Callable[[], None]
    announce: Callable[[int], bool]


@dataclass(slots=True)
class Door:
    """All controlled drives of a gateway."""

    clock: Clock
    ledger: Ledger = field(default_factory=MemoryLedger)
    controls: dict[str, DriveControl] = field(default_factory=dict)
    lines: dict[str, tuple[str, ...]] = field(default_factory=dict)
    awake: float = float("-inf")
    _standstill: tuple[float, float] = (float("-inf"), float("-inf"))  # when the last one began and was noticed
    _known: frozenset[str] = frozenset()
    _bells: dict[str, LineBell] = field(default_factory=dict)
    _listeners: list[Listener] = field(default_factory=list)
    _result_listeners: list[ResultListener] = field(default_factory=list)

    @classmethod
    def of(cls, site: Site, clock: Clock, ledger: Ledger | None = None) -> Door:
        """Make the door of a site."""
        door = cls(clock, ledger or MemoryLedger(), _known=frozenset(drive.name for drive in site.drives))
        door.lines = {line.name: tuple(drive.name for drive in line.drives) for line in site.lines}
        for drive in site.drives:
            door._add(drive)
        return door

    def _add(self, drive: Drive) -> None:
        settings = settings_of(drive.section) if drive.section is not None else None
        if settings is None:
            return

        def tell(event: str, reason: str) -> None:
            self._tell(drive.name, event, reason)

        def ring() -> None:
            self._ring(drive.name)

        stored = StoredWrites(drive.name, self.ledger, Budget.of(settings.stored_writes), ring, tell)
        self.controls[drive.name] = DriveControl(DriveState(drive, settings, tell), stored)

    def on_event(self, listener: Listener) -> None:
        """Call `listener(drive, event, reason)` when a drive is armed, disarmed, its lease lost, or left alone."""
        self._listeners.append(listener)

    def on_result(self, listener: ResultListener) -> None:
        """Call `listener(result)` for every result, whoever asked."""
        self._result_listeners.append(listener)

    def connect(self, bell: LineBell) -> None:
        """Take how a line is reached."""
        self._bells |= dict.fromkeys(bell.drives, bell)

    # ---- what controllers send

    def submit(self, command: Command, answer: Answer) -> None:
        """Take a command; its one result goes to `answer` and to every listener, at once where it is refused."""
        control = self.controls.get(command.drive)
        if control is None:
            self._refuse_unknown(command, answer)
            return
        now = self.clock.now()
        is_stop = control.state.admission.is_stop(command)
        aged = command.older_by(command.received - self.since(now), is_stop=is_stop)
        if not is_stop and now > aged.deadline:
            control.tick(now)
            self._refuse(command, answer, Reason.EXPIRED, "it may have lain here while the gateway stood still")
        else:
            control.submit(aged, self._answering(answer), now)
        self._ring(command.drive)

    def since(self, now: float) -> float:
        """Return since when what is read now may have lain in its socket; `now` where nothing stood still."""
        return now - self._stood_still(now)

    def _stood_still(self, now: float) -> float:
        """Return since how long what is read now may have lain there, the event loop having stood still; else 0.

        A standstill is remembered for a while after it is noticed: timers may run before all sockets are read.
        """
        if self.awake > 0 and now - self.awake > STALLED:
            return now - self.awake
        began, noticed = self._standstill
        return now - began if now <= noticed + STALLED else 0.0

    def _refuse_unknown(self, command: Command, answer: Answer) -> None:
        if command.drive in self._known:
            self._refuse(command, answer, Reason.NOT_CONTROLLED, 'control = "off": this drive is read only')
        else:
            self._refuse(command, answer, Reason.UNKNOWN_DRIVE, f"no drive {command.drive!r}")

    def _refuse(self, command: Command, answer: Answer, reason: Reason, text: str) -> None:
        self._answering(answer)(Result(command, Status.REFUSED, reason, text))

    def _answering(self, answer: Answer) -> Answer:
        def told(result: Result) -> None:
            answer(result)
            self.tell_result(result)

        return told

    def stop_line(self, line: str, verb: Verb, source: Source, answer: Answer, number: str = "") -> None:
        """Stop every controlled drive of a line; an emergency stop goes out as one broadcast first, where it may.

        It may where the source may stop every drive of the line: a broadcast reaches them all. Each drive is then
        read back by itself; `answer` gets one result a drive, with the id `number`.
        """
        now = self.clock.now()
        names = self.lines.get(line, ())
        until = now + LINE_STOP_WITHIN
        commands = [Command(name, verb, source, now, until, id=number) for name in names if name in self.controls]
        if not commands:
            self._refuse_unknown(Command(line, verb, source, now, now, id=number), answer)
            return
        is_announced = verb is Verb.EMERGENCY_STOP and self._announce(names, source)
        for command in commands:
            control = self.controls[command.drive]
            take = control.announce if is_announced else control.submit
            take(command, self._answering(answer), now)
        self._ring(commands[0].drive)

    def _announce(self, names: tuple[str, ...], source: Source) -> bool:
        """Have the emergency stop broadcast; False where it must not, or cannot."""
        controls = [self.controls.get(name) for name in names]
        if any(c is None or not c.settings.may_write(source) or c.is_quiet for c in controls):
            return False
        if not any(c is not None and c.state.is_heard for c in controls):
            return False
        register = next(c for c in controls if c is not None).drive.model.registers[COMMAND]
        word = sum(1 << bit for bit, name in register.bits.items() if name in ANNOUNCED)
        bell = self._bells.get(names[0])
        return bell is not None and bell.announce(word)

    def beat(self, drive: str, source: Source, beat: object) -> None:
        """Take a heartbeat of a controller.

        One that was read after the event loop stood still counts from before that: it may have lain there since,
        and its controller may be dead by now (SAFETY.md H23).
        """
        control = self.controls.get(drive)
        if control is None:
            return
        now = self.clock.now()
        control.tick(now)
        control.beat(source, beat, self.since(now))

    def end_leases(self, channel: Channel, reason: str) -> None:
        """End at once every lease that was taken by a channel, since its controller is known to be gone."""
        now = self.clock.now()
        for drive, control in self.controls.items():
            control.end_lease(channel, reason, now)
            self._ring(drive)

    def pulse(self) -> None:
        """Take note that the event loop is alive, and see to what has run out even where a line is down."""
        now = self.clock.now()
        if self.awake > 0 and now - self.awake > STALLED:
            self._standstill = (self.awake, now)
        self.awake = now
        for control in self.controls.values():
            control.tick(self.awake)

    # ---- what comes of it

    def tell_result(self, result: Result) -> None:
        """Tell every listener, and the audit, of a result: also of what was refused before it came here."""
        audit.info("%s", _in_words(result))
        self.ledger.record(Entry.of_result(result, self.clock.wall()))
        for listener in self._result_listeners:
            listener(result)

    def _tell(self, drive: str, event: str, reason: str) -> None:
        audit.info("%s: %s%s", drive, event, f": {reason}" if reason else "")
        self.ledger.record(Entry.of_event(drive, event, reason, self.clock.wall()))
        for listener in self._listeners:
            listener(drive, event, reason)

    def leave(self) -> None:
        """Take no command any more, and stop what is to be stopped when the gateway ends."""
        now = self.clock.now()
        for control in self.controls.values():
            control.leave(now)
        for bell in self._bells.values():
            bell.ring()

    @property
    def is_settled(self) -> bool:
        """Say whether nothing is left to be done for any drive."""
        return all(control.is_settled for control in self.controls.values())

    def _ring(self, drive: str) -> None:
        if drive in self._bells:
            self._bells[drive].ring()


def _in_words(result: Result) -> str:
    """Write one line of the audit: who asked what of whom, with which words, and how it ended."""
    command = result.command
    parts = [
        f"{command.drive}: {command.verb} from {command.source}",
        f"id {command.id}" if command.id else "",
        f"value {command.value}" if command.value is not None else "",
        f"was {_words(result.before)}" if result.before else "",
        f"wrote {_words(result.raw)}" if result.raw else "",
        f"read back {_words(result.read_back)}" if result.read_back else "",
        f"{result.status}{f' ({result.reason})' if result.reason else ''}",
        result.text,
    ]
    return "; ".join(part for part in parts if part)


def _words(words: Mapping[str, int]) -> str:
    return " ".join(f"{name}={word:04X}H" for name, word in words.items())
