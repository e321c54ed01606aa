"""What a message asks for, and what is no command."""

from __future__ import annotations

import json
from dataclasses import replace
from decimal import Decimal
from typing import Any

import pytest

from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.mqtt import commands
from gateway.mqtt.message import Beat, LineStop, Message, Moment
from tests.mqtt.doors import nc3

NOON = 1_772_366_400.0  # 2026-03-01T12:00:00Z
MOMENT = Moment(now=500.0, wall=NOON, good_for=1.0, max_age=2.0)
STOPS = (Verb.STOP, Verb.COAST, Verb.EMERGENCY_STOP)


def read(topic: str, payload: object, **more: Any) -> commands.Read | None:
    """Read a message below the gateway's root; what is no text or bytes goes as JSON."""
    if isinstance(payload, str):
        payload = payload.encode()
    elif not isinstance(payload, bytes):
        payload = json.dumps(payload).encode()
    return commands.read(Message(topic, payload, **more), topic.split("/"), MOMENT, nc3())


def command(topic: str, payload: object, **more: Any) -> Command:
    """Read a message that must be a command."""
    found = read(topic, payload, **more)
    assert isinstance(found, Command), found
    return found


def refusal(topic: str, payload: object, **more: Any) -> Result:
    """Read a message that must be refused."""
    found = read(topic, payload, **more)
    assert isinstance(found, Result), found
    assert found.status is Status.REFUSED
    assert found.text
    return found


@pytest.mark.parametrize(
    ("payload", "wanted"),
    [
        ("stop", {"verb": Verb.STOP}),
        ("STOP\n", {"verb": Verb.STOP}),
        ('"stop"', {"verb": Verb.STOP}),
        ("Emergency-Stop", {"verb": Verb.EMERGENCY_STOP}),
        ("take", {"verb": Verb.TAKE}),
        ("run", {"verb": Verb.RUN}),
        ({"command": "run", "frequency": 30.0}, {"verb": Verb.RUN, "value": Decimal("30.0")}),
        ({"command": "run", "frequency": "30"}, {"verb": Verb.RUN, "value": Decimal("30")}),
        ({"command": "run", "direction": "reverse"}, {"verb": Verb.RUN, "is_reverse": True}),
        ({"command": "run", "direction": "Reverse"}, {"verb": Verb.RUN, "is_reverse": True}),
        ({"command": "run", "direction": " FORWARD "}, {"verb": Verb.RUN}),
        ({"command": "run", "reverse": True}, {"verb": Verb.RUN, "is_reverse": True}),
        ({"command": "run", "reverse": False, "direction": "forward"}, {"verb": Verb.RUN}),
        ({"command": "jog", "direction": "reverse"}, {"verb": Verb.JOG, "is_reverse": True}),
        ({"command": "frequency", "value": 12.34}, {"verb": Verb.FREQUENCY, "value": Decimal("12.34")}),
        ({"command": "speed", "speed": 1450}, {"verb": Verb.SPEED, "value": Decimal(1450)}),
        ({"command": "preset", "number": 3}, {"verb": Verb.PRESET, "value": Decimal(3)}),
        ({"command": "acceleration", "number": 2}, {"verb": Verb.ACCELERATION, "value": Decimal(2)}),
        ({"command": "terminals", "value": "none"}, {"verb": Verb.TERMINALS, "text": "none"}),
        ({"command": "analog", "value": 100}, {"verb": Verb.ANALOG, "value": Decimal(100)}),
        ({"command": "release_priority"}, {"verb": Verb.RELEASE_PRIORITY}),
        (
            {"command": "set", "name": "FA01", "value": 30},
            {"verb": Verb.SET, "name": "frequency_command", "value": Decimal(30)},
        ),
        (
            {"command": "words", "address": "FA00", "words": ["C400H", 3000]},
            {"verb": Verb.WORDS, "address": 0xFA00, "words": (0xC400, 3000)},
        ),
    ],
)
def test_every_command_has_its_payload(payload: object, wanted: dict[str, Any]) -> None:
    """Plain where a word says all, JSON for the rest; nothing but what was asked."""
    blank = Command("pump-1", Verb.STOP, Source(Channel.MQTT), 500.0, 501.0)
    assert command("pump-1/command", payload) == replace(blank, **wanted)


