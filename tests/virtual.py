"""Virtual time for tests: an asyncio loop whose clock jumps to the next timer, so hours pass in seconds."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Coroutine
from typing import Any, TypeVar

Result = TypeVar("Result")
EPOCH = 1_700_000_000.0  # UTC seconds at which virtual time begins


class _JumpingSelector(selectors.SelectSelector):
    """Never waits: where it would, it moves the loop's clock on."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 1000.0

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        ready = super().select(0)
        if not ready and timeout is None:
            raise AssertionError("the test waits for something that never comes")
        if not ready and timeout is not None and timeout > 0:
            self.now += timeout
        return ready


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop in virtual time."""

    def __init__(self) -> None:
        self._jumping = _JumpingSelector()
        super().__init__(self._jumping)

    def time(self) -> float:
        """Return virtual seconds."""
        return self._jumping.now


def _wake(waiter: asyncio.Future[None]) -> None:
    if not waiter.done():
        waiter.set_result(None)


class VirtualAlarm:
    """A timer of the virtual clock; exact."""

    def __init__(self) -> None:
        self._waiter: asyncio.Future[None] | None = None

    async def wait_until(self, when: float) -> None:
        """Return at `when`."""
        loop = asyncio.get_running_loop()
        if when <= loop.time():
            return
        self._waiter = loop.create_future()
        timer = loop.call_at(when, _wake, self._waiter)
        try:
            await self._waiter
        finally:
            timer.cancel()

    def ring(self) -> None:
        """Let the waiter return at once."""
        if self._waiter is not None:
            _wake(self._waiter)

    def close(self) -> None:
        """Do nothing."""


class VirtualClock:
    """The clock of the running virtual loop."""

    def now(self) -> float:
        """Return virtual monotonic seconds."""
        return asyncio.get_running_loop().time()

    def wall(self) -> float:
        """Return virtual UTC seconds."""
        return EPOCH + self.now()

    def alarm(self) -> VirtualAlarm:
        """Make a timer."""
        return VirtualAlarm()


def run(main: Coroutine[Any, Any, Result]) -> Result:
    """Run a coroutine in virtual time."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(main)
