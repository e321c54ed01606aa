"""What happens to a drive."""

from __future__ import annotations

import ast
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

import gateway.control
from gateway.control.command import Channel, Command, Result, Source, Status, Verb
from gateway.image import LinkState
from gateway.mqtt import events
from gateway.mqtt.events import CODE_WITHIN, Event, Events
from tests.mqtt import drives

CONTROL = Path(gateway.control.__file__).parent


class Watched:
    """One drive, and what was told of it."""

    def __init__(self) -> None:
        self.image = drives.image()
        self.pump = self.image.drives[0]
        self.events = Events(self.image)
        self.now = 0.0
        self.told: list[Event] = []
        self.image.subscribe(lambda image, names: self.told.extend(self.events.notice(image, names, self.now)))

    def news(self) -> list[tuple[str, str]]:
        """Return kind and reason of what was told since this was asked last."""
        told, self.told = self.told, []
        return [(event.kind, event.reason) for event in told]

    def look(self, now: float) -> list[tuple[str, str]]:
        """Let time pass."""
        self.now = now
        self.told += self.events.look(now)
        return self.news()


def test_a_trip_is_told_with_its_code_and_text() -> None:
    """Once, when the code is read."""
    made = Watched()
    made.pump.set_tripped(False)
    drives.read(made.pump, 0.0, trip_code=0)
    made.pump.set_tripped(True)
    assert made.news() == []
    drives.read(made.pump, 0.1, trip_code=1)
    assert [event.more for event in made.told] == [{"code": 1}]
    assert made.news() == [("trip", "OC1: overcurrent during acceleration")]
    drives.read(made.pump, 0.2, trip_code=1)
    assert made.look(60.0) == []


def test_a_trip_that_nobody_was_told_of_is_found_by_the_next_look() -> None:
    """Also where the drive was looked at before and all was quiet."""
    made = Watched()
    made.pump.set_tripped(False)
    assert made.look(1.0) == []
    made.pump.is_tripped = True
    drives.read(made.pump, 1.1, output_frequency=1)
    assert made.news() == []
    drives.read(made.pump, 1.2, trip_code=1)
    assert made.news() == [("trip", "OC1: overcurrent during acceleration")]


def test_a_trip_whose_code_came_with_it_is_told_at_once() -> None:
    """The code may be the sign of the trip."""
    made = Watched()
    made.pump.set_tripped(False)
    drives.read(made.pump, 0.0, trip_code=1)
    assert made.news() == []
    made.pump.set_tripped(True)
    assert made.news() == [("trip", "OC1: overcurrent during acceleration")]


def test_a_trip_whose_code_is_not_read_in_time_is_told_without() -> None:
    """Late news of a trip helps nobody."""
    made = Watched()
    made.pump.set_tripped(False)
    made.pump.set_tripped(True)
    assert made.look(CODE_WITHIN / 2) == []
    made.told += made.events.look(CODE_WITHIN)
    assert [event.more for event in made.told] == [{"code": None}]
    assert made.news() == [("trip", "")]


def test_a_trip_that_is_over_before_its_code_was_read_is_told_all_the_same() -> None:
    """Then that it is over."""
    made = Watched()
    made.pump.set_tripped(False)
    made.pump.set_tripped(True)
    made.pump.set_tripped(False)
    assert [kind for kind, _ in made.news()] == ["trip", "trip_cleared"]


def test_a_drive_that_was_tripped_before_anybody_looked_is_no_event() -> None:
    """It is a state, which `tripped` tells; that it is over is one."""
    made = Watched()
    made.pump.set_tripped(True)
    assert made.look(10.0) == []
    made.pump.set_tripped(False)
    assert made.news() == [("trip_cleared", "")]


def test_a_trip_while_the_link_was_lost_is_told_when_it_is_back() -> None:
    """It was not tripped when it was seen last."""
    made = Watched()
    made.pump.set_tripped(False)
    made.pump.set_link(LinkState.OFFLINE, "silent")
    assert made.news() == [("link_lost", "silent")]
    made.pump.set_link(LinkState.ONLINE)
    made.pump.set_tripped(True)
    drives.read(made.pump, 0.1, trip_code=1)
    assert [kind for kind, _ in made.news()] == ["link_restored", "trip"]


def test_a_doubt_about_the_link_is_no_loss() -> None:
    """A lost frame is no event."""
    made = Watched()
    made.pump.set_link(LinkState.SUSPECT, "no answer")
    made.pump.set_link(LinkState.ONLINE)
    assert made.news() == []


def test_settings_that_wait_for_a_reset_and_that_it_is_done_are_events() -> None:
    """As they come."""
    made = Watched()
    made.pump.set_reset_needed(True)
    made.pump.set_reset_needed(False)
    assert made.news() == [("reset_needed", ""), ("reset_done", "")]


def test_a_reset_by_command_is_an_event_when_it_is_done() -> None:
    """No other command, and none that was refused."""
    reset = Command("pump-1", Verb.RESET, Source(Channel.MQTT, "hmi"), 0.0, 1.0)
    assert events.of_result(Result(reset, Status.DONE)) == Event("pump-1", "reset", "asked for by mqtt hmi")
    assert events.of_result(Result(reset, Status.REFUSED)) is None
    stop = Command("pump-1", Verb.STOP, Source(Channel.MQTT), 0.0, 1.0)
    assert events.of_result(Result(stop, Status.DONE)) is None


def test_every_event_of_control_is_known_by_name() -> None:
    """Home Assistant wants them all in advance."""
    called: set[str] = set()
    for path in CONTROL.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "tell":
                called |= {a.value for a in node.args[:1] if isinstance(a, ast.Constant) and isinstance(a.value, str)}
    assert called | {"lease_lost", "released"} == set(events.OF_CONTROL)


steps = st.lists(st.sampled_from(["trip", "clear", "unknown", "code", "lost", "back", "wait"]), max_size=40)


@given(steps=steps)
def test_trips_and_their_ends_alternate(steps: list[str]) -> None:
    """Whatever happens, no trip is told twice and none is cleared that was not."""
    made = Watched()
    made.pump.set_tripped(False)
    for step in steps:
        made.now += 0.5
        match step:
            case "trip" | "clear":
                made.pump.set_tripped(step == "trip")
            case "unknown":
                made.pump.set_tripped(None)
            case "code":
                drives.read(made.pump, made.now, trip_code=1)
            case "lost" | "back":
                made.pump.set_link(LinkState.OFFLINE if step == "lost" else LinkState.ONLINE, step)
            case _:
                made.told += made.events.look(made.now)
    told = [event.kind for event in made.told if event.kind.startswith("trip")]
    assert told == [("trip", "trip_cleared")[i % 2] for i in range(len(told))]
    links = [event.kind for event in made.told if event.kind.startswith("link")]
    assert links == [("link_lost", "link_restored")[i % 2] for i in range(len(links))]
