"""What happens to a controlled drive: it is heard, online, offline, tripped; what that means for its control."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.control import watchdog
from gateway.control.command import GATEWAY, Command, Reason, Result, Status, Verb
from gateway.control.execution import Execution
from gateway.control.loss import Loss
from gateway.control.resets import CLEARED, Resets
from gateway.control.settling import settle
from gateway.control.state import DriveState, Standing
from gateway.control.writes import Allowed, BadCommand, plan_write

WATCHDOG_WITHIN = 10.0  # seconds for F803, F804 and F808 to be written after a drive has come


@dataclass(slots=True)
class Presence:
    """The coming and going of one drive, as whoever reads it tells it. Times are monotonic seconds."""

    state: DriveState
    loss: Loss
    resets: Resets

    def on_heard(self, now: float) -> None:
        """Take that the drive is there, whoever it is: stops may be sent."""
        self.state.is_heard = True
        if not self.state.is_online:
            self.loss.heard(now)

    def on_online(self, facts: Mapping[str, int], signs: Mapping[str, bool], now: float) -> None:
        """Take that the drive is identified and observed: how it is set, and whether it is tripped."""
        state = self.state
        if state.is_online:
            return
        state.is_online, state.is_heard, state.needs_set_up, state.is_marked = True, True, False, False
        state.away_because = ""
        state.facts = dict(facts)
        if signs:
            self.on_trip(is_tripped=any(signs.values()))
        self.resets.came_back()
        if self.resets.is_stop_lost:
            self.resets.is_stop_lost = False
            self.loss.owe()
        if state.is_running:
            self.loss.found_running(now)
        else:
            self.loss.found_standing()
        self.set_watchdog(now)

    def on_offline(self, reason: str, now: float) -> None:
        """Take that the link is lost: the drive is disarmed, and nothing that waited is sent later."""
        state = self.state
        is_stop_pending = state.queue.has_stop or state.standing is Standing.LOST
        was_online, state.is_online, state.is_heard = state.is_online, False, False
        state.away_because = reason
        state.is_tripped = None
        state.carrying.form = None
        state.queue.clear(Reason.OFFLINE, reason)
        self.loss.link_lost(is_stop_pending=is_stop_pending, reason=reason, now=now)
        if was_online:
            state.disarm(f"the link was lost: {reason}")

    def on_trip(self, is_tripped: bool | None) -> None:
        """Take whether the drive is tripped; None where an answer does not say."""
        state = self.state
        if is_tripped is None:
            return
        was_tripped, state.is_tripped = state.is_tripped, is_tripped
        if was_tripped and not is_tripped and state.is_online:
            self.resets.on_reset(CLEARED)  # nothing else ends a trip: what it had in its RAM is gone (7.1)
        if not is_tripped:
            return
        for execution in tuple(state.queue.executions):
            execution.on_tripped()
            settle(execution, state, self.loss)
        self.loss.tripped()
        if not was_tripped:
            state.disarm("the drive has tripped")

    def set_watchdog(self, now: float) -> None:
        """Set F804, F808 and F803 as configured where they read otherwise: nobody has to ask for that."""
        state, model, codec = self.state, self.state.drive.model, self.state.drive.codec
        for register, word in watchdog.wanted(state.settings, model, state.facts):
            command = Command(state.drive.name, Verb.SET, GATEWAY, now, now + WATCHDOG_WITHIN, name=register.name)
            allowed = Allowed(stored=not codec.forms.has_ram_write)
            try:
                write = plan_write(model, codec, state.drive.number, register, word, allowed, state.facts)
            except BadCommand as error:
                state.tell("watchdog", str(error))
                return
            execution = Execution(command, (write,), self._after_watchdog)
            execution.plan((write,))
            state.queue.put(execution)

    def _after_watchdog(self, result: Result) -> None:
        if result.status is not Status.DONE:
            self.state.tell("watchdog", f"{result.command.name} could not be set: {result.text or result.reason}")
