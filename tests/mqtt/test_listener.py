"""What controllers send comes to the door, and what becomes of it back to them."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import pytest

from gateway.control.command import Channel, Reason, Source, Status, Verb
from gateway.control.door import Door
from gateway.metrics import MqttStats
from gateway.mqtt.inbox import MOST
from gateway.mqtt.intake import REFUSALS, REFUSALS_AT_ONCE
from gateway.mqtt.listener import Listener
from gateway.mqtt.message import Message
from tests.mqtt.doors import DIRECT, LEASED, READ_ONLY, KeptDoor, StandingClock, small_site
from tests.mqtt.rig import section

ROOT = "tosvert/hall-3"
RESULT = f"{ROOT}/{LEASED}/result"


@dataclass
class Back:
    """A way back to the broker that keeps what goes along it, as long as there is room."""

    room: int = 1_000_000
    said: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    replies: list[tuple[str, dict[str, Any], bytes]] = field(default_factory=list)

    def say(self, topic: str, text: str, *, expiry: int, is_event: bool = False) -> bool:
        """Keep what happened."""
        assert expiry > 0
        self.room -= 1
        if self.room < 0:
            return False
        self.said.append((topic, json.loads(text)))
        return True

    def reply(self, topic: str, text: str, correlation: bytes) -> bool:
        """Keep an answer."""
        self.replies.append((topic, json.loads(text), correlation))
        return True

    def on(self, topic: str) -> list[dict[str, Any]]:
        """Return what was said on a topic."""
        return [said for where, said in self.said if where == topic]


class Gate:
    """A listener between a broker that is played and a door that keeps what comes to it."""

    def __init__(self, **settings: object) -> None:
        self.clock = StandingClock()
        self.door = KeptDoor.small(self.clock)
        self.stats = MqttStats()
        self.listener = Listener(section(**settings), "hall-3", self.door, self.stats, self.clock)
        self.back = Back()
        self.listener.begin(self.back)

    def send(self, topic: str, payload: object, **more: Any) -> None:
        """Let a message come."""
        raw = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        self.listener.hear(Message(f"{ROOT}/{topic}", raw, **more))

    def hand_over(self) -> None:
        """Hand on everything that waits."""
        while self.listener.hand_over(1):
            pass

    @property
    def verbs(self) -> list[Verb]:
        """Return what came to the door, in order."""
        return [command.verb for command in self.door.submitted]


def test_it_listens_to_commands_values_heartbeats_and_lines() -> None:
    """Of every drive of this gateway, and nothing else."""
    levels = ("+/command", "+/set/+", "+/heartbeat", "line/+/command")
    assert Gate().listener.filters == [f"{ROOT}/{each}" for each in levels]


def test_a_command_comes_to_the_door_and_its_result_to_the_drives_topic() -> None:
    """With its id, and the time."""
    gate = Gate()
    gate.send(f"{LEASED}/command", {"command": "run", "frequency": 30.0, "id": "42", "source": "hmi"})
    gate.hand_over()
    (command,) = gate.door.submitted
    assert (command.drive, command.verb, command.value, command.id) == (LEASED, Verb.RUN, Decimal("30.0"), "42")
    assert command.source == Source(Channel.MQTT, "hmi")
    assert not gate.back.said
    gate.door.finish(Status.FAILED, Reason.NO_ANSWER)
    ((topic, said),) = gate.back.said
    assert topic == RESULT
    assert said == {
        "id": "42",
        "drive": LEASED,
        "command": "run",
        "source": "mqtt hmi",
        "status": "failed",
        "reason": "no_answer",
        "text": "",
        "raw": {},
        "read_back": {},
        "time": "2026-03-01T12:16:40.000Z",
    }
    assert not gate.back.replies


def test_an_answer_goes_to_the_topic_that_the_asker_named() -> None:
    """MQTT 5, with the correlation data; and to the drive's topic as ever."""
    gate = Gate()
    gate.send(f"{LEASED}/command", "take", response_topic="me/answers", correlation=b"\x01\x02")
    gate.hand_over()
    gate.door.finish()
    ((topic, reply, correlation),) = gate.back.replies
    assert (topic, correlation, reply["status"]) == ("me/answers", b"\x01\x02", "done")
    assert gate.back.on(RESULT) == [reply]


