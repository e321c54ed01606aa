"""What silent drives cost the others, and how soon one that returns is read again; in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from itertools import pairwise

import pytest

from gateway.bus import traffic
from gateway.image import LinkState
from gateway.sim.faults import Fault, Kind
from tests.bus.rig import FIVE, Bench, bench, nc3, run

PROBE_AT_MOST = 5.0  # seconds, by default
SET_UP = 1.5  # seconds from the first answer of a drive to its first values
LATE = 0.05  # seconds that an exchange under way may take
SPAN = 30.0  # seconds
IDENTIFY = 0x2B  # MODBUS function
BLOCK = bytes.fromhex("18 75")
EVERY = [{"values": FIVE, "every": "100ms"}]


def times(stage: Bench, drive: str) -> list[float]:
    """Return when a drive's values came."""
    return [time for name, names, time in stage.applied if name == drive and len(names) >= 5]


@pytest.mark.unmeasured
@pytest.mark.parametrize("every", ["0s", "50ms"])
@pytest.mark.parametrize("dead", [1, 7])
def test_the_drive_that_is_left_keeps_nine_tenths_of_its_rate(dead: int, every: str) -> None:
    """Up to seven of eight dead, against what the drive has when the line is its own."""

    async def play(stage: Bench) -> None:
        for number in range(2, 9):
            stage.wire.faults.add(Fault(Kind.CUT, number))
        await asyncio.sleep(20.0)
        stage.applied.clear()
        silent = -sum(stats.timeouts for stats in stage.drive_stats.values())
        await asyncio.sleep(SPAN)
        rates.append(len(times(stage, "d1")) / SPAN)
        silent += sum(stats.timeouts for stats in stage.drive_stats.values())
        shares.append(silent * traffic.silence(stage.configured.lines[0], stage.configured.drives[-1]) / SPAN)

    rates: list[float] = []
    shares: list[float] = []
    polls = [{"values": FIVE, "every": every}]
    run(lambda: bench([nc3(1)], polls), play)
    run(lambda: bench([nc3(number) for number in range(1, 2 + dead)], polls), play)
    alone, beside = rates
    assert beside >= 0.9 * alone
    assert 0 < shares[1] <= 0.055  # 5 %, and the try that the minute begins with


def deafen(stage: Bench, number: int, deaf_to: Callable[[bytes], bool]) -> None:
    """Let a drive give no answer to some frames."""
    drive = stage.wire.drives[number - 1]
    answer = drive.handle

    def handle(frame: bytes, now: float) -> tuple[bytes | None, float]:
        return (None, 0.0) if deaf_to(frame) else answer(frame, now)

    drive.handle = handle  # type: ignore[method-assign]  # this one drive only


@pytest.mark.unmeasured
@pytest.mark.parametrize("half_dead", [1, 7])
def test_drives_that_only_say_who_they_are_cost_no_more_than_silent_ones(half_dead: int) -> None:
    """They are there, and each poll costs a time-out: they are polled ever more seldom."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(10.0)
        stage.applied.clear()
        await asyncio.sleep(SPAN)
        before = len(times(stage, "d1"))
        for number in range(2, 2 + half_dead):
            deafen(stage, number, lambda frame: frame[1] != IDENTIFY)
        await asyncio.sleep(60.0)
        stage.applied.clear()
        await asyncio.sleep(SPAN)
        assert len(times(stage, "d1")) >= 0.9 * before

    polls = [{"values": FIVE, "every": "300ms"}]
    run(lambda: bench([nc3(number) for number in range(1, 2 + half_dead)], polls), play)


def test_a_block_that_is_not_answered_any_more_is_given_up() -> None:
    """Its values come by other reads; after a reset it is tried again."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0)
        deafen(stage, 1, lambda frame: frame[2:4] == BLOCK)
        await asyncio.sleep(20.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert stage.value("d1", "output_frequency") == "0.00"

    run(lambda: bench([nc3(1)], EVERY), play)


@pytest.mark.unmeasured
@pytest.mark.parametrize("away", [0.15, 0.5, 3.0, 60.0])
@pytest.mark.parametrize("moment", [0.0, 0.037, 0.081])
def test_a_drive_that_returns_is_read_within_one_interval_of_tries(away: float, moment: float) -> None:
    """Cut off for one poll or for a minute: two of its periods, or one interval of tries and its setting up."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0 + moment)
        stage.wire.faults.add(Fault(Kind.CUT, 2))
        await asyncio.sleep(away)
        stage.wire.faults.clear()
        back = asyncio.get_running_loop().time()
        await asyncio.sleep(PROBE_AT_MOST + SET_UP)
        found = [time for time in times(stage, "d2") if time > back]
        assert found
        assert found[0] - back <= PROBE_AT_MOST + SET_UP
        if away <= 0.5:  # the first interval is a second; one that was not lost is left alone for less
            assert found[0] - back <= (1.0 if away < 0.2 else 1.5)
        assert stage.link("d2") is LinkState.ONLINE

    run(lambda: bench([nc3(1), nc3(2)], EVERY), play)


def test_while_nobody_answers_every_drive_is_tried_each_interval() -> None:
    """A dead line owes nobody a share: all eight are back within one interval of tries."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        stage.wire.faults.add(Fault(Kind.CUT))
        await asyncio.sleep(60.0)
        assert all(stage.link(f"d{number}") is LinkState.OFFLINE for number in range(1, 9))
        stage.wire.faults.clear()
        await asyncio.sleep(PROBE_AT_MOST + 8 * SET_UP)
        assert all(stage.link(f"d{number}") is LinkState.ONLINE for number in range(1, 9))

    polls = [{"values": FIVE, "every": "500ms"}]
    run(lambda: bench([nc3(number) for number in range(1, 9)], polls), play)


def test_a_drive_that_is_set_up_does_not_hold_up_the_others() -> None:
    """A neighbour joins: the longest gap of the one that is read stays within a few of its periods."""

    async def play(stage: Bench) -> None:
        stage.wire.faults.add(Fault(Kind.CUT, 2))
        await asyncio.sleep(10.0)
        stage.wire.faults.clear()
        stage.applied.clear()
        await asyncio.sleep(10.0)
        assert stage.link("d2") is LinkState.ONLINE
        longest = max(b - a for a, b in pairwise(times(stage, "d1")))
        assert longest <= 0.4 + LATE

    run(lambda: bench([nc3(1), nc3(2)], [{"values": FIVE, "every": "200ms"}]), play)


def test_measured_responses_stay_below_what_was_reckoned() -> None:
    """Eight drives, two groups, on a line that fits: once all are set up, none is later than `check` says."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(10.0)
        responses = [each for stats in stage.drive_stats.values() for each in stats.responses.values()]
        assert len(responses) == 16
        for each in responses:
            each.worst, each.late = 0.0, 0
        await asyncio.sleep(60.0)
        assert all(0 < each.worst <= each.predicted <= each.disturbed for each in responses)
        assert not any(each.late for each in responses)

    polls = [{"values": FIVE, "every": "500ms"}, {"values": ["trip_code"], "every": "5s"}]
    run(lambda: bench([nc3(number, running_at=50.0) for number in range(1, 9)], polls), play)
