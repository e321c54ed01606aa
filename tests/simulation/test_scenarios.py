"""Every scenario under many seeds: nothing that must not be, and each run twice the same."""

from __future__ import annotations

import pytest

from tests import soak
from tests.simulation import trial
from tests.simulation.scenarios import SCENARIOS

SEEDS = 100  # twice what the mutant that hides best of those in test_mutants.py takes to be found
pytestmark = pytest.mark.unmeasured
LONG_DAYS = 8
PARTS = 4  # tests a scenario, so that a failure says where to look sooner


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.hazard("H01", "H02", "H03", "H04", "H05", "H09", "H10", "H11", "H12", "H13", "H14", "H23", "H24", "H29")
def test_no_motor_runs_without_permission(scenario: str, part: int) -> None:
    """And no rule of line, door and image is broken; `python -m tests.simulation SCENARIO SEED` tells more."""
    broken = {}
    for seed in range(part, SEEDS * soak.FACTOR, PARTS):
        made = trial.run(scenario, seed)
        if made.violations:
            broken[seed] = made.violations[0]
    assert not broken


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.hazard("H05", "H10", "H14", "H23")
def test_nor_does_one_in_the_course_of_a_long_day(part: int) -> None:
    """Two minutes here; the long search makes it 80 days of 20 minutes, for 100 hours with the other scenarios."""
    seeds = range(part, LONG_DAYS * soak.FACTOR, PARTS)
    broken = {seed: trial.run("long day", seed).violations[:1] for seed in seeds}
    assert not {seed: said for seed, said in broken.items() if said}


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_trial_run_twice_gives_the_same_trace(scenario: str) -> None:
    """Time, chance, line, network and clients all come from the seed."""
    first, second = trial.run(scenario, 7), trial.run(scenario, 7)
    assert first.trace == second.trace