@pytest.mark.hazard("H37")
@pytest.mark.parametrize(
    "topic",
    ["tosvert/hall-4/p/command", "x/set/frequency", "a/heartbeat", "command", "a/+/b", "#", "$SYS/x", "x" * 65536],
)
def test_no_answer_goes_where_a_gateway_takes_commands(topic: str) -> None:
    """Nobody gets this gateway to write where he may not; the drive's topic tells what came of it."""
    gate = Gate()
    gate.send(f"{LEASED}/command", "stop", response_topic=topic)
    gate.door.finish()
    assert not gate.back.replies
    assert gate.stats.untold == 1
    assert len(gate.back.on(RESULT)) == 1


@pytest.mark.hazard("H29")
@pytest.mark.parametrize("verb", ["stop", "coast", "emergency_stop"])
def test_a_stop_is_at_the_door_before_anybody_asks_for_it(verb: str) -> None:
    """Nothing waits ahead of it."""
    gate = Gate()
    gate.send(f"{DIRECT}/command", "run")
    gate.send(f"{LEASED}/command", verb)
    assert gate.verbs == [Verb(verb)]


@pytest.mark.hazard("H29")
@pytest.mark.hazard("H24")
@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        ("set/FA00", "0x8000"),
        ("set/FA00", 0),
        ("set/command", "coast+run+command_priority"),
        ("command", {"command": "set", "name": "FA00", "value": 32768}),
        ("command", {"command": "words", "address": "FA00", "words": ["8000H", 3000]}),
        ("command", b"\xef\xbb\xbf[\"stop\"]\0"),
    ],
)
def test_a_stop_in_other_words_is_at_the_door_before_anybody_asks_for_it(topic: str, payload: object) -> None:
    """Raw, or odd: not behind sixteen commands, and a newer word of the same register does not take its place."""
    gate = Gate()
    for _ in range(2 * MOST):
        gate.send(f"{LEASED}/command", "run")
    gate.send(f"{LEASED}/{topic}", payload.encode() if isinstance(payload, str) else payload)
    assert len(gate.verbs) == MOST + 1
    assert gate.verbs[-1] in (Verb.SET, Verb.WORDS, Verb.STOP)
    gate.send(f"{LEASED}/set/FA00", b"0xC400")
    assert len(gate.verbs) == MOST + 1
    gate.hand_over()
    assert len(gate.verbs) == MOST + 2
    assert gate.stats.refused == {"busy": MOST}


@pytest.mark.hazard("H10")
def test_a_stop_takes_what_came_before_it_to_the_door() -> None:
    """So that the door can end it: nothing older is done after the stop."""
    gate = Gate()
    for payload in ("arm", "run"):
        gate.send(f"{LEASED}/command", payload)
    gate.send(f"{DIRECT}/command", "run")
    gate.send(f"{LEASED}/command", "stop")
    assert gate.verbs == [Verb.ARM, Verb.RUN, Verb.STOP]
    gate.hand_over()
    assert [command.drive for command in gate.door.submitted][3:] == [DIRECT]


@pytest.mark.hazard("H10")
def test_the_stop_of_a_line_takes_what_waits_for_its_drives_along() -> None:
    """One result for each drive, on its own topic and to the asker."""
    gate = Gate()
    gate.send(f"{LEASED}/command", "run")
    gate.send(f"{DIRECT}/command", "run")
    gate.send("line/a/command", {"command": "emergency_stop", "source": "hmi"}, response_topic="me")
    assert gate.verbs == [Verb.RUN, Verb.RUN]
    assert gate.door.stopped_lines == [("a", Verb.EMERGENCY_STOP, Source(Channel.MQTT, "hmi"))]
    assert not gate.listener.is_waiting
    assert [reply["drive"] for _, reply, _ in gate.back.replies] == [LEASED, DIRECT, READ_ONLY]
    gate.send("line/a/command", "run")
    assert gate.back.on(f"{ROOT}/line/a/result")[0]["reason"] == "malformed"


@pytest.mark.hazard("H01")
def test_a_retained_command_is_refused_counted_and_reported() -> None:
    """It never comes to the door."""
    gate = Gate()
    gate.send(f"{LEASED}/command", {"command": "run", "id": "7"}, is_retained=True)
    gate.send(f"{LEASED}/set/frequency", 30, is_retained=True)
    gate.hand_over()
    assert not gate.door.submitted
    assert gate.stats.refused == {"retained": 2}
    assert [(said["status"], said["reason"], said["id"]) for said in gate.back.on(RESULT)] == [
        ("refused", "retained", "7"),
        ("refused", "retained", ""),
    ]


