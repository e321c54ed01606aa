"""Who may let a motor run, by what the controllers have really sent; and the drive, which knows how long it did.

It knows nothing of the gateway but the rules: one owner at a time, whose signs of life make its lease last; a stop
ends the motion until the owner runs the drive again (SAFETY.md H04, H05).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from gateway.control.command import Verb
from gateway.sim.drive import SimulatedDrive
from tests.simulation.orders import Order
from tests.simulation.setup import Setup
from tests.simulation.world import Event, World

RUNNING = (Verb.RUN, Verb.JOG, Verb.PRESET)
QUIET_AFTER = 8.0  # seconds without a disturbance, after which the tight bound holds: all drives are online again
SLACK = 1e-6  # seconds: what the arithmetic of times may cost

Tell = Callable[[str], None]


def is_driven(drive: SimulatedDrive) -> bool:
    """Say whether a drive drives its motor: it was told to run, and neither stops, coasts, brakes nor is tripped."""
    inverter = drive.inverter
    operation = inverter.operation
    is_let_go = operation.is_coasting or operation.is_dc_braking or operation.is_forced_stop
    return operation.is_running and not (is_let_go or inverter.condition.is_tripped or inverter._stops_to_trip)


@dataclass(slots=True)
class Permission:
    """The permission to let one motor run. `until`: the end of the lease; `runs`: no stop came since a run."""

    lease: float
    owner: str = ""
    until: float = -math.inf
    runs: bool = False
    beat: bytes | None = None
    extra: float = -math.inf  # a gateway that has just started may watch a running drive for so long

    def lasts(self) -> float:
        """Return until when the motor may run, as far as is known now."""
        return max(self.until if self.runs else -math.inf, self.extra)


@dataclass(slots=True)
class Watched:
    """One drive, and how long its motor has been driven beyond permission, in seconds."""

    drive: SimulatedDrive
    permission: Permission
    since: float
    was_driven: bool = False
    beyond: float = 0.0
    worst: float = 0.0
    worst_calm: float = 0.0
    alarm: Event | None = None
    alarm_at: float = math.inf
    told: bool = False
    was_ever_driven: bool = False


@dataclass(slots=True)
class Oracle:
    """Watches all drives of a trial. `tell` takes what must not be."""

    world: World
    setup: Setup
    tell: Tell
    watched: dict[str, Watched] = field(default_factory=dict)
    disturbed: float = -math.inf  # when something went wrong last: only the loose bound holds for a while
    is_left: bool = False  # what runs is left to its own time-out

    def watch(self, name: str, drive: SimulatedDrive) -> None:
        """Watch a drive from now on."""
        self.watched[name] = Watched(drive, Permission(self.setup.lease), self.world.now)

    def disturb(self) -> None:
        """Take note that something goes wrong now."""
        self.disturbed = self.world.now

    @property
    def tight(self) -> float:
        """Return how long a motor may run on after its permission, where nothing goes wrong.

        Two exchanges: the one under way, and the stop; and one for the stop of every other drive of the line.
        """
        return (1 + self.setup.drives) * self.setup.exchange

    @property
    def loose(self) -> float:
        """Return how long it may run on whatever goes wrong: the drive's own time-out, and one exchange."""
        return self.setup.timeout + self.setup.exchange

    # ---- what controllers send

    def heard(self, order: Order) -> None:
        """Take a command that has reached the gateway."""
        watched = self.watched.get(order.drive)
        if watched is None:
            return
        self.look_at(watched)
        permission, now = watched.permission, self.world.now
        order.is_owners = order.source == permission.owner and now < permission.until
        is_free = permission.until <= now or not permission.owner
        if order.verb is Verb.TAKE and (is_free or permission.owner == order.source):
            self._take(order, permission)
        elif order.verb.is_stopping:
            permission.runs = False
        elif order.is_owners:
            permission.until = now + permission.lease
            permission.runs |= order.verb in RUNNING
            if order.verb is Verb.RELEASE:
                permission.owner, permission.until = "", now
        self.look_at(watched)

    def _take(self, order: Order, permission: Permission) -> None:
        """Believe that a source has taken a drive; what was before is restored where it is told otherwise."""
        before = (permission.owner, permission.until)
        if permission.owner != order.source:
            permission.beat = None
        permission.owner, permission.until = order.source, self.world.now + permission.lease
        given = permission.until

        def corrected() -> None:
            if order.status == "refused" and (permission.owner, permission.until) == (order.source, given):
                permission.owner, permission.until = before

        order.when_answered(corrected)

    def beat(self, drive: str, source: str, beat: bytes) -> None:
        """Take a sign of life that has reached the gateway: it counts when it has changed."""
        watched = self.watched[drive]
        permission, now = watched.permission, self.world.now
        if source != permission.owner or now >= permission.until:
            return
        before, permission.beat = permission.beat, beat
        if before not in (None, beat):
            self.look_at(watched)
            permission.until = now + permission.lease
            self.look_at(watched)

    def end_all(self, after: float = 0.0) -> None:
        """End every permission: the gateway ends, or has ended, and nobody can command through it."""
        for watched in self.watched.values():
            self.look_at(watched)
            watched.permission.owner, watched.permission.until = "", self.world.now + after
            self.look_at(watched)

    def extend(self, seconds: float) -> None:
        """Let what runs go on for so long: the gateway was started anew, and may wait that long for an owner."""
        for watched in self.watched.values():
            self.look_at(watched)
            watched.permission.extra = self.world.now + seconds
            self.look_at(watched)

    # ---- what drives do

    def look(self) -> None:
        """Look at every drive."""
        for watched in self.watched.values():
            self.look_at(watched)

    def look_at(self, watched: Watched) -> None:
        """Count for how long a motor was driven beyond permission since the last look, and look again in time."""
        now, drive = self.world.now, watched.drive
        lasts = watched.permission.lasts()
        if watched.was_driven:
            watched.beyond += max(0.0, now - max(watched.since, lasts))
        if lasts > now or not watched.was_driven:
            watched.beyond, watched.told = 0.0, False
        self._judge(watched)
        deadline = drive.inverter.timer.deadline
        if deadline is not None and deadline <= now:
            drive.tick(now)
            deadline = None
        watched.since, watched.was_driven = now, is_driven(drive)
        watched.was_ever_driven |= watched.was_driven
        if watched.was_driven:
            due = min(time for time in (deadline, max(now, lasts) + self.tight, math.inf) if time is not None)
            self._look_again(watched, due)

    def _judge(self, watched: Watched) -> None:
        if not watched.beyond:
            return
        watched.worst = max(watched.worst, watched.beyond)
        is_calm = self.disturbed < self.world.now - watched.beyond - QUIET_AFTER
        is_told = self.setup.on_loss != "quiesce" and not self.is_left
        if is_calm and is_told:
            watched.worst_calm = max(watched.worst_calm, watched.beyond)
        bound = self.tight if is_calm and is_told else self.loose
        if watched.beyond > bound + SLACK and not watched.told:
            watched.told = True
            name = f"motor {watched.drive.number}"
            self.tell(f"{name} driven {watched.beyond:.3f} s beyond permission; at most {bound:.3f} s")

    def _look_again(self, watched: Watched, when: float) -> None:
        """Be there when the drive's own time-out acts, or when the bound is reached."""
        if watched.alarm is not None:
            if watched.alarm_at <= when:
                return
            watched.alarm.call_off()
        if when < math.inf:
            watched.alarm_at = max(when, self.world.now)
            watched.alarm = self.world.at(watched.alarm_at, lambda: self._alarm(watched))

    def _alarm(self, watched: Watched) -> None:
        watched.alarm = None
        self.look_at(watched)
