"""Whatever is sent, it is read exactly or refused; nothing else can happen."""

from __future__ import annotations

import json
import random
import re
from decimal import Decimal
from typing import Any

import pytest

from gateway.control.command import Command, Result, Status
from gateway.control.door import Door
from gateway.metrics import MqttStats
from gateway.mqtt import commands, exact, outcome
from gateway.mqtt.listener import Listener
from gateway.mqtt.message import Beat, LineStop, Message, Moment
from tests import soak
from tests.mqtt.doors import LEASED, StandingClock, nc3, small_site
from tests.mqtt.rig import section

INPUTS = 100_000 * soak.FACTOR
THROUGH_THE_DOOR = 5_000 * soak.FACTOR
NOON = 1_772_366_400.0
MOMENT = Moment(now=500.0, wall=NOON, good_for=1.0, max_age=2.0)
TOPICS = ("command", "set/frequency", "set/FA00", "set/terminal_output", "heartbeat", "command")
SEEDS = [
    b"stop",
    b"run",
    b"30.0",
    b"-12.5e1",
    b"run+command_priority",
    b"0xC400",
    b'"emergency_stop"',
    b'{"command": "run", "direction": "reverse", "frequency": 30.0, "id": "42"}',
    b'{"command": "run", "reverse": true, "frequency": "30", "source": "hmi"}',
    b'{"command": "stop", "id": 17}',
    b'{"command": "preset", "number": 3, "issued": 1772366400}',
    b'{"command": "words", "address": "FA00", "words": [50176, "C400H"]}',
    b'{"command": "set", "name": "FA01", "value": 12.34, "expires": "2026-03-01T12:00:01Z"}',
    b'{"command": "set", "name": "command", "value": "run+command_priority"}',
    b'{"value": 30.0, "id": "a", "source": "\xc3\xa4"}',
    b'{"source": "dashboard", "n": 1}',
]
TOKENS = [
    b"NaN", b"Infinity", b"-", b"1e999999999", b"9" * 60, b"1_0", b"\xff", b"\xed\xa0\x80", b"\\ud800", b"\x00",
    b'"', b"{", b"}", b"[", b"]", b",", b":", b"[" * 900, b'{"a":' * 300, b'"command": "stop"', b'"id": ', b"true",
    b"null", b'"value": 1', b"\xef\xbb\xbf", "\uff13".encode(), b"\n", b"0x", b"H", b"+", b"e", b".", b" ", b"_",
    b"x" * 5000, b"run", b"Stop", b'"reverse": 1', b'"words": [1]', b'"frequency": 1e5',
]  # fmt: skip
NUMBER = re.compile(r"[+-]?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?", re.ASCII)


def mutated(chance: random.Random) -> bytes:
    """Return a payload with some bytes changed, cut out, doubled, or put in."""
    payload = chance.choice(SEEDS)
    for _ in range(chance.randrange(4)):
        at = chance.randrange(len(payload) + 1)
        match chance.randrange(5):
            case 0:
                payload = payload[:at] + bytes([chance.randrange(256)]) + payload[at + 1 :]
            case 1:
                payload = payload[:at] + payload[at + chance.randrange(1, 9) :]
            case 2:
                payload = payload[:at] + chance.choice(TOKENS) + payload[at:]
            case 3:
                payload = payload[:at] + payload[max(0, at - chance.randrange(1, 30)) :]
            case 4:
                payload = payload[:at] + chance.choice(SEEDS)[chance.randrange(5) :]
    return payload


def strict(payload: bytes) -> dict[str, Any] | str:
    """Read a payload another way: text, or an object whose keys stand there once; it fails where it is neither."""
    assert len(payload) <= exact.LARGEST
    text = payload.decode("utf-8", "strict").strip()
    if not text.startswith(("{", '"')):
        return text

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        assert len({key for key, _ in pairs}) == len(pairs)
        return dict(pairs)

    def never(word: str) -> None:
        raise AssertionError(word)

    found: dict[str, Any] | str = json.loads(text, object_pairs_hook=once, parse_constant=never)
    return found


