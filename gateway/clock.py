"""Time as an argument: the clock and the alarm that the daemon runs by, and their system version."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import math
import os
import time
from typing import Protocol

TFD_NONBLOCK = os.O_NONBLOCK  # timerfd_create(2) uses the open(2) flags
TFD_CLOEXEC = os.O_CLOEXEC
TFD_TIMER_ABSTIME = 1
WAKING = 0.00006  # seconds that the event loop needs to wake who waits: the timer is set that much earlier
LOOP_TIMER_STEP = 0.001  # seconds; a loop timer may ring up to one step early


class Alarm(Protocol):
    """A single waiter's timer, exact to some ten microseconds where the system allows."""

    async def wait_until(self, when: float) -> None:
        """Return at `when` (monotonic seconds), never before it unless it is rung."""
        ...

    def ring(self) -> None:
        """Let the waiter, if there is one, return at once."""
        ...

    def close(self) -> None:
        """Give the timer back."""
        ...


class Clock(Protocol):
    """Monotonic seconds for everything that waits, UTC seconds for what is shown to people."""

    def now(self) -> float:
        """Return monotonic seconds."""
        ...

    def wall(self) -> float:
        """Return seconds since 1970 UTC."""
        ...

    def alarm(self) -> Alarm:
        """Make a timer for one waiter."""
        ...


_due: dict[int, float] = {}  # when the exact alarms of this process ring that are waited for, by descriptor


def next_alarm() -> float:
    """Return when the first exact alarm of this process rings (monotonic seconds); infinity where none is waited for.

    Who has much to do that bears waiting keeps clear of that moment: it may be the end of a gap.
    """
    return min(_due.values(), default=math.inf)


class SystemClock:
    """The machine's clock."""

    now = staticmethod(time.monotonic)  # as it is: it is asked for each request of a MODBUS-TCP client

    def wall(self) -> float:
        """Return seconds since 1970 UTC."""
        return time.time()

    def alarm(self) -> Alarm:
        """Make a timerfd alarm; where the system has none, one by the event loop's own timers."""
        try:
            return _TimerFd()
        except (OSError, AttributeError):
            return _LoopAlarm()


class _LoopAlarm:
    """Wait by the event loop's timers; uvloop's count whole milliseconds, so it may be late by one."""

    def __init__(self) -> None:
        self._rung = asyncio.Event()

    async def wait_until(self, when: float) -> None:
        self._rung.clear()
        while (left := when - time.monotonic()) > 0 and not self._rung.is_set():
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._rung.wait(), left + LOOP_TIMER_STEP)

    def ring(self) -> None:
        self._rung.set()

    def close(self) -> None:
        """Do nothing: there is nothing to give back."""


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class _ItimerSpec(ctypes.Structure):
    _fields_ = (("interval", _Timespec), ("value", _Timespec))


class _TimerFd:
    """Wait by a timerfd in the event loop: the 3.5-character gap does not bear whole-millisecond timers."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self._settime = libc.timerfd_settime
        self._fd: int = libc.timerfd_create(time.CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC)
        if self._fd < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._spec = _ItimerSpec()
        self._spec_address = ctypes.byref(self._spec)
        self._waiter: asyncio.Future[bool] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    async def wait_until(self, when: float) -> None:
        if when > time.monotonic() + WAKING and not await self._is_time(when - WAKING):
            return
        while time.monotonic() < when:  # what the loop would take longer to do
            pass

    async def _is_time(self, when: float) -> bool:
        """Wait until that time, or until it is rung; say whether it was not."""
        if self._loop is None:
            self._loop = asyncio.get_running_loop()
            self._loop.add_reader(self._fd, self._rang)
        nanoseconds = max(1, int(when * 1e9))
        self._spec.value.seconds, self._spec.value.nanoseconds = divmod(nanoseconds, 1_000_000_000)
        self._waiter = self._loop.create_future()
        self._settime(self._fd, TFD_TIMER_ABSTIME, self._spec_address, None)
        _due[self._fd] = when
        try:
            return await self._waiter
        finally:
            self._waiter = None
            _due.pop(self._fd, None)

    def _rang(self) -> None:
        with contextlib.suppress(BlockingIOError):  # set anew between ringing and reading
            os.read(self._fd, 8)
        self._wake(is_time=True)

    def ring(self) -> None:
        self._wake(is_time=False)

    def _wake(self, *, is_time: bool) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(is_time)

    def close(self) -> None:
        """Close the descriptor."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.remove_reader(self._fd)
        _due.pop(self._fd, None)
        os.close(self._fd)