@pytest.mark.parametrize(
    ("topic", "payload", "wanted"),
    [
        ("set/frequency", "30.0", {"verb": Verb.FREQUENCY, "name": "frequency", "value": Decimal("30.0")}),
        ("set/speed", "-1450", {"verb": Verb.SPEED, "name": "speed", "value": Decimal(-1450)}),
        ("set/preset", {"value": "3"}, {"verb": Verb.PRESET, "name": "preset", "value": Decimal(3)}),
        ("set/frequency_command", {"value": 5}, {"verb": Verb.SET, "name": "frequency_command", "value": Decimal(5)}),
        ("set/frequency", {"frequency": 30}, {"verb": Verb.FREQUENCY, "name": "frequency", "value": Decimal(30)}),
        ("set/preset", {"preset": 3}, {"verb": Verb.PRESET, "name": "preset", "value": Decimal(3)}),
        ("set/preset", {"number": 3}, {"verb": Verb.PRESET, "name": "preset", "value": Decimal(3)}),
        ("set/FA01", {"FA01": 5}, {"verb": Verb.SET, "name": "frequency_command", "value": Decimal(5)}),
        ("set/FA01", {"frequency_command": 5}, {"verb": Verb.SET, "name": "frequency_command", "value": Decimal(5)}),
        ("set/FA01", "5", {"verb": Verb.SET, "name": "frequency_command", "value": Decimal(5)}),
        ("set/0xFA01", "5", {"verb": Verb.SET, "name": "frequency_command", "value": Decimal(5)}),
        ("set/FA01H", "5", {"verb": Verb.SET, "name": "frequency_command", "value": Decimal(5)}),
        ("set/F803", "1.5", {"verb": Verb.SET, "name": "communication_timeout", "value": Decimal("1.5")}),
        ("set/command", "run+reverse", {"verb": Verb.SET, "name": "command", "text": "run+reverse"}),
        ("set/FA00", "0xC400", {"verb": Verb.SET, "name": "command", "text": "0xC400"}),
    ],
)
def test_a_value_is_set_by_a_short_name_a_register_or_a_number(
    topic: str, payload: object, wanted: dict[str, Any]
) -> None:
    """In the unit of the register; codes and bits by name."""
    blank = Command("pump-1", Verb.STOP, Source(Channel.MQTT), 500.0, 501.0)
    assert command(f"pump-1/{topic}", payload) == replace(blank, **wanted)


@pytest.mark.hazard("H37")
def test_the_source_names_itself() -> None:
    """So that leases and rights can be given to one of several controllers."""
    assert command("pump-1/command", {"command": "take", "source": "dashboard"}).source == Source(
        Channel.MQTT, "dashboard"
    )
    assert command("pump-1/set/frequency", {"value": 3, "source": "plc"}).source == Source(Channel.MQTT, "plc")
    assert command("pump-1/command", "take").source == Source(Channel.MQTT, "")
    assert refusal("pump-1/command", {"command": "take", "source": "a\nb"}).reason is Reason.MALFORMED


@pytest.mark.hazard("H03")
def test_the_id_is_passed_on() -> None:
    """Text, or a whole number; also with what is refused, so that the asker knows."""
    assert command("pump-1/command", {"command": "run", "id": "42"}).id == "42"
    assert command("pump-1/set/frequency", {"value": 3, "id": 42}).id == "42"
    assert refusal("pump-1/command", {"command": "rum", "id": "42"}).command.id == "42"
    assert refusal("pump-1/command", {"command": "run", "id": "42"}, is_retained=True).command.id == "42"
    assert command("pump-1/command", {"command": "run", "id": 4.2}).id == "4.2"
    assert command("pump-1/command", {"command": "run", "id": None}).id == ""
    assert command("pump-1/command", {"command": "stop", "id": 4.2}).id == "4.2"
    assert refusal("pump-1/command", {"command": "run", "id": True}).reason is Reason.MALFORMED


