"""The simulation can fail: a gateway in which one rule does not hold is found out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from unittest import mock

import pytest

from gateway.bus.serial_line import DescriptorLine
from gateway.bus.trial import Stage, Trial
from gateway.control.command import Command, Status
from gateway.control.door import Door
from gateway.control.drive_control import DriveControl
from gateway.control.execution import Execution
from gateway.control.lease import Lease
from gateway.control.loss import Loss
from gateway.control.permission import Permission
from gateway.control.results import Results
from gateway.control.state import DriveState
from gateway.image import DriveImage, Image, Quality, Sample
from gateway.mqtt import commands
from gateway.mqtt.message import Message
from tests.simulation import trial

pytestmark = pytest.mark.unmeasured
SEEDS = 200  # trials at the most until a mutant is found out

_sample = DriveImage.sample


def always_good(image: DriveImage, name: str, now: float) -> Sample:
    """Show every value that was ever read as good."""
    sample = _sample(image, name, now)
    return sample if sample.quality is Quality.NEVER_READ else sample._replace(quality=Quality.GOOD)


async def without_gap(line: Any) -> float:
    """Take the line for quiet, whatever was on it just now."""
    return float(line._clock.now())


def no(*_: Any, **__: Any) -> bool:
    """Say no to everything."""
    return False


def yes(*_: Any, **__: Any) -> bool:
    """Say yes to everything."""
    return True


def zero(*_: Any, **__: Any) -> float:
    """Count nothing."""
    return 0.0


_read = commands.read


def fresh(message: Message, *more: Any) -> Any:
    """Read what the broker had kept as if it had just been sent."""
    return _read(replace(message, is_retained=False), *more)


def done(execution: Execution, _text: str) -> None:
    """Call what was not answered done."""
    execution.finish(Status.DONE)


def whatever_runs(tried: Trial) -> None:
    """Try the exchange on a motor that runs, or is commanded."""
    tried._before, tried._stage = dict(tried._after), Stage.TRYING


def broken(*_: Any, **__: Any) -> None:
    """Fail."""
    raise ZeroDivisionError("a defect")


def nothing(*_: Any, **__: Any) -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A gateway with something replaced, and what the simulation says of it."""

    owner: Any
    name: str
    replaced: Callable[..., Any] | property | Endless
    scenario: str
    said: str


class Endless:
    """An attribute of a command that is always far in the future, whatever it is set to."""

    def __get__(self, *_: object) -> float:
        return 1e9

    def __set__(self, *_: object) -> None:
        """Keep nothing."""


ENDLESS = Endless()
YES, NO = property(lambda _: True), property(lambda _: False)

MUTANTS = {
    "a lease never ends": Mutant(Lease, "is_over", no, "death in every state", "beyond permission"),
    "anybody owns a drive": Mutant(DriveState, "is_own", yes, "two fight", "who did not own"),
    "nothing is done for a lost lease": Mutant(Loss, "_do", nothing, "death in every state", "beyond permission"),
    "a drive to be left alone is polled": Mutant(DriveControl, "is_quiet", NO, "noise on the line", "is left alone"),
    "nobody has to arm": Mutant(Permission, "check_state", nothing, "two fight", "never armed"),
    "commands have no deadline": Mutant(Command, "deadline", ENDLESS, "gateway frozen", "after it was asked for"),
    "a standstill is not noticed": Mutant(Door, "_stood_still", zero, "gateway frozen", "after it was asked for"),
    "it ends without stopping": Mutant(Door, "leave", nothing, "terminated", "beyond permission"),
    "old values are good": Mutant(DriveImage, "sample", always_good, "adapter unplugged", "shown as good"),
    "frames follow without a gap": Mutant(DescriptorLine, "quiet", without_gap, "two fight", "3.5 characters"),
    "a command may have no result": Mutant(Execution, "finish", nothing, "two fight", "has no result"),
    "all is called done": Mutant(Execution, "on_silence", done, "noise on the line", "is called done"),
    "a known id is new": Mutant(Results, "is_known", no, "broker fails", "times for one command"),
    "retained commands count": Mutant(commands, "read", fresh, "broker fails", "nobody has asked for it"),
    "a running motor is tried": Mutant(Trial, "_looked", whatever_runs, "gateway killed", "was tried"),
    "a task dies": Mutant(Image, "sweep", broken, "flood", "ended by itself"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_a_gateway_without_one_of_its_rules_is_found_out(name: str) -> None:
    """By what is said of it, in one of the first trials."""
    mutant = MUTANTS[name]
    said: list[str] = []
    with mock.patch.object(mutant.owner, mutant.name, mutant.replaced):
        for seed in range(SEEDS):
            said += trial.run(mutant.scenario, seed).violations
            if any(mutant.said in each for each in said):
                return
    pytest.fail(f"not found out in {SEEDS} trials; said: {said[:5]}")
