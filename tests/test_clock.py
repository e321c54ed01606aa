"""The alarm: never early, whatever the loop, and set again as often as wanted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
import uvloop

from gateway import clock as clocks
from gateway.clock import Alarm, SystemClock

LOOPS = {"asyncio": asyncio.new_event_loop, "uvloop": uvloop.new_event_loop}


async def earliness(alarm: Alarm, waits: int) -> list[float]:
    """Wait some short times and return by how much each rang early (negative: late)."""
    now = SystemClock().now
    early = []
    for _ in range(waits):
        when = now() + 0.0013
        await alarm.wait_until(when)
        early.append(when - now())
    alarm.close()
    return early


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("make", [SystemClock().alarm, clocks._LoopAlarm], ids=["timerfd", "loop timer"])
def test_an_alarm_never_rings_early(loop: str, make: Callable[[], Alarm]) -> None:
    """The gap on the wire is a minimum."""

    async def main() -> list[float]:
        return await earliness(make(), 20)

    with asyncio.Runner(loop_factory=LOOPS[loop]) as runner:
        assert max(runner.run(main())) <= 0


async def test_a_time_that_has_passed_is_not_waited_for() -> None:
    """At once, without the loop."""
    clock = SystemClock()
    alarm = clock.alarm()
    waiting = alarm.wait_until(clock.now() - 1)
    with pytest.raises(StopIteration):
        waiting.send(None)
    alarm.close()


async def test_a_cancelled_wait_leaves_the_alarm_usable() -> None:
    """A line that is closed and opened again goes on with it."""
    clock = SystemClock()
    alarm = clock.alarm()
    task = asyncio.create_task(alarm.wait_until(clock.now() + 60))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    when = clock.now() + 0.002
    await alarm.wait_until(when)
    assert clock.now() >= when
    alarm.close()


async def test_the_next_alarm_is_the_first_that_somebody_waits_for() -> None:
    """As long as it is waited for: not once it was rung, cancelled or closed."""
    clock = SystemClock()
    first, second = clock.alarm(), clock.alarm()
    assert clocks.next_alarm() == float("inf")
    when = clock.now() + 60.0
    waiting = [asyncio.create_task(alarm.wait_until(at)) for alarm, at in ((first, when), (second, when + 1.0))]
    await asyncio.sleep(0)
    assert clocks.next_alarm() == when - clocks.WAKING
    first.ring()
    await waiting[0]
    assert clocks.next_alarm() == when + 1.0 - clocks.WAKING
    waiting[1].cancel()
    await asyncio.wait(waiting)
    assert clocks.next_alarm() == float("inf")
    for alarm in (first, second):
        alarm.close()
