"""What must hold at the gateway's door and in what it shows: one true result a command, bounds, nothing stale."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from unittest import mock

from gateway.app import App
from gateway.control.command import Answer, Command, Result, Status, Verb
from gateway.control.composing import COMMAND, FREQUENCY, runs
from gateway.control.door import Door
from gateway.control.state import WAITING
from gateway.image import Quality
from gateway.sim.drive import SimulatedDrive
from gateway.sim.journal import Entry, Way
from tests.simulation.setup import Setup
from tests.simulation.world import World

STOPS = 2  # executions that may be in a queue beside those that wait: stops have no limit to keep
SETTLED = 2.0  # seconds after a trip or a reset of a drive, in which what was done may be undone already


@dataclass(slots=True)
class Asked:
    """One command at the door, and how many results it had."""

    command: Command
    results: int = 0


@dataclass(slots=True)
class DoorRules:
    """Judges one trial's commands and values. `tell` takes what must not be."""

    world: World
    setup: Setup
    drives: dict[str, SimulatedDrive]
    tell: Callable[[str], None]
    asked: dict[int, Asked] = field(default_factory=dict)  # that have no result yet
    answered: dict[int, float] = field(default_factory=dict)  # by number: when an undamaged answer was heard last
    undone: dict[str, float] = field(default_factory=dict)  # when a drive was reset, tripped or swapped last

    @contextlib.contextmanager
    def applied(self) -> Iterator[None]:
        """Stand beside every door."""
        submit = Door.submit

        def watched(door: Door, command: Command, answer: Answer) -> None:
            submit(door, command, self._asked(command, answer))

        with mock.patch.object(Door, "submit", watched):
            yield

    def _asked(self, command: Command, answer: Answer) -> Answer:
        asked = Asked(command)
        self.asked[id(asked)] = asked
        self.world.note("submit", command.drive, command.verb.value, str(command.source), command.id)

        def told(result: Result) -> None:
            asked.results += 1
            self.asked.pop(id(asked), None)
            if asked.results > 1:
                self.tell(f"{command.verb} of {command.source} has {asked.results} results")
            self._judge(command, result)
            answer(result)

        return told

    def _judge(self, command: Command, result: Result) -> None:
        """See whether what is called done was done: the drive knows."""
        end = (result.status.value, result.reason.value)
        self.world.note("result", command.drive, command.verb.value, command.id, *end)
        drive = self.drives.get(command.drive)
        is_shaken = self.undone.get(command.drive, 0.0) > self.world.now - SETTLED
        if result.status is not Status.DONE or drive is None or is_shaken or result.command is not command:
            return
        memory = drive.inverter.memory
        word = memory.word(COMMAND)
        is_run = runs(drive.model.registers[COMMAND], word)
        if command.verb is Verb.RUN and not is_run and not drive.inverter.condition.is_tripped:
            self.tell(f"run of {command.source} is called done, and {command.drive} has {word:04X}H")
        if command.verb.is_stopping and is_run and not drive.inverter.condition.is_tripped:
            self.tell(f"{command.verb} of {command.source} is called done, and {command.drive} has {word:04X}H")
        if command.verb is Verb.FREQUENCY and memory.word(FREQUENCY) != int((command.value or 0) * 100):
            self.tell(f"{command.value} Hz is called done, and {command.drive} has {memory.word(FREQUENCY)}")

    def ended(self) -> None:
        """See that every command has had its result, now that the gateway's process is over."""
        for asked in self.asked.values():
            command = asked.command
            self.tell(f"{command.verb} of {command.source} for {command.drive} has no result")
        self.asked.clear()

    # ---- what is shown, and what waits

    def heard(self, entry: Entry) -> None:
        """Take what was heard on the line."""
        if entry.way is Way.HEARD and entry.drive is not None:
            self.answered[entry.drive] = self.world.now

    def look(self, app: App) -> None:
        """Look at what is shown, and at what waits."""
        now, limit = self.world.now, self.setup.max_age + self.setup.exchange
        for image in app.image.drives if now > self.world.napped + 2 * self.setup.poll else ():
            age = now - self.answered.get(image.drive.number, float("-inf"))
            if age <= limit:
                continue
            for name in image.points:
                if image.sample(name, now).quality is Quality.GOOD:
                    self.tell(f"{name} of {image.drive.name} is shown as good; it answered {age:.3f} s ago")
        for name, control in app.door.controls.items():
            if len(control.state.queue.executions) > WAITING + STOPS:
                self.tell(f"{len(control.state.queue.executions)} commands wait for {name}")
        for broker in app.site.config.brokers:
            if (waiting := app.stats.brokers[broker.origin].waiting) > broker.queue:
                self.tell(f"{waiting} messages wait for the broker")
