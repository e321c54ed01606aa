"""What is known of one controlled drive and of the permission to command it: the parts of its control share this.

Pure. Times are monotonic seconds.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from gateway.control import watchdog
from gateway.control.admission import SETPOINTS, Admission, NotAdmitted
from gateway.control.carrying import Carrying
from gateway.control.command import GATEWAY, Answer, Command, Reason, Source, Status
from gateway.control.composing import COMMAND, has_bit, runs
from gateway.control.execution import Execution
from gateway.control.lease import Lease
from gateway.control.settings import ControlSettings
from gateway.drives.register import Register
from gateway.protocol.pdu import ReadWords, Request
from gateway.site import Drive

WAITING = 16  # commands of one drive that may wait

Telling = Callable[[str, str], None]  # an event and its reason, for whoever publishes them


class Standing(Enum):
    """Whether the drive may be set in motion, and why not."""

    ARMED = "armed"
    DISARMED = "disarmed"
    LOST = "lost"  # permission has ended; on_loss is being done
    QUIET = "quiet"  # no frame is sent, so that the drive's own F803 acts


@dataclass(frozen=True, slots=True, eq=False)
class Errand:
    """One frame for a drive: of a command, or a look at a register."""

    request: Request
    execution: Execution | None = None
    look: Register | None = None

    @property
    def not_after(self) -> float:
        """Return until when it may be sent (SAFETY.md H11)."""
        return self.execution.not_after if self.execution is not None else math.inf

    @property
    def is_stop(self) -> bool:
        """Say whether it goes ahead of everything on the line."""
        return self.execution is not None and self.execution.is_stop


@dataclass(slots=True)
class Queue:
    """The commands of one drive that wait, the next one first."""

    executions: deque[Execution] = field(default_factory=deque)

    def __bool__(self) -> bool:
        return bool(self.executions)

    @property
    def head(self) -> Execution:
        """Return the one whose turn it is."""
        return self.executions[0]

    @property
    def has_stop(self) -> bool:
        """Say whether a stop is next."""
        return bool(self.executions) and self.executions[0].is_stop

    @property
    def is_setting_up(self) -> bool:
        """Say whether the gateway itself still has something to set."""
        return any(execution.command.source == GATEWAY for execution in self.executions)

    def put(self, execution: Execution) -> None:
        """Let a command wait: a stop instead of everything else, a setpoint instead of an older one."""
        command = execution.command
        if execution.is_stop:
            self._put_stop(execution)
            return
        if command.verb in SETPOINTS:
            self._supersede(command)
        if len(self.executions) >= WAITING:
            raise NotAdmitted(Reason.BUSY, f"{WAITING} commands wait for this drive already")
        self.executions.append(execution)

    def _put_stop(self, execution: Execution) -> None:
        """Let a stop go instead of everything else, but for a stronger one: the weaker shares its result."""
        text = f"{execution.command.verb} came from {execution.command.source}"
        head = self.executions[0] if self.has_stop else None
        if head is None or head.strength < 0:
            self.clear(Reason.STOPPED, text)
        elif head.strength < execution.strength:
            self._share(head, execution)
            self.clear(Reason.STOPPED, text)
        elif len(head.joined) >= WAITING:
            raise NotAdmitted(Reason.BUSY, f"{WAITING} stops wait for this drive already; it is being stopped")
        else:
            self.clear_but_stops(Reason.STOPPED, text)
            self._share(execution, head)
            return
        self.executions.appendleft(execution)

    def _share(self, weaker: Execution, stronger: Execution) -> None:
        """Let who asked for a stop have the result of a stronger one; with other words beside it, it is ended."""
        if len(weaker.writes) > 1:
            self.end(weaker, Reason.STOPPED, f"{stronger.command.verb} came from {stronger.command.source}")
            return
        self.remove(weaker)
        stronger.joined.extend(weaker.taken_over())

    def joins(self, command: Command, answer: Answer) -> bool:
        """Let an equal stop share the one that is under way: a flood of stops must not begin it again and again."""
        if not (command.verb.is_stopping and self.has_stop and self.head.command.verb is command.verb):
            return False
        if len(self.head.joined) >= WAITING:
            raise NotAdmitted(Reason.BUSY, f"{WAITING} equal stops wait for this drive already; it is being stopped")
        self.clear_but_stops(Reason.STOPPED, f"{command.verb} came from {command.source}")
        self.head.joined.append((command, answer))
        return True

    def _supersede(self, command: Command) -> None:
        """Drop an older setpoint that waits, but none before a command of another kind: it may need that one."""
        for execution in reversed(tuple(self.executions)):
            if execution.command.verb not in SETPOINTS:
                return
            if execution.command.verb is command.verb and not execution.is_begun:
                self.executions.remove(execution)
                execution.finish(Status.REFUSED, Reason.SUPERSEDED, "a newer value came before it was sent")

    def remove(self, execution: Execution) -> None:
        """Drop one, if it is there."""
        if execution in self.executions:
            self.executions.remove(execution)

    def clear(self, reason: Reason, text: str) -> None:
        """End everything that waits."""
        for execution in tuple(self.executions):
            self.end(execution, reason, text)

    def clear_but_stops(self, reason: Reason, text: str) -> None:
        """End everything that waits but a stop: no end of permission takes that back."""
        for execution in [e for e in self.executions if not e.is_stop]:
            self.end(execution, reason, text)

    def end(self, execution: Execution, reason: Reason, text: str) -> None:
        """End one: what was sent may have been done, or not."""
        self.remove(execution)
        execution.finish(Status.UNKNOWN if execution.was_sent else Status.REFUSED, reason, text)

    def end_motion(self, reason: str) -> None:
        """End what only an armed drive is given."""
        for execution in [e for e in self.executions if not e.is_stop and e.is_for_armed]:
            self.end(execution, Reason.NOT_ARMED, f"disarmed: {reason}")


@dataclass(slots=True)
class DriveState:
    """The state of one drive's control. `facts` are words as the drive has them, by register name."""

    drive: Drive
    settings: ControlSettings
    tell: Telling
    standing: Standing = Standing.DISARMED
    reason: str = "the gateway has started"
    is_online: bool = False
    away_because: str = ""  # why it is not online; "" while that is not known
    is_heard: bool = False
    is_tripped: bool | None = None
    is_ending: bool = False
    needs_set_up: bool = False  # the drive was reset: whoever reads it has to begin anew
    may_move: bool = False  # a run command was sent, and no stop was seen since
    is_marked: bool = False  # FA87 was set, so that a reset that nobody sees can be told
    facts: dict[str, int] = field(default_factory=dict)
    queue: Queue = field(default_factory=Queue)
    carrying: Carrying = field(default_factory=Carrying)
    lease: Lease = field(init=False)
    admission: Admission = field(init=False)

    def __post_init__(self) -> None:
        self.lease = Lease(self.settings.lease)
        self.admission = Admission(self.drive, self.settings)

    def is_own(self, source: Source, now: float) -> bool:
        """Say whether a source may command more than stops."""
        if source == GATEWAY or not self.settings.is_leased:
            return True
        return self.lease.is_held(now) and self.lease.owner == source

    @property
    def away(self) -> str:
        """Say that it is not online, and why: silent, or another drive, which only its link knows."""
        because = f": {self.away_because}" if self.away_because else ""
        return f"{self.drive.name} is not online{because}"

    @property
    def timeout(self) -> float:
        """Return F803 in seconds as the drive has it; 0 where it is off, or unknown."""
        return watchdog.seconds(self.drive.model, self.facts)

    @property
    def shortest_timeout(self) -> float:
        """Return the F803 to reckon with, in seconds: a configured one may be in force before it is read back."""
        return watchdog.shortest(self.settings, self.drive.model, self.facts)

    @property
    def unwatched(self) -> str:
        """Say why the drive would go on running when nobody talks to it; "" where it would stop."""
        return watchdog.missing(self.drive.model, self.facts)

    @property
    def is_running(self) -> bool:
        """Say whether FA00, as it was read last, runs the motor."""
        register = self.drive.model.registers.get(COMMAND)
        return register is not None and runs(register, self.facts.get(COMMAND, 0)) and not self.is_tripped

    @property
    def is_jogging(self) -> bool:
        """Say whether FA00, as it was read last, jogs the motor."""
        register = self.drive.model.registers.get(COMMAND)
        return register is not None and has_bit(register, self.facts.get(COMMAND, 0), "jog")

    def disarm(self, reason: str) -> None:
        """Permit no motion until the drive is armed again; what waits for it is refused."""
        self.queue.end_motion(reason)
        if self.standing is Standing.ARMED:
            self.standing, self.reason = Standing.DISARMED, reason
            self.tell("disarmed", reason)
        elif self.standing is Standing.DISARMED:
            self.reason = reason

    def look(self, register: Register) -> Errand:
        """Return a read of one register."""
        return Errand(ReadWords(self.drive.number, register.address), look=register)
