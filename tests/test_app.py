"""The daemon as a whole in one process: core tasks that end, rates, the order of the end."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from gateway import site
from gateway.app import App
from gateway.bus.line import Line
from gateway.clock import Clock
from gateway.errors import CoreTaskEnded, LineDown
from gateway.image import LinkState
from gateway.metrics import LineStats
from tests import virtual


def configured() -> site.Site:
    """Return a site without broker and servers."""
    line = {"name": "a", "port": "/dev/null", "drive": [{"name": "d1", "number": 1, "model": "vf-nc3"}]}
    return site.build({"gateway": {"name": "g"}, "line": [line]}, "test", Path())


async def no_port(_line: site.Line, _clock: Clock) -> Line:
    """Open nothing."""
    raise LineDown("no such device")



async def broken_port(_line: site.Line, _clock: Clock) -> Line:
    """Fail in a way that is a defect, not a lost line."""
    raise ZeroDivisionError("a defect")


def test_it_runs_without_any_port_until_it_is_stopped() -> None:
    """A missing device is waited for; the end is in order."""

    async def main() -> App:
        app = App(configured(), virtual.VirtualClock(), no_port)
        running = asyncio.create_task(app.run())
        await asyncio.sleep(60)
        assert not running.done()
        assert app.image.drives[0].link is LinkState.LINE_DOWN
        assert app.status() == "0 of 1 lines up, 0 of 1 drives online"
        app.stop()
        await running
        return app

    assert "no such device" not in virtual.run(main()).image.drives[0].reason


@pytest.mark.hazard("H18")
def test_a_core_task_that_fails_ends_the_process_with_its_reason() -> None:
    """No gateway that lives on without one of its lines."""

    async def main() -> None:
        await App(configured(), virtual.VirtualClock(), broken_port).run()

    with pytest.raises(ZeroDivisionError, match="a defect"):
        virtual.run(main())


@pytest.mark.hazard("H18")
def test_a_core_task_that_merely_ends_is_an_error_too() -> None:
    """It never should."""

    async def main() -> None:
        app = App(configured(), virtual.VirtualClock(), no_port)

        async def over() -> None:
            return

        app.workers[0].run = over  # type: ignore[method-assign]
        await app.run()

    with pytest.raises(CoreTaskEnded, match="line a"):
        virtual.run(main())


def test_load_and_rate_are_counted_over_each_second() -> None:
    """Half a second busy in one second, ten exchanges."""

    async def main() -> LineStats:
        app = App(configured(), virtual.VirtualClock(), no_port)
        running = asyncio.create_task(app.run())
        line = app.stats.lines["a"]
        await asyncio.sleep(5.05)
        for _ in range(100):
            line.exchanges += 1
            line.busy += 0.05
            await asyncio.sleep(0.1)
        app.stop()
        await running
        return line

    line = virtual.run(main())
    assert line.load == pytest.approx(0.5, abs=0.06)
    assert line.rate == pytest.approx(10, abs=1.2)
