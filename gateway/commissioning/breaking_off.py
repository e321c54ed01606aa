"""Ends a command by a signal in order: its work is cancelled once, and what must be put back is put back first."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Coroutine
from typing import Any, TypeVar

from gateway.errors import GatewayError

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Result = TypeVar("Result")


class BrokenOff(GatewayError):
    """A signal has ended a command; `number` is that of the signal."""

    def __init__(self, by: signal.Signals) -> None:
        super().__init__(f"broken off by {by.name}: what is not reported above may have been done all the same")
        self.number = int(by)


def carry_out(work: Coroutine[Any, Any, Result]) -> Result:
    """Run work to its end; the first signal cancels it, later ones change nothing. BrokenOff where one did.

    A signal that the caller has set to be ignored (nohup) stays ignored.
    """
    heard: list[signal.Signals] = []

    async def main() -> Result:
        loop, task = asyncio.get_running_loop(), asyncio.current_task()

        def end(by: signal.Signals) -> None:
            heard.append(by)
            if len(heard) == 1 and task is not None:
                task.cancel()

        for each in SIGNALS:
            if signal.getsignal(each) is not signal.SIG_IGN:
                loop.add_signal_handler(each, end, each)
        return await work

    try:
        return asyncio.run(main())
    except asyncio.CancelledError:
        if not heard:
            raise
        raise BrokenOff(heard[0]) from None


async def to_the_end(work: Coroutine[Any, Any, None]) -> None:
    """Do work that must not be left half done: who is cancelled meanwhile is cancelled when it is over."""
    task = asyncio.ensure_future(work)
    is_cancelled = False
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError:
            is_cancelled = True
    task.result()
    if is_cancelled:
        raise asyncio.CancelledError
