"""Every scenario under many seeds: nothing that must not be, and each run twice the same."""

from __future__ import annotations

import pytest

from tests import soak
from tests.simulation import trial
from tests.simulation.scenarios import SCENARIOS

SEEDS = 200
pytestmark = pytest.mark.played
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


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_a_trial_run_twice_gives_the_same_trace(scenario: str) -> None:
    """Time, chance, line, network and clients all come from the seed."""
    first, second = trial.run(scenario, 7), trial.run(scenario, 7)
    assert first.trace == second.trace
