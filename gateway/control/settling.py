"""What is remembered of a command once something came of it, and what its end means for the drive."""

from __future__ import annotations

from gateway.control.composing import FREQUENCY
from gateway.control.execution import Execution
from gateway.control.loss import Loss
from gateway.control.state import DriveState, Standing


def settle(execution: Execution, state: DriveState, loss: Loss) -> None:
    """Drop what is over, and remember what the drive holds now."""
    state.facts.update(execution.read_back)
    if state.standing is Standing.ARMED and state.unwatched and not state.settings.is_unwatched:
        state.disarm(state.unwatched)
    if execution.is_over:
        state.queue.remove(execution)
    if execution.has_stopped and execution.writes[0].register.name != FREQUENCY:
        state.may_move = False
        loss.stopped()
