"""The schedule: deadlines, grids, fair shares, and what silent drives may cost."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.schedule import AHEAD, Job, NotBefore, Schedule, Send, spread


def schedule(share: float = 0.05) -> Schedule[str]:
    """Return an empty schedule with the default times."""
    return Schedule(silent_share=share, probe_every=1.0, probe_at_most=5.0)


def periodic(drive: str, period: float, due: float = 0.0, work: str = "") -> Job[str]:
    """Return a job with a period."""
    return Job(drive, work or drive, period, due, due + period)


def test_nothing_planned_is_nothing_to_do() -> None:
    """An empty schedule has no next time."""
    assert schedule().next(0.0) is None


def test_the_earliest_deadline_goes_first_and_the_future_waits() -> None:
    """Due jobs by deadline; nothing due: the time of the next."""
    plan = schedule()
    late, soon = periodic("a", 10.0), periodic("b", 0.1)
    plan.set_jobs("a", [late])
    plan.set_jobs("b", [soon])
    assert plan.next(0.0) == Send(soon)
    plan.done(soon, 0.02)
    assert plan.next(0.02) == Send(late)
    plan.done(late, 0.04)
    waiting = plan.next(0.04)
    assert isinstance(waiting, NotBefore)
    assert waiting.when == pytest.approx(0.1)


def test_a_job_stays_on_its_grid_and_skips_what_it_missed() -> None:
    """Late by more than a period: the next slot of the grid, not a burst."""
    plan = schedule()
    job = periodic("a", 0.1)
    plan.set_jobs("a", [job])
    plan.done(job, 0.35)
    assert job.due == pytest.approx(0.4)
    assert job.deadline == pytest.approx(0.5)


def test_a_job_without_period_runs_once() -> None:
    """Then it is gone."""
    plan = schedule()
    job = Job("a", "once", None, 0.0, 0.0)
    plan.set_jobs("a", [job])
    assert plan.next(0.0) == Send(job)
    plan.done(job, 0.0)
    assert plan.next(0.0) is None


def test_equal_periods_are_spread_evenly() -> None:
    """Four jobs of one second stand a quarter apart."""
    assert spread(4, 1.0) == [0.0, 0.25, 0.5, 0.75]


def run(
    plan: Schedule[str], seconds: float, dead: set[str], cost: float = 0.025, silence: float = 0.06
) -> dict[str, float]:
    """Run a schedule in a fast model and count the seconds of line that each drive took."""
    spent: dict[str, float] = defaultdict(float)
    now = 0.0
    while now < seconds:
        step = plan.next(now)
        if isinstance(step, NotBefore):
            now = step.when
            continue
        assert isinstance(step, Send)
        job, begun = step.job, now
        if job.drive in dead:
            now += silence
            spent[job.drive] += silence
            plan.in_vain(job, begun, now)
        else:
            now += cost
            spent[job.drive] += cost
            plan.done(job, now)
    return spent


@given(st.integers(1, 7))
def test_silent_drives_cost_their_share_whatever_their_number(dead: int) -> None:
    """The working drive keeps more than nine tenths of the line."""
    plan = schedule()
    names = {f"dead-{i}" for i in range(dead)}
    for name in names:
        plan.probe(name, name, 0.0)
    plan.set_jobs("alive", [periodic("alive", 0.0)])
    spent = run(plan, 600.0, names)
    assert spent["alive"] > 0.9 * 600
    assert sum(spent[name] for name in names) <= 0.05 * 600 + 0.06 * (dead + 1)  # one try each at once
    assert min(spent[name] for name in names) > 0.5 * max(spent[name] for name in names)  # none is forgotten


def test_a_drive_not_tried_yet_does_not_wait_behind_silent_ones() -> None:
    """At start, thirty silent drives and one that answers: it is asked in the first round."""
    plan = schedule()
    plan.set_jobs("alive", [periodic("alive", 1.0)])
    for index in range(30):
        plan.probe(f"d{index}", "who", 0.0)
    now = 0.0
    asked: set[str] = set()
    while len(asked) < 30:
        step = plan.next(now)
        assert isinstance(step, Send)
        now += 0.06
        if step.is_probe:
            asked.add(step.job.drive)
            plan.in_vain(step.job, now - 0.06, now)
        else:
            plan.done(step.job, now)
    assert now < 2.5


def test_a_held_drive_is_only_asked_who_it_is() -> None:
    """Polls wait, what is ahead of everything does not, other drives neither."""
    plan = schedule()
    held, question = periodic("a", 0.1), Job("a", "who", None, 0.0, AHEAD)
    plan.set_jobs("a", [held])
    plan.hold("a", 0.4)
    plan.add(question)
    plan.set_jobs("b", [periodic("b", 5.0)])
    assert plan.next(0.0) == Send(question)
    plan.done(question, 0.02)
    step = plan.next(0.02)
    assert isinstance(step, Send)
    assert step.job.drive == "b"
    plan.done(step.job, 0.04)
    assert plan.next(0.04) == NotBefore(0.4)


def test_probing_backs_off_up_to_its_limit() -> None:
    """1, 2, 4, 5, 5 ... seconds on an otherwise idle line."""
    plan = schedule(share=1.0)
    plan.probe("a", "who", 0.0)
    now, times = 0.0, []
    for _ in range(6):
        step = plan.next(now)
        assert isinstance(step, Send)
        times.append(now)
        plan.in_vain(step.job, now, now)
        waiting = plan.next(now)
        assert isinstance(waiting, NotBefore)
        now = waiting.when
    assert [b - a for a, b in pairwise(times)] == [1.0, 2.0, 4.0, 5.0, 5.0]


def test_a_drive_that_answers_is_no_longer_probed() -> None:
    """set_jobs ends the probing."""
    plan = schedule()
    plan.probe("a", "who", 0.0)
    assert plan.is_probed("a")
    plan.set_jobs("a", [])
    assert not plan.is_probed("a")


@pytest.mark.unmeasured
@given(
    st.lists(st.sampled_from([0.0, 0.05, 0.1, 0.5, 1.0, 10.0]), min_size=1, max_size=12),
    st.floats(0.005, 0.08),
)
def test_no_job_starves_even_on_an_overfull_line(periods: list[float], cost: float) -> None:
    """Between two runs of a job lie two of its periods and one round of all jobs at the most."""
    plan = schedule()
    plan.turn = cost * len(periods)
    for index, period in enumerate(periods):
        plan.set_jobs(f"d{index}", [periodic(f"d{index}", period)])
    last = dict.fromkeys((f"d{index}" for index in range(len(periods))), 0.0)
    now = 0.0
    while now < 40.0:
        step = plan.next(now)
        if isinstance(step, NotBefore):
            now = step.when
            continue
        assert isinstance(step, Send)
        now += cost
        plan.done(step.job, now)
        last[step.job.drive] = now
        for index, period in enumerate(periods):
            most = 2 * max(period, plan.turn) + (len(periods) + 1) * cost
            assert now - last[f"d{index}"] <= most + 1e-9


# ---- jobs without a period


def test_jobs_without_a_period_have_one_promised_run_in_each_turn_and_the_free_line() -> None:
    """The promised run goes by its deadline; what is done besides, while nothing is due, moves no promise."""
    plan = schedule()
    plan.turn = 0.5
    fast, timed = Job("a", "fast", 0.0, 0.0, 0.0), periodic("b", 1.0)
    plan.set_jobs("a", [fast])
    plan.set_jobs("b", [timed])
    assert plan.next(0.0) == Send(fast)
    plan.done(fast, 0.1)
    assert [fast.due, fast.deadline] == pytest.approx([0.1, 0.6])
    assert plan.next(0.1) == Send(fast)  # promised at once, since the first was late; its deadline is sooner
    plan.done(fast, 0.2)
    assert [fast.due, fast.deadline] == pytest.approx([0.6, 1.1])
    assert plan.next(0.2) == Send(timed)  # has waited for nothing but promised runs
    plan.done(timed, 0.3)
    assert plan.next(0.3) == Send(fast)  # nothing is due: the line is free
    plan.done(fast, 0.4)
    assert [fast.due, fast.deadline] == pytest.approx([0.6, 1.1])


def test_a_timed_job_goes_before_what_is_not_promised() -> None:
    """However seldom it is: a free run waits."""
    plan = schedule()
    fast, timed = Job("a", "fast", 0.0, 5.0, 5.5), periodic("b", 60.0)
    plan.set_jobs("a", [fast])
    plan.set_jobs("b", [timed])
    assert plan.next(0.0) == Send(timed)


def test_the_promised_run_goes_to_the_job_that_waits_longest() -> None:
    """The one whose turn it was has that of the other one later; nobody loses a run."""
    plan = schedule()
    plan.turn = 0.5
    new, old = Job("a", "new", 0.0, 0.0, 0.1, waits_since=0.9), Job("b", "old", 0.0, 2.0, 2.5, waits_since=0.2)
    plan.set_jobs("a", [new])
    plan.set_jobs("b", [old])
    assert plan.next(1.0) == Send(old)
    plan.done(old, 1.05)
    assert (new.due, new.deadline) == (2.0, 2.5)
    assert [old.due, old.deadline] == pytest.approx([1.05, 1.55])


def test_a_held_drive_is_not_read_because_the_line_is_free() -> None:
    """A late answer might be believed: the poll waits, and is awaited."""
    plan = schedule()
    plan.set_jobs("a", [Job("a", "fast", 0.0, 0.0, 0.0)])
    plan.hold("a", 0.4)
    assert plan.next(0.1) == NotBefore(0.4)
    assert plan.most_urgent("a", 0.1) is None
    found = plan.next(0.4)
    assert isinstance(found, Send)
    assert plan.most_urgent("a", 0.4) is found.job


def test_a_job_that_was_held_goes_back_to_its_place_on_the_grid() -> None:
    """One lost frame does not lay the polls of a drive on each other for good."""
    schedule: Schedule[str] = Schedule(0.05, 1.0, 5.0)
    jobs = [Job("d1", str(n), 0.5, n / 10, n / 10 + 0.5) for n in range(5)]
    schedule.set_jobs("d1", jobs)
    schedule.hold("d1", 0.45)
    assert {job.due for job in jobs} == {0.45}
    now = 0.45
    for job in jobs:
        schedule.done(job, now)
        now += 0.02
    assert [round(job.due, 6) for job in jobs] == [0.5, 0.6, 0.7, 0.8, 0.9]


def test_a_poll_is_overdue_when_its_deadline_has_passed() -> None:
    """Not before, not what goes ahead of everything, and not of a drive that is left alone."""
    schedule: Schedule[str] = Schedule(0.05, 1.0, 5.0)
    schedule.set_jobs("d1", [Job("d1", "poll", 0.5, 1.0, 1.5), Job("d1", "first", None, 1.0, AHEAD)])
    assert [schedule.has_overdue(now) for now in (0.9, 1.4, 1.6)] == [False, False, True]
    schedule.suspend("d1")
    assert not schedule.has_overdue(1.6)
