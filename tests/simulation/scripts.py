"""What controllers do: take a drive, arm it, run it, change its speed, stop it; for ever, or up to some state."""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal

from gateway.control.command import Verb
from tests.simulation.controllers import Controller
from tests.simulation.orders import Script

STATES = ("before take", "taken", "armed", "starting", "running", "changing speed", "stopping")
STEPS = (Verb.TAKE, Verb.ARM, Verb.RUN)
VALUED = (Verb.RUN, Verb.FREQUENCY)
PAUSE = (0.2, 0.7)  # seconds between two tries
Hertz = Callable[[], Decimal]


def insist(controller: Controller, drive: str, verb: Verb, hertz: Hertz) -> Script:
    """Ask until it is done."""
    while True:
        order = controller.order(drive, verb, hertz() if verb in VALUED else None)
        yield order
        if order.is_done:
            return
        yield controller.chance.uniform(*PAUSE)


def operate(controller: Controller, drive: str, hertz: Hertz) -> Script:
    """Run a drive, and change what it does, again and again; whatever is refused is begun anew.

    Now and then a step is left out, which is to be refused.
    """
    chance = controller.chance
    while True:
        left_out = chance.choice(STEPS) if chance.random() < 0.15 else None
        for verb in STEPS:
            if verb is left_out:
                continue
            order = controller.order(drive, verb, hertz() if verb in VALUED else None)
            yield order
            if not order.is_done:
                break
        while order.is_done:
            yield chance.uniform(0.1, 1.2)
            order = controller.order(drive, *_next(chance.random(), hertz))
            yield order
        yield chance.uniform(*PAUSE)


def _next(draw: float, hertz: Hertz) -> tuple[Verb, Decimal | None]:
    """Choose what to do with a drive that runs, or was stopped."""
    if draw < 0.5:
        return Verb.FREQUENCY, hertz()
    if draw < 0.8:
        return Verb.RUN, hertz()
    return (Verb.STOP if draw < 0.9 else Verb.COAST if draw < 0.95 else Verb.RELEASE), None


def up_to(state: str, controller: Controller, drive: str, hertz: Hertz, reached: Callable[[], None]) -> Script:
    """Go as far as a state, and say that it is reached; then go on."""
    steps: tuple[tuple[str, Verb | None], ...] = (
        ("before take", Verb.TAKE),
        ("taken", Verb.ARM),
        ("armed", Verb.RUN),
        ("starting", None),
        ("running", None),
        ("changing speed", Verb.FREQUENCY),
        ("stopping", Verb.STOP),
    )
    for name, verb in steps:
        if name == state:
            reached()
        if verb is None:
            yield controller.chance.uniform(0.02, 0.6)
        elif verb is Verb.STOP:
            yield controller.order(drive, verb)
        else:
            yield from insist(controller, drive, verb, hertz)
    yield from operate(controller, drive, hertz)


def ask_again_and_again(controller: Controller, drive: str, hertz: Hertz, pause: float) -> Script:
    """Send commands of all kinds without waiting for anything."""
    chance = controller.chance
    while True:
        verb = chance.choice((Verb.TAKE, Verb.ARM, Verb.RUN, Verb.FREQUENCY, Verb.FREQUENCY, Verb.RELEASE))
        controller.order(drive, verb, hertz() if verb in VALUED else None)
        yield pause * chance.uniform(0.5, 1.5)