@pytest.mark.hazard("H03")
def test_a_repeated_delivery_counts_only_where_an_id_tells_it_apart() -> None:
    """QoS 1: whether the first delivery was carried out, nobody knows."""
    assert refusal("pump-1/command", "run", is_repeated=True).reason is Reason.EXPIRED
    assert command("pump-1/command", {"command": "run", "id": "1"}, is_repeated=True).id == "1"
    assert command("pump-1/command", "stop", is_repeated=True).verb is Verb.STOP


@pytest.mark.hazard("H02")
def test_what_comes_before_the_subscription_is_of_an_earlier_session() -> None:
    """A broker that hoards does not get an old command carried out; a stop may come at any time."""
    for topic, payload in (("command", {"command": "run", "id": "1"}), ("set/frequency", "30")):
        assert refusal(f"pump-1/{topic}", payload, is_early=True).reason is Reason.EXPIRED
    assert command("pump-1/command", "stop", is_early=True).verb is Verb.STOP
    assert read("pump-1/heartbeat", "1", is_early=True) is None


@pytest.mark.hazard("H01")
@pytest.mark.parametrize("payload", ["run", "stop", {"command": "run", "id": "7"}, b"\xff", ""])
@pytest.mark.parametrize("topic", ["pump-1/command", "pump-1/set/frequency", "line/a/command"])
def test_nothing_that_was_retained_is_carried_out(topic: str, payload: object) -> None:
    """Not even a stop: it is as old as the broker's memory."""
    assert refusal(topic, payload, is_retained=True).reason is Reason.RETAINED


@pytest.mark.hazard("H02")
@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"issued": "2026-03-01T11:59:57.9Z"}, "issued 2.1 s ago; at most 2 s"),
        ({"issued": NOON - 3600}, "issued 3600.0 s ago"),
        ({"issued": (NOON + 3) * 1000}, "issued 3.0 s in the future: set the clock"),
        ({"expires": "2026-03-01T12:00:00Z"}, "it expired 0.0 s before it came"),
        ({"expires": NOON - 5}, "it expired 5.0 s before it came"),
    ],
)
@pytest.mark.parametrize("topic", ["pump-1/command", "pump-1/set/frequency"])
def test_what_is_late_is_refused(topic: str, more: dict[str, Any], words: str) -> None:
    """By its own word; a clock that is wrong is told."""
    asked = {"command": "run"} if topic.endswith("command") else {"value": 30}
    found = refusal(topic, {**asked, **more, "id": "9"})
    assert found.reason is Reason.EXPIRED
    assert words in found.text
    assert found.command.id == "9"


@pytest.mark.hazard("H02")
@pytest.mark.hazard("H11")
def test_a_command_is_good_until_the_first_of_its_ends() -> None:
    """The drive's command time-out, what it says itself, what the broker says."""
    assert command("pump-1/command", {"command": "run"}).deadline == 501.0
    assert command("pump-1/command", {"command": "run", "expires": NOON + 0.5}).deadline == 500.5
    assert command("pump-1/command", {"command": "run", "expires": NOON + 3600}).deadline == 501.0
    assert command("pump-1/command", {"command": "run", "issued": NOON - 1.5}).deadline == 501.0
    assert command("pump-1/command", "run", expiry=1).deadline == 501.0
    assert command("pump-1/command", {"command": "run", "expires": NOON + 0.25}, expiry=60).deadline == 500.25
    assert refusal("pump-1/command", "run", expiry=0).reason is Reason.EXPIRED


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("verb", STOPS)
def test_a_stop_is_taken_whatever_else_is_said(verb: Verb) -> None:
    """No clock and no spelling comes between an operator and a stop; a late one does no harm."""
    odd = {"command": verb.value, "issued": 0, "expires": "yesterday", "colour": "red", "id": True, "source": 7}
    found = command("pump-1/command", odd, expiry=0)
    assert (found.verb, found.id, found.source.name) == (verb, "", "7")
    assert found.deadline == 501.0
    assert command("pump-1/command", {"command": verb.value, "id": "5", "source": "hmi"}).id == "5"
    assert refusal("pump-1/command", f'{{"command": "{verb}", "command": "run"}}').reason is Reason.MALFORMED


