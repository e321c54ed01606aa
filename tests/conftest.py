"""What all tests share: how hypothesis searches."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, Phase, settings

from tests.soak import FACTOR

# A busy machine is no failure: no time limits. In CI the same examples every time; at home new ones. Where tests are
# to fail (`make prove`) nobody looks for the simplest example.
PHASES = (Phase.explicit, Phase.generate) if "TOSVERT_PROVE" in os.environ else tuple(Phase)
settings.register_profile(
    "project",
    deadline=None,
    derandomize="CI" in os.environ,
    max_examples=100 * FACTOR,
    phases=PHASES,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("project")