@pytest.mark.hazard("H02")
@pytest.mark.parametrize(("max_age", "is_taken"), [("2s", False), ("10s", True)])
def test_how_old_a_command_may_be_is_configured(max_age: str, is_taken: bool) -> None:
    """By `mqtt.command_max_age`."""
    gate = Gate(command_max_age=max_age)
    gate.send(f"{LEASED}/command", {"command": "run", "issued": gate.clock.wall() - 5.0})
    gate.hand_over()
    assert bool(gate.door.submitted) is is_taken
    assert gate.stats.refused["expired"] == (not is_taken)


@pytest.mark.hazard("H05")
@pytest.mark.hazard("H01")
def test_heartbeats_come_to_the_door_but_for_retained_ones() -> None:
    """With the name of the one who lives."""
    gate = Gate()
    gate.send(f"{LEASED}/heartbeat", 1, is_retained=True)
    gate.send(f"{LEASED}/heartbeat", 2)
    gate.send(f"{LEASED}/heartbeat", {"source": "hmi", "n": 3})
    beats = [(drive, source.name) for drive, source, _ in gate.door.beats]
    assert beats == [(LEASED, ""), (LEASED, "hmi")]
    assert gate.stats.ignored == 1


@pytest.mark.hazard("H05")
def test_only_a_changed_heartbeat_keeps_a_lease() -> None:
    """By the door itself: the same payload again and again is somebody's retransmission."""
    clock = StandingClock()
    door = Door.of(small_site(), clock)
    listener = Listener(section(), "hall-3", door, MqttStats(), clock)

    def send(kind: str, payload: bytes, is_retained: bool = False) -> None:
        listener.hear(Message(f"{ROOT}/{LEASED}/{kind}", payload, is_retained))
        listener.hand_over(1)

    send("command", b'{"command": "take", "source": "hmi"}')
    lease = door.controls[LEASED].lease
    ends = lease.until
    for beat in (b'{"source": "hmi", "n": 1}', b'{"source": "hmi", "n": 1}', b'{"source": "other", "n": 2}', b"3"):
        clock.seconds += 0.3
        send("heartbeat", beat)
        assert lease.until == ends
    send("heartbeat", b'{"source": "hmi", "n": 2}', is_retained=True)
    assert lease.until == ends
    send("heartbeat", b'{"source": "hmi", "n": 2}')
    assert lease.until == clock.now() + lease.duration


@pytest.mark.hazard("H24")
def test_a_flood_is_bounded_counted_and_answered_in_part() -> None:
    """Few wait, the others are busy; so many are told of, then so many a second."""
    gate = Gate()
    for number in range(10_000):
        gate.send(f"{LEASED}/command", {"command": "run", "id": str(number)})
    assert gate.stats.inbox_dropped == gate.stats.refused["busy"] == 10_000 - MOST
    told = gate.back.on(RESULT)
    assert len(told) == REFUSALS_AT_ONCE
    assert {(said["status"], said["reason"]) for said in told} == {("refused", "busy")}
    assert gate.stats.untold == 10_000 - MOST - len(told)
    gate.clock.seconds += 1.0
    for number in range(1000):
        gate.send(f"{LEASED}/command", {"command": "run", "id": str(number)})
    assert len(gate.back.on(RESULT)) == len(told) + REFUSALS
    gate.send(f"{LEASED}/command", "stop")
    assert gate.verbs == [Verb.RUN] * MOST + [Verb.STOP]


@pytest.mark.hazard("H24")
def test_a_flood_of_setpoints_comes_down_to_the_newest() -> None:
    """And a flood of nonsense, or for nobody's drive, to nothing."""
    gate = Gate()
    for number in range(5_000):
        gate.send(f"{LEASED}/set/frequency", number / 100)
        gate.send(f"{LEASED}/set/frequency", "fast")
        gate.send("nobody/command", "run")
        gate.send(f"{READ_ONLY}/command", "stop")
    gate.hand_over()
    assert [command.value for command in gate.door.submitted] == [Decimal("49.99")]
    assert gate.stats.refused["superseded"] == 4_999
    assert gate.stats.refused["malformed"] == 5_000
    assert len(gate.back.said) == REFUSALS_AT_ONCE


