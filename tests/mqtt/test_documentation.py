"""docs/mqtt.md is true: its commands are read, its topics are those of the code, and it leaves none out."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from gateway.config import MqttSection
from gateway.control.command import Channel, Command, Result, Source, Status, Verb
from gateway.control.state import Standing
from gateway.mqtt import commands, events, inbox, intake, outcome
from gateway.mqtt.description import Description
from gateway.mqtt.message import Message, Moment
from tests.mqtt.doors import LEASED, READ_ONLY, KeptDoor, StandingClock, nc3
from tests.mqtt.test_discovery import image

PAGE = (Path(__file__).parents[2] / "docs" / "mqtt.md").read_text(encoding="utf-8")
COMMANDS = [text for text in re.findall(r"^\| `(\{.*?\})` \|", PAGE, re.MULTILINE) if text.startswith('{"command"')]
BLOCKS = [json.loads(text) for text in re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)]
KEYS = dict(re.findall(r'^\| `([a-z]+)` \| `("[^`]+)` \|', PAGE, re.MULTILINE))
MOMENT = Moment(now=500.0, wall=1_772_366_400.0, good_for=1.0, max_age=2.0)


def read(levels: str, payload: str) -> commands.Read | None:
    """Read a message for the documented drive."""
    return commands.read(Message("", payload.encode()), ["pump-1", *levels.split("/")], MOMENT, nc3())


@pytest.mark.parametrize("text", COMMANDS)
def test_every_documented_command_is_one(text: str) -> None:
    """With all the keys that it shows."""
    found = read("command", text)
    assert isinstance(found, Command), found
    assert found.verb == json.loads(text)["command"]


def test_every_command_is_documented_with_every_key() -> None:
    """None is left out; those that all have are in a table of their own."""
    shown: dict[Verb, set[str]] = {}
    for text in COMMANDS:
        table = json.loads(text)
        shown.setdefault(Verb(table["command"]), set()).update(table)
    assert set(shown) == set(Verb)
    assert set(KEYS) == set(commands.COMMON) - {"command"}
    for verb, keys in shown.items():
        known = set(commands.KEYS[verb]) - set(commands.COMMON) - {"value", "reverse"}
        assert known <= keys, verb


@pytest.mark.parametrize("key", sorted(KEYS))
def test_the_keys_that_all_commands_have_are_taken(key: str) -> None:
    """As the table shows them."""
    assert isinstance(read("command", f'{{"command": "run", {KEYS[key]}}}'), Command)
    assert isinstance(read("set/frequency", f'{{"value": 30.0, {KEYS[key]}}}'), Command)


def test_the_documented_values_can_be_set() -> None:
    """Short names, registers, numbers, bits by name."""
    names = set(re.findall(r"`set/([A-Za-z0-9_]+)`", PAGE))
    assert set(commands.SHORT_NAMES) < names
    for name in names:
        payload = "run+command_priority" if name == "command" else "1"
        assert isinstance(read(f"set/{name}", payload), Command), name


@pytest.mark.parametrize("text", re.findall(r"What is in no way a number \((.*?)\)", PAGE)[0].split(", `")[0:])
def test_what_is_documented_as_no_number_is_none(text: str) -> None:
    """Neither in JSON nor plain."""
    value = text.strip("` ")
    found = read("command", f'{{"command": "frequency", "value": {value}}}')
    assert isinstance(found, Result)
    assert found.reason == "malformed"


def test_results_events_and_control_have_the_documented_keys() -> None:
    """In their order."""
    clock = StandingClock()
    door = KeptDoor.small(clock)
    command = Command(LEASED, Verb.RUN, Source(Channel.MQTT, "hmi"), 0.0, 1.0, "42")
    made = [
        json.loads(outcome.result(Result(command, Status.DONE), clock.wall())),
        json.loads(outcome.event("disarmed", "", clock.wall())),
        json.loads(outcome.standing(door.controls[LEASED])),
    ]
    trip = json.loads(outcome.event("trip", "", clock.wall(), {"code": 1}))
    assert [list(trip)] == [list(block) for block in BLOCKS if "code" in block]
    shown = [block for block in BLOCKS if not {"output_frequency", "form", "code"} & block.keys()]
    assert [list(block) for block in shown] == [list(each) for each in made]
    assert list(json.loads(outcome.standing(door.controls.get(READ_ONLY)))) == list(made[2])
    assert all(f"`{standing.value}`" in PAGE for standing in Standing)


def test_every_event_is_documented_and_no_other() -> None:
    """By name, in the table."""
    table = PAGE[PAGE.index("| event | |") :].split("\n\n", 1)[0]
    named = re.findall(r"`([a-z_]+)`", "".join(row.split("|")[1] for row in table.splitlines()))
    assert sorted(named) == sorted(events.KINDS)


def test_the_documented_description_is_one() -> None:
    """With the keys that it has, and no other."""
    shown = next(block for block in BLOCKS if "form" in block)
    drive = {"control": "leased", "sources": ["mqtt"], "communication_timeout": "1.5s", "timeout_action": "stop"}
    section = MqttSection.model_validate({"url": "mqtt://localhost"})
    made = json.loads(Description(image(drive).drives[0], section, "hall-3").write())
    assert list(shown) == list(made)
    assert shown["control"].keys() == made["control"].keys()
    assert shown["values"]["output_frequency"].keys() == made["values"]["output_frequency"].keys()
    assert set(shown["control"]["commands"]) <= set(made["control"]["commands"])


def test_the_documented_numbers_are_those_of_the_code() -> None:
    """How many wait, how many are told of."""
    assert f"more than {inbox.MOST} that wait" in PAGE
    assert f"of the refusals {intake.REFUSALS:.0f} a second" in PAGE
    assert f"at most {commands.MOST_WORDS}:" in PAGE
