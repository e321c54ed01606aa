"""The worst-case response of every poll: by hand, and against many lines that are played with the real schedule."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus.response import EVEN, LEAST_REST, SLACK, Stream, Traffic, turn
from tests.bus.fast_line import COSTS, PERIODS, DisturbedLine, FastLine, Played, disturbed, traffic
from tests.soak import FACTOR

PORTIONS = range(10)  # 10^5 lines in all, 10^6 in `make soak`
LINES = 10_000 * FACTOR
DISTURBED = 1_000 * FACTOR


def test_a_poll_that_is_alone_takes_its_own_time() -> None:
    """Nothing is in its way."""
    assert Traffic([Stream(0.1, 0.03)]).worst == {0.1: pytest.approx(0.03)}


def test_the_urgent_poll_waits_for_the_other_one_once() -> None:
    """The slow one has just begun; the slow one itself waits for all fast ones that come before it begins."""
    worst = Traffic([Stream(0.1, 0.03), Stream(1.0, 0.05)]).worst
    assert worst == {0.1: pytest.approx(0.05 + 0.03), 1.0: pytest.approx(0.03 + 0.05)}


def test_polls_of_one_period_wait_for_each_other() -> None:
    """Four at once: the last one has waited for three."""
    assert Traffic([Stream(0.2, 0.03)] * 4).worst == {0.2: pytest.approx(4 * 0.03)}


def test_what_goes_ahead_is_waited_for_as_often_as_it_comes() -> None:
    """30 ms every 50 ms ahead: one goes before the first poll, and two more before the second."""
    assert Traffic([Stream(0.2, 0.04)], [Stream(0.05, 0.03)]).worst == {0.2: pytest.approx(0.03 + 0.04)}
    two = Traffic([Stream(0.3, 0.04)] * 2, [Stream(0.05, 0.03)])
    assert two.worst == {0.3: pytest.approx(0.03 + 0.04 + 2 * 0.03 + 0.04)}


def test_a_line_at_its_limit_is_kept_and_beyond_it_is_late() -> None:
    """Ten polls of 30 ms in 300 ms; with one more there is no end to it but that nothing starves."""
    full = Traffic([Stream(0.3001, 0.03)] * 10)
    assert full.is_kept
    overfull = Traffic([Stream(0.3, 0.03)] * 11)
    assert overfull.late == (0.3,)
    assert overfull.worst[0.3] == pytest.approx(0.3 + 11 * 0.03 + 0.03)


def test_a_poll_once_a_day_has_its_turn_on_an_overfull_line() -> None:
    """Past its deadline, each other one goes first once; a line that commands alone fill carries no polls."""
    overfull = [Stream(0.03, 0.03), Stream(86_400.0, 0.03)]
    assert Traffic(overfull).worst[86_400.0] == pytest.approx(86_400 + 0.03 + 0.03 + 0.03)
    assert Traffic(overfull, [Stream(0.1, 0.1)]).worst[86_400.0] == float("inf")
    fitting = Traffic([Stream(0.1, 0.03), Stream(86_400.0, 0.03)])
    assert fitting.worst[86_400.0] == pytest.approx(0.06)


def test_polls_without_a_period_are_promised_what_the_others_leave() -> None:
    """Half the line by timed polls: a round of 60 ms in 60 / (0.8 * 0.5); never less than a tenth of the line."""
    half = Traffic([Stream(0.1, 0.05), Stream(0.0, 0.02), Stream(0.0, 0.04)])
    assert half.turn == pytest.approx(0.06 / (0.8 * 0.5))
    assert half.fastest == pytest.approx(0.06 / 0.5)
    assert turn(2.0, 0.06) == pytest.approx(0.06 / LEAST_REST)
    assert 0 < SLACK < 1


def test_polls_without_a_period_alone_wait_for_one_round() -> None:
    """Three of them take turns; the one that has just begun is waited for, at the worst."""
    assert Traffic([Stream(0.0, 0.03)] * 3).worst[0.0] <= 3 * 0.03 + 0.03 + EVEN


def play(seed: int) -> tuple[Traffic, Played]:
    """Play any line: polls spread by chance or all at once, exchanges as long as possible or shorter."""
    chance = Random(seed)
    any_line = traffic(chance)
    offsets = dict.fromkeys(range(len(any_line.polls)), 0.0) if chance.random() < 0.3 else None
    line = FastLine(any_line, chance, chance.choice((1.0, 1.0, 0.5)), offsets)
    return any_line, line.play(chance.choice((30, 60, 120)))


@pytest.mark.unmeasured
@pytest.mark.parametrize("portion", PORTIONS)
def test_no_answer_is_later_than_was_proved_and_nothing_starves(portion: int) -> None:
    """Lines by chance: fitting, full and overfull ones; and the proof is not empty."""
    kept = overfull = near = 0
    for seed in range(portion * LINES, (portion + 1) * LINES):
        any_line, played = play(seed)
        worst = any_line.worst
        for period, late in played.latest.items():
            assert late <= worst[period] + 1e-6, (seed, period)
        kept += any_line.is_kept
        overfull += any_line.load > 1
        near += any(late > 0.9 * worst[period] for period, late in played.latest.items() if worst[period] > 0.1)
    assert kept > 0.15 * LINES
    assert overfull > 0.15 * LINES
    assert near > 0.01 * LINES


@pytest.mark.unmeasured
@pytest.mark.parametrize("portion", PORTIONS)
def test_lost_exchanges_and_silent_drives_make_no_answer_later_than_was_proved(portion: int) -> None:
    """Drives are left alone behind a loss, silent ones are tried, commands come: the bound of `disturbed` lines."""
    losses = tries = near = 0
    for seed in range(portion * DISTURBED, (portion + 1) * DISTURBED):
        chance = Random(seed)
        line = disturbed(chance)
        played = DisturbedLine(line, chance)
        played.play(200)
        worst = line.traffic.worst
        for period, late in played.latest.items():
            assert late <= worst[period] + 1e-6, (seed, period)
        losses, tries = losses + played.losses, tries + played.tries
        near += any(late > 0.5 * worst[period] for period, late in played.latest.items())
    assert losses > DISTURBED
    assert tries > DISTURBED
    assert near > 0.05 * DISTURBED


@given(
    st.lists(st.builds(Stream, st.sampled_from(PERIODS), st.sampled_from(COSTS)), min_size=1, max_size=8),
    st.lists(st.floats(0, 1), min_size=8, max_size=8),
    st.integers(0, 9),
)
def test_no_deadline_is_missed_where_the_proof_says_so(polls: list[Stream], phases: list[float], seed: int) -> None:
    """Whatever the offsets; where it does not, each poll has its turn within the bound all the same."""
    any_line = Traffic(polls)
    pairs = enumerate(zip(polls, phases, strict=False))
    offsets = {place: phase * stream.period for place, (stream, phase) in pairs}
    played = FastLine(any_line, Random(seed), 1.0, offsets).play(60)
    for period, late in played.latest.items():
        assert late <= any_line.worst[period] + 1e-6
        if any_line.is_kept:
            assert late <= (period or 2 * any_line.turn) + 1e-6


@settings(max_examples=50)
@given(st.lists(st.builds(Stream, st.sampled_from(PERIODS), st.sampled_from(COSTS)), min_size=1, max_size=6))
def test_more_polls_are_never_answered_sooner(polls: list[Stream]) -> None:
    """The proof of a part of a line says no more than that of all of it."""
    timed = [stream for stream in polls if stream.period]
    if timed[1:]:
        part, whole = Traffic(timed[1:]).worst, Traffic(timed).worst
        assert all(part[period] <= whole[period] + 1e-6 for period in part)