def names_a_stop(payload: bytes) -> bool:
    """Say whether a stop stands in a payload, whatever else does; NUL is nothing."""
    return any(word in payload.replace(b"\0", b"").lower() for word in (b"stop", b"coast"))


def look_at(command: Command, payload: bytes, topic: str) -> None:
    """Check that a command says what its payload says, and no more."""
    assert 500.0 < command.deadline <= 501.0
    assert (command.id + command.source.name).isprintable()
    assert max(len(command.id), len(command.source.name), len(command.text)) <= exact.LONGEST_NAME
    assert all(type(word) is int and 0 <= word <= 0xFFFF for word in command.words)
    if command.verb.is_stopping:
        assert topic == "command"
        assert names_a_stop(payload)
        return
    document = strict(payload)
    if command.value is not None:
        assert command.value.is_finite()
        assert any(Decimal(token) == command.value for token in NUMBER.findall(payload.decode()))
    if isinstance(document, dict):
        own = (topic.removeprefix("set/"), command.name)
        known = (*commands.SET_KEYS, *own) if topic.startswith("set/") else commands.KEYS[command.verb]
        assert set(document) <= set(known)
    elif isinstance(document, str) and topic == "command":
        assert document.strip().lower().replace("-", "_").replace(" ", "_") == command.verb


@pytest.mark.unmeasured
@pytest.mark.hazard("H17")
def test_a_hundred_thousand_mutated_payloads_are_read_exactly_or_refused() -> None:
    """Whatever is taken is what another reader reads; whatever is refused says why."""
    chance, model = random.Random("commands"), nc3()
    taken = refused = beats = 0
    for _ in range(INPUTS):
        payload, topic = mutated(chance), chance.choice(TOPICS)
        found = commands.read(Message(topic, payload), ["pump-1", *topic.split("/")], MOMENT, model)
        match found:
            case Command():
                taken += 1
                look_at(found, payload, topic)
            case Result():
                refused += 1
                assert found.status is Status.REFUSED
                assert found.reason
                assert 0 < len(found.text) < 400
                assert found.text.isascii()
            case Beat():
                beats += 1
                assert found.beat == payload
                assert found.source.name.isprintable()
            case _:
                assert topic == "heartbeat"
    assert taken > INPUTS / 20
    assert refused > INPUTS / 4
    assert beats > INPUTS / 20


@pytest.mark.hazard("H17")
def test_a_line_takes_only_stops_of_mutated_payloads() -> None:
    """And each of them names a stop."""
    chance = random.Random("line")
    taken = 0
    for _ in range(INPUTS // 20):
        payload = mutated(chance)
        found = commands.read(Message("", payload), ["line", "a", "command"], MOMENT)
        if isinstance(found, LineStop):
            taken += 1
            assert found.command.verb.is_stopping
            assert names_a_stop(payload)
    assert taken


@pytest.mark.hazard("H22")
@pytest.mark.hazard("H24")
def test_mutated_payloads_get_through_the_door_or_are_refused_each_with_one_result() -> None:
    """With the rules behind it: nothing fails in an unexpected way, and all that is told can be told."""
    clock = StandingClock()
    door = Door.of(small_site(), clock)
    listener = Listener(section(), "hall-3", door, MqttStats(), clock)
    results: list[Result] = []
    door.on_result(results.append)
    chance = random.Random("door")
    for _ in range(THROUGH_THE_DOOR):
        clock.seconds += 0.05
        topic = f"tosvert/hall-3/{LEASED}/{chance.choice(TOPICS)}"
        before = len(results)
        listener.hear(Message(topic, mutated(chance)))
        listener.hand_over(1)
        assert len(results) - before == (0 if topic.endswith("heartbeat") else 1)
        for result in results[before:]:
            json.loads(outcome.result(result, clock.wall()).encode())
            assert result.status is not Status.DONE or result.command.verb in ("take", "release")