@pytest.mark.hazard("H03")
def test_a_setpoint_that_was_superseded_stays_so() -> None:
    """Sent again with its id it does not come after the newer one."""
    gate = Gate()
    for number, name in ((10, "1"), (20, "2"), (10, "1")):
        gate.send(f"{LEASED}/set/frequency", {"value": number, "id": name})
    gate.hand_over()
    assert [command.value for command in gate.door.submitted] == [20]
    assert [(said["id"], said["reason"]) for said in gate.back.on(RESULT)] == [("1", "superseded")] * 2


@pytest.mark.hazard("H03")
def test_the_same_id_gets_the_first_result_again() -> None:
    """By the door itself, and once more to whoever asks."""
    clock = StandingClock()
    door = Door.of(small_site(), clock)
    listener = Listener(section(), "hall-3", door, MqttStats(), clock)
    back = Back()
    listener.begin(back)
    message = b'{"command": "take", "source": "hmi", "id": "1"}'
    listener.hear(Message(f"{ROOT}/{LEASED}/command", message))
    listener.hand_over(1)
    door.controls[LEASED].lease.end()
    listener.hear(Message(f"{ROOT}/{LEASED}/command", message, is_repeated=True, response_topic="me"))
    listener.hand_over(1)
    assert door.controls[LEASED].lease.owner is None
    assert [said["status"] for said in back.on(RESULT)] == ["done", "done"]
    assert [reply["status"] for _, reply, _ in back.replies] == ["done"]


def test_results_that_cannot_be_told_are_counted_and_not_told_later() -> None:
    """The connection is lost, or has no room; the next one begins with what is new."""
    gate = Gate()
    gate.send(f"{LEASED}/command", "take", response_topic="me")
    gate.send(f"{DIRECT}/command", "arm")
    gate.listener.end()
    assert gate.verbs == [Verb.TAKE, Verb.ARM]
    gate.door.finish()
    assert gate.stats.untold == 3
    again = Back(room=1)
    gate.listener.begin(again)
    assert not again.said
    for verb in ("arm", "run"):
        gate.send(f"{LEASED}/command", verb)
    gate.hand_over()
    gate.door.finish()
    assert [said["command"] for _, said in again.said] == ["arm"]
    assert gate.stats.untold == 4


def test_events_are_told_with_their_reason_and_time() -> None:
    """On the drive's own topic."""
    clock = StandingClock()
    door = Door.of(small_site(), clock)
    listener, back = Listener(section(), "hall-3", door, MqttStats(), clock), Back()
    listener.begin(back)
    listener.hear(Message(f"{ROOT}/{LEASED}/command", b'{"command": "take", "source": "hmi"}'))
    listener.hand_over(1)
    assert back.on(f"{ROOT}/{LEASED}/event") == [
        {"event": "taken", "reason": "mqtt hmi", "time": "2026-03-01T12:16:40.000Z"}
    ]


@pytest.mark.hazard("H23")
def test_what_lay_there_while_the_event_loop_stood_still_is_as_old_as_that() -> None:
    """A frozen process does not carry out what was asked of it meanwhile; a stop it does."""
    gate = Gate()
    gate.door.pulse()
    gate.clock.seconds += 0.2
    gate.send(f"{DIRECT}/command", {"command": "run", "id": "1"})
    gate.clock.seconds += 60.0
    gate.send(f"{DIRECT}/command", {"command": "run", "id": "2"})
    gate.hand_over()
    gate.send(f"{DIRECT}/command", "stop")
    fresh, frozen, stop = gate.door.submitted
    assert stop.verb is Verb.STOP
    assert fresh.deadline == gate.clock.now() - 60.0 + 10.0
    assert frozen.deadline == gate.clock.now() - 60.2 + 10.0 < gate.clock.now()


@pytest.mark.hazard("H24")
@pytest.mark.parametrize(
    "topic", ["x" * 60_000 + "/command", "pump-1/set/" + "x" * 129, "line/" + "x" * 2000 + "/command"]
)
def test_topics_that_are_too_long_for_a_result_are_none_of_ours(topic: str) -> None:
    """They name nothing, and would not fit behind the gateway's name again."""
    gate = Gate()
    gate.send(topic, "run")
    assert gate.stats.ignored == 1
    assert not gate.back.said


def test_other_gateways_messages_are_none_of_ours() -> None:
    """Whatever the broker sends."""
    gate = Gate()
    gate.listener.hear(Message("tosvert/hall-4/pump-1/command", b"stop"))
    assert gate.stats.ignored == 1
    assert not gate.door.submitted
