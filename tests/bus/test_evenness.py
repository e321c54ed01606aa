"""Polls of one period are spread over their drives: the longest gap between two answers is near that period."""

from __future__ import annotations

from itertools import pairwise
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus import selectors
from gateway.bus.blocks import Abilities
from gateway.bus.plan import plan_drive
from gateway.bus.poll_jobs import PollJobs, phases
from gateway.bus.reading import Reading
from gateway.bus.schedule import Job, Schedule, Send, on_grid, spread
from gateway.bus.work import Task, Work
from gateway.drives import catalogue
from tests.test_check import built

NAMES = sorted(filter(None, catalogue.load()["vf-nc3"].read_selectors.values()))
COST = 0.03  # seconds


def joined(polls: list[dict[str, Any]], drives: int, chance: Random) -> tuple[Schedule[Work], dict[str, float]]:
    """Return a line whose drives are set up one after another, at any time, and when that was."""
    (line,) = built(polls, drives).lines
    schedule: Schedule[Work] = Schedule(0.05, 1.0, 5.0)
    times = {}
    for place, drive in enumerate(line.drives):
        now = times[drive.name] = chance.uniform(0, 3.0)
        reading = Reading(drive, plan_drive(drive, line, with_selectors=False).planner, place, drives)
        reading.able = Abilities(no_direct=frozenset(range(0x100)))
        jobs = [job for job in PollJobs(reading).polls(now) if job.work.task is Task.POLL and job.period is not None]
        schedule.set_jobs(drive.name, jobs)
    return schedule, times


def gaps(schedule: Schedule[Work], seconds: float, cost: float) -> dict[tuple[str, int], float]:
    """Run a line that long to let it settle, and as long again; return the longest gap of each drive's register."""
    answers: dict[tuple[str, int], list[float]] = {}
    now = 4.0
    while now < 4.0 + 2 * seconds:
        found = schedule.next(now)
        if not isinstance(found, Send):
            assert found is not None
            now = found.when
            continue
        now += cost
        schedule.done(found.job, now)
        request = found.job.work.read
        assert request is not None
        if now > 4.0 + seconds:
            answers.setdefault((found.job.drive, request.request.address), []).append(now)
    return {key: max(b - a for a, b in pairwise(times)) for key, times in answers.items()}


def test_one_place_on_the_grid_for_each_poll_of_each_drive() -> None:
    """Four drives with four polls a second each: one every sixteenth of a second, whenever they join."""
    places = [
        on_grid(offset, 1.0, now) % 1.0
        for drive, now in enumerate((17.3, 21.09, 100.0, 0.0))
        for offset in spread(4, 1.0, drive / 4)
    ]
    assert sorted(places) == pytest.approx([place / 16 for place in range(16)])


@pytest.mark.unmeasured
@settings(max_examples=40, deadline=None)
@given(st.integers(1, 31), st.integers(1, 4), st.integers(0, 99))
def test_the_longest_gap_is_near_the_period(drives: int, values: int, seed: int) -> None:
    """One period on a line nine tenths full: each poll has a place of its own, and waits for one exchange at most."""
    period = round(drives * values * COST / 0.9, 3)
    polls: list[dict[str, Any]] = [{"values": NAMES[:values], "every": f"{period * 1000:.0f}ms"}]
    schedule, _ = joined(polls, drives, Random(seed))
    found = gaps(schedule, 12 * period, COST)
    assert len(found) == drives * values
    assert max(found.values()) <= period + COST + 1e-6


@pytest.mark.unmeasured
@settings(max_examples=25, deadline=None)
@given(st.integers(2, 16), st.lists(st.integers(1, 3), min_size=3, max_size=3), st.integers(0, 99))
def test_several_groups_leave_each_other_their_places(drives: int, values: list[int], seed: int) -> None:
    """A fast, a middling and a slow group share four fifths of a line: each stays near its period."""
    load = 0.8 / 3
    wanted = iter(NAMES)
    polls: list[dict[str, Any]] = []
    for factor, count in zip((1, 5, 20), values, strict=True):
        period = drives * max(values) * COST / load * factor
        polls.append({"values": [next(wanted) for _ in range(count)], "every": f"{period * 1000:.0f}ms"})
    schedule, _ = joined(polls, drives, Random(seed))
    fastest = drives * max(values) * COST / load
    found = gaps(schedule, 70 * fastest, COST)
    for drive in {drive for drive, _ in found}:
        for job in schedule.jobs(drive):
            assert job.work.read is not None
            assert job.period is not None
            longest = found[drive, job.work.read.request.address]
            assert longest <= job.period + (sum(values) + 1) * COST, (drive, job.period)


@pytest.mark.parametrize("drives", [1, 2, 8, 31])
@pytest.mark.parametrize("beside", [0, 3])
def test_polls_as_fast_as_possible_take_turns(drives: int, beside: int) -> None:
    """Eight drives are never read in batches: each once in every round, with timed polls beside them or without."""
    schedule: Schedule[str] = Schedule(0.05, 1.0, 5.0)
    timed = [Job(f"t{place}", "timed", 1.0, place / 3, place / 3 + 1.0) for place in range(beside)]
    schedule.turn = drives * COST / (0.8 * (1 - beside * COST))
    for drive in range(drives):
        schedule.set_jobs(f"d{drive}", [Job(f"d{drive}", "fast", 0.0, 0.0, 0.0)])
    for job in timed:
        schedule.set_jobs(job.drive, [job])
    now, last, longest = 0.0, {f"d{drive}": 0.0 for drive in range(drives)}, 0.0
    while now < 60.0:
        found = schedule.next(now)
        assert isinstance(found, Send)
        now += COST
        schedule.done(found.job, now)
        if found.job.drive in last:
            longest = max(longest, now - last[found.job.drive])
            last[found.job.drive] = now
    rounds = drives * COST / (1 - beside * COST)
    assert longest <= rounds + (beside + 1) * COST


@pytest.mark.parametrize("drives", [1, 3, 8, 31])
def test_the_checks_of_all_drives_keep_to_their_share(drives: int) -> None:
    """Motors that stand still are checked every 2 s, but together by no more than a twentieth of the line."""
    (line,) = built([{"values": NAMES[:5], "every": "10s"}], drives).lines
    plans = [plan_drive(drive, line, with_selectors=True) for drive in line.drives]
    shares = []
    for plan in plans:
        (check,) = (job for job in plan.jobs if job.work.task is Task.AUDIT)
        every = check.deadline - check.due
        assert every >= selectors.UNPROVEN_EVERY
        shares.append(plan.planner.cost(check.work.request) / every)
    assert sum(shares) <= selectors.AUDIT_SHARE + 1e-9
    if drives < 4:
        assert every == pytest.approx(selectors.UNPROVEN_EVERY, rel=0.05)


def test_drives_of_one_period_are_spread_whoever_else_is_on_the_line() -> None:
    """Four of ten drives are polled each second: a quarter of it apart, whatever the others do."""
    (line,) = built([{"values": ["status"], "every": "1s"}], 4).lines
    (others,) = built([{"values": ["status"], "every": "5s"}], 6).lines
    found = phases([line.drives[0], *others.drives[4:], *line.drives[1:]])
    assert [found[drive.name][1.0] for drive in line.drives] == [0.0, 0.25, 0.5, 0.75]
