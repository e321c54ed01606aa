"""Runs one trial: a scenario with a seed. The same seed gives the same course of events, to the microsecond."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from tests.simulation.loop import SimulatedLoop
from tests.simulation.plant import Plant
from tests.simulation.scenarios import LONG, SCENARIOS
from tests.simulation.world import World


@dataclass(frozen=True, slots=True)
class Trial:
    """What came of a trial. `worst` and `worst_calm` in seconds beyond permission, in all and undisturbed."""

    name: str
    seed: int
    violations: tuple[str, ...]
    digest: str
    seconds: float
    frames: int
    driven: bool
    worst: float
    worst_calm: float
    trace: tuple[tuple[object, ...], ...]


def run(name: str, seed: int) -> Trial:
    """Run a trial to its end."""
    scenario = (SCENARIOS | LONG)[name]
    world = World(f"{name} {seed}")
    loop = SimulatedLoop(world)
    begun = world.now

    async def main() -> Plant:
        plant = Plant(world, loop, scenario.setup(world.chance("setup")), f"{name} {seed}")
        world.note(plant.setup)
        with plant.living():
            await scenario.play(plant)
            await plant.end()
        return plant

    with asyncio.Runner(loop_factory=lambda: loop) as runner:
        plant = runner.run(main())
    watched = plant.oracle.watched.values()
    return Trial(
        name,
        seed,
        tuple(plant.violations),
        world.digest(),
        world.now - begun,
        plant.wire.statistics.requests,
        any(w.was_ever_driven for w in watched),
        max(w.worst for w in watched),
        max(w.worst_calm for w in watched),
        tuple(world.trace),
    )