@pytest.mark.hazard("H24")
@pytest.mark.parametrize(
    "payload",
    [
        b"\xef\xbb\xbfstop",
        b"stop\0",
        b"stop\r\n\0",
        b"\0\0stop!",
        b'["stop"]',
        b"'Stop'",
        b'{"command": ["stop"]}',
        b'[{"command": "stop"}]',
        b'{"Command": "STOP"}',
        b'{"command": "stop", "command": "stop", "id": 1, "id": 1}',
        b'{"command": "stop", "id": 1, "id": 2}',
        b'\xef\xbb\xbf{"command": "stop"}\0\n',
        b'{"command": "stop\\u0000"}',
        b'{"command": "stop", "n": NaN}',
        b'{"command": "stop", "n": 1e999999999999999999999}',
        b'{"command": "stop"',
        b"{command: 'stop'}",
        b'{"command": "stop", "text": "\xff"}',
        b'{"command": "stop", "text": "' + b"x" * 5000 + b'"}',
        b'{"command": "stop", "x": ' + b"[" * 2000,
        "stop".encode("utf-16"),
        '{"command": "stop"}'.encode("utf-16-le"),
    ],
)
def test_nothing_odd_about_a_payload_hides_a_stop(payload: bytes) -> None:
    """For a drive and for a line; only a retained one is refused."""
    assert command("pump-1/command", payload).verb is Verb.STOP
    found = read("line/a/command", payload)
    assert isinstance(found, LineStop)
    assert found.command.verb is Verb.STOP
    assert refusal("pump-1/command", payload, is_retained=True).reason is Reason.RETAINED


@pytest.mark.parametrize(
    "payload",
    [
        b"\xef\xbb\xbfrun",
        b'["run"]',
        b'["stop", "run"]',
        b"nonstop",
        b"stop run",
        b"st\xffop",
        b'{"command": "run", "command": "stop"}',
        b'{"command": "run", "command": "stop"',
        b'{"command": "run", "note": {"command": "stop"}}',
        b'{"command": "run", "note": "command: stop"}',
        b'{"note": {"command": "stop"}}',
        b'{"stop": true}',
        b'{"command": [["stop"]]}',
        b"[]",
        b"null",
        b"7",
    ],
)
def test_no_stop_is_made_of_what_is_none(payload: bytes) -> None:
    """Nor anything else of what is not exact."""
    assert refusal("pump-1/command", payload).reason is Reason.MALFORMED
    assert refusal("pump-1/set/frequency", b"\xef\xbb\xbfstop").reason is Reason.MALFORMED


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        ("", 'command "" is not known; known: run, stop'),
        ("go", 'command "go" is not known'),
        ({}, "command null is not known"),
        ({"command": 5}, "command 5 is not known"),
        ({"command": ["run"]}, "command a list is not known"),
        ({"command": "run", "frequncy": 30}, 'unknown key "frequncy"; known: command, id, source, issued, expires'),
        ({"command": "arm", "frequency": 30}, 'unknown key "frequency"'),
        ({"command": "run", "frequency": 30, "value": 30}, "only one of frequency, value"),
        ({"command": "run", "frequency": True}, "true is no number"),
        ({"command": "run", "frequency": None}, "null is no number"),
        ({"command": "run", "frequency": "30 Hz"}, '"30 Hz" is no number'),
        ({"command": "run", "direction": "back"}, 'direction "back": forward or reverse'),
        ({"command": "run", "direction": True}, "direction true: forward or reverse"),
        ({"command": "run", "reverse": "yes"}, 'reverse "yes": true or false'),
        ({"command": "run", "reverse": True, "direction": "forward"}, "contradict each other"),
        ({"command": "frequency"}, "frequency needs frequency or value"),
        ("frequency", "frequency needs frequency or value"),
        ({"command": "set", "name": "frequency_command"}, "set needs value"),
        ({"command": "set", "name": True, "value": 1}, "name true"),
        ({"command": "words", "address": "FA00"}, "words is a list of 1 to 16 words"),
        ({"command": "words", "address": "FA00", "words": [1] * 17}, "words is a list of 1 to 16 words"),
        ({"command": "run", "issued": "soon"}, 'issued "soon" is no time'),
        (b'{"command": "run", "frequency": NaN}', "NaN is no number"),
        (b"\x80run", "not UTF-8"),
    ],
)
def test_what_is_not_understood_is_refused_in_words(payload: object, words: str) -> None:
    """What is wrong, and what would be right."""
    found = refusal("pump-1/command", payload)
    assert found.reason is Reason.MALFORMED
    assert words in found.text


