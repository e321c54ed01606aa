"""What a controller has asked for, and what it heard of it; and scripts, which say what it does when."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from decimal import Decimal

from gateway.control.command import Verb
from tests.simulation.world import World


@dataclass(slots=True, eq=False)
class Order:
    """One command of a controller. `delivered` is when it was in the gateway's socket; `status` what came of it."""

    source: str
    drive: str
    verb: Verb
    id: str
    value: Decimal | None = None
    issued: float = 0.0
    delivered: float | None = None
    is_owners: bool = False  # whoever asked had the lease when it reached the gateway
    written: int = 0  # how often its setpoint was written to the line
    status: str = ""
    reason: str = ""
    _waiting: list[Callable[[], None]] = field(default_factory=list)

    def when_answered(self, action: Callable[[], None]) -> None:
        """Do something when the result is there."""
        if self.status:
            action()
        else:
            self._waiting.append(action)

    def answered(self, status: str, reason: str) -> None:
        """Take the result; the first one counts."""
        if self.status:
            return
        self.status, self.reason = status, reason
        waiting, self._waiting = self._waiting, []
        for action in waiting:
            action()

    @property
    def is_done(self) -> bool:
        """Say whether it was done, as far as the controller knows."""
        return self.status == "done"


Script = Generator["float | Order", None, None]
PATIENCE = 1.5  # seconds for which a script waits for a result


class Player:
    """Plays a script in the world's time: it yields seconds to wait, or an order whose result it waits for."""

    def __init__(self, world: World, script: Script) -> None:
        self._world = world
        self._script = script
        self._step = 0
        world.after(0.0, lambda: self._go_on(0))

    def end(self) -> None:
        """Let it do nothing any more."""
        self._step = -1
        self._script.close()

    def _go_on(self, step: int) -> None:
        """Play on, unless that was done already."""
        if step != self._step:
            return
        try:
            wait = next(self._script)
        except StopIteration:
            return
        self._step = following = step + 1
        if isinstance(wait, Order):
            wait.when_answered(lambda: self._go_on_soon(following))
            self._world.after(PATIENCE, lambda: self._go_on(following))
        else:
            self._world.after(wait, lambda: self._go_on(following))

    def _go_on_soon(self, step: int) -> None:
        self._world.after(0.0, lambda: self._go_on(step))
