from __future__ import annotations

import asyncio

import pytest

from gateway.bus.line import Line
from gateway.errors import LineDown
from gateway.protocol.timing import LineTiming
from gateway.sim.twin import TwinLine
from tests.sim.rig import framed
from tests.sim.test_wire import ANSWER, BAUD, EXCHANGE, GAP, READ, line
from tests.virtual import VirtualClock, run

FOREVER = 1e9


def twin(**settings: object) -> tuple[TwinLine, VirtualClock]:
    """Make a line in memory with one drive; to be called in the running loop."""
    clock = VirtualClock()
    return TwinLine(line(**settings), LineTiming(BAUD), clock), clock


def test_it_is_a_line_for_the_bus() -> None:
    """The protocol of the bus's line is kept, as far as types say."""

    async def main() -> Line:
        return twin()[0]

    assert not run(main()).is_pty


def test_an_exchange_takes_the_time_of_the_wire() -> None:
    """From the first bit to the last, and then the gap before the next one."""

    async def main() -> None:
        port, clock = twin()
        first = await port.write(READ)
        assert await port.read(FOREVER) == ANSWER
        assert clock.now() - first == pytest.approx(EXCHANGE)
        second = await port.write(READ)
        assert second - first == pytest.approx(EXCHANGE + GAP)
        assert await port.read(FOREVER) == ANSWER
        assert port.wire.statistics.gap_violations == 0

    run(main())


def test_the_gap_counts_from_the_answer_s_own_end() -> None:
    """Who comes back later than the gap waits no more."""

    async def main() -> None:
        port, clock = twin()
        await port.write(READ)
        await asyncio.sleep(1)
        before = clock.now()
        assert await port.write(READ) == before
        assert await port.read(FOREVER) == ANSWER

    run(main())


def test_silence_ends_at_the_deadline() -> None:
    """A dropped answer is b"" when the time is over, not before."""

    async def main() -> None:
        port, clock = twin(fault=[{"kind": "drop"}])
        begun = await port.write(READ)
        assert await port.read(begun + 0.1) == b""
        assert clock.now() == pytest.approx(begun + 0.1)

    run(main())


def test_draining_throws_away_until_it_is_quiet() -> None:
    """An answer and its duplicate are counted and gone."""

    async def main() -> None:
        port, clock = twin(fault=[{"kind": "duplicate", "value": 0.01}])
        begun = await port.write(READ)
        assert await port.drain(0.05, 1.0) == 2 * len(ANSWER)
        assert clock.now() - begun < 0.1
        assert await port.read(clock.now() + 0.1) == b""

    run(main())


def test_a_write_discards_what_has_arrived() -> None:
    """The rest of an old answer is not taken for the next one's."""

    async def main() -> None:
        port, _ = twin()
        await port.write(READ)
        await asyncio.sleep(0.1)
        await port.write(framed("03 FB07 0001"))
        assert await port.read(FOREVER) == framed("03 02 00D0")
        port.close()

    run(main())


@pytest.mark.hazard("H14")
def test_an_unplugged_twin_is_a_line_that_is_down() -> None:
    """Every call says so, and a new twin on the same wire works."""

    async def main() -> None:
        port, clock = twin()
        await port.write(READ)
        port.unplug()
        for call in (port.read(FOREVER), port.write(READ), port.drain(0.1, 1.0)):
            with pytest.raises(LineDown):
                await call
        again = TwinLine(port.wire, LineTiming(BAUD), clock)
        await again.write(READ)
        assert await again.read(FOREVER) == ANSWER

    run(main())