@pytest.mark.parametrize(
    "payload",
    ["", "fast", True, "nan", {"values": 3}, {"speed": 3}, {"frequency": 3, "value": 3}, {"value": 3, "unit": "Hz"},
     "1_000", {}],
)  # fmt: skip
def test_a_setpoint_is_a_number(payload: object) -> None:
    """Nothing else."""
    assert refusal("pump-1/set/frequency", payload).reason is Reason.MALFORMED


@pytest.mark.parametrize("name", ["nonsense", "FFFF", "", "x" * 100])
def test_a_register_that_the_model_has_not_got_is_refused(name: str) -> None:
    """By any of the ways to name one."""
    assert refusal(f"pump-1/set/{name}", "1").reason is Reason.NOT_IN_MODEL
    asked = {"command": "words", "address": name, "words": [1]}
    assert refusal("pump-1/command", asked).reason is Reason.NOT_IN_MODEL


def test_no_register_is_called_like_a_short_name() -> None:
    """`set/frequency` means one thing."""
    assert not set(commands.SHORT_NAMES) & set(nc3().registers)


def test_a_drive_without_a_model_is_left_to_the_door() -> None:
    """Which says that there is none, or that nobody may command it."""
    message = Message("x", b'{"command": "words", "address": "FA00", "words": [1]}')
    found = commands.read(message, ["nobody", "command"], MOMENT, None)
    assert isinstance(found, Command)
    found = commands.read(Message("x", b"1"), ["nobody", "set", "nonsense"], MOMENT, None)
    assert isinstance(found, Command)


@pytest.mark.hazard("H05")
def test_any_payload_is_a_sign_of_life() -> None:
    """A counter, a time, JSON with the owner's name."""
    assert read("pump-1/heartbeat", "17") == Beat("pump-1", Source(Channel.MQTT), b"17")
    found = read("pump-1/heartbeat", {"source": "dashboard", "n": 17})
    assert isinstance(found, Beat)
    assert found.source == Source(Channel.MQTT, "dashboard")
    assert read("pump-1/heartbeat", b"\x00\xff") == Beat("pump-1", Source(Channel.MQTT), b"\x00\xff")


@pytest.mark.hazard("H01")
@pytest.mark.hazard("H05")
@pytest.mark.parametrize(
    ("payload", "more"),
    [
        ("17", {"is_retained": True}),
        ({"source": "dashboard", "issued": NOON - 3}, {}),
        ({"source": "a\nb"}, {}),
        (b'{"source": "dashboard", "source": "other"}', {}),
        (b'{"source": ', {}),
        (b"x" * 4097, {}),
    ],
)
def test_what_is_old_or_odd_is_no_sign_of_life(payload: object, more: dict[str, Any]) -> None:
    """A lease is not kept by it."""
    assert read("pump-1/heartbeat", payload, **more) is None


@pytest.mark.parametrize("verb", STOPS)
def test_a_whole_line_is_stopped_by_one_message(verb: Verb) -> None:
    """And by nothing else is it told anything."""
    found = read("line/a/command", {"command": verb.value, "source": "hmi", "id": "3"})
    assert isinstance(found, LineStop)
    assert (found.line, found.command.verb, found.command.id) == ("a", verb, "3")
    assert found.command.source == Source(Channel.MQTT, "hmi")
    for payload in ("run", "reset", "", {"command": "frequency", "value": 3}):
        refused = refusal("line/a/command", payload)
        assert "a line takes only stop, coast, emergency_stop" in refused.text
        assert refused.command.drive == "line/a"


@pytest.mark.parametrize(
    "topic", ["pump-1", "pump-1/set", "pump-1/set/a/b", "pump-1/result", "line/a/set", "a/b/command", "", "status"]
)
def test_other_topics_are_none_of_ours(topic: str) -> None:
    """Whatever is subscribed."""
    assert read(topic, "stop") is None
