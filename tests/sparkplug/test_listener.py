"""What hosts send comes to the door, by the same rules as anybody else's commands."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from decimal import Decimal
from typing import Any

import pytest

from gateway.control.command import Channel, Reason, Result, Source, Verb
from gateway.image import Image, LinkState
from gateway.metrics import MqttStats
from gateway.mqtt.inbox import MOST
from gateway.mqtt.message import Message
from gateway.sparkplug.listener import Listener
from gateway.sparkplug.payload import DataType, Metric, Payload, encode
from gateway.sparkplug.session import Phase
from tests import soak
from tests.mqtt.doors import DIRECT, LEASED, READ_ONLY, KeptDoor, StandingClock, small_site
from tests.sparkplug.rig import Plant, section

DCMD, NCMD = "spBv1.0/Plant 1/DCMD/hall-3/", "spBv1.0/Plant 1/NCMD/hall-3"
STATE = "spBv1.0/STATE/scada"
HOST = Source(Channel.SPARKPLUG, "scada")
INPUTS = 20_000 * soak.FACTOR


class Gate:
    """A listener between a host that is played and a door that keeps what comes to it."""

    def __init__(self, primary_host: str | None = "scada", *, commands: bool = True) -> None:
        self.clock = StandingClock()
        self.door = KeptDoor.small(self.clock)
        image = Image(small_site().drives)
        for each in image.drives:
            each.set_link(LinkState.ONLINE)
        settings = section(primary_host=primary_host, commands=commands)
        self.plant = Plant(image, self.door, primary_host=primary_host, commands=commands)
        self.stats = MqttStats()
        self.listener = Listener(settings, self.plant.node, self.stats, self.clock, self.door)
        self.results: list[Result] = []
        self.door.on_result(self.results.append)
        self.plant.connect(host=False)
        self.listener.begin()
        if primary_host is not None:
            self.state(True, 1000)

    def state(self, is_online: bool, timestamp: int, *, is_retained: bool = False) -> None:
        """Let the host say whether it is online."""
        text = json.dumps({"online": is_online, "timestamp": timestamp})
        self.listener.hear(Message(STATE, text.encode(), is_retained=is_retained))

    def raw(self, topic: str, payload: bytes, **more: Any) -> None:
        """Let a message come, and hand it on."""
        self.listener.hear(Message(topic, payload, **more))
        while self.listener.hand_over(1):
            pass

    def write(self, *metrics: tuple[str, Any], drive: str = LEASED, late: float = 0.0, **more: Any) -> None:
        """Let a DCMD come."""
        sent = tuple(Metric(name, None, None, _type(value), value) for name, value in metrics)
        timestamp = round((self.clock.wall() - late) * 1000)
        self.raw(DCMD + drive, encode(Payload(timestamp, sent)), **more)

    @property
    def verbs(self) -> list[Verb]:
        """Return what came to the door, in order."""
        return [command.verb for command in self.door.submitted]

    @property
    def reasons(self) -> list[Reason]:
        """Return why what was refused was refused."""
        return [result.reason for result in self.results]


def _type(value: Any) -> DataType:
    kinds: dict[type, DataType] = {bool: DataType.BOOLEAN, float: DataType.DOUBLE, int: DataType.INT64}
    return kinds.get(type(value), DataType.STRING)


def test_it_listens_to_its_own_commands_and_to_its_primary_host() -> None:
    """Of every drive that can be commanded, by its own topic."""
    gate = Gate()
    assert gate.listener.command_topics == [NCMD, DCMD + LEASED, DCMD + DIRECT]
    assert gate.listener.state_topic == STATE


def test_without_commands_it_hears_requests_for_a_rebirth_alone() -> None:
    """And no door is there for anything else."""
    gate = Gate(commands=False)
    assert gate.listener.command_topics == [NCMD]
    gate.write(("Control/Stop", True))
    assert gate.door.submitted == []


BUTTONS = [
    ("Control/Take", Verb.TAKE), ("Control/Release", Verb.RELEASE), ("Control/Arm", Verb.ARM),
    ("Control/Run", Verb.RUN), ("Control/Run Reverse", Verb.RUN), ("Control/Stop", Verb.STOP),
    ("Control/Coast", Verb.COAST), ("Control/Emergency Stop", Verb.EMERGENCY_STOP), ("Control/Reset", Verb.RESET),
]  # fmt: skip


@pytest.mark.parametrize(("name", "verb"), BUTTONS)
def test_a_button_asks_for_what_it_says(name: str, verb: Verb) -> None:
    """As the host, by Sparkplug."""
    gate = Gate()
    gate.write((name, True))
    (command,) = gate.door.submitted
    assert (command.verb, command.source, command.drive) == (verb, HOST, LEASED)
    assert command.is_reverse is (name == "Control/Run Reverse")


def test_a_run_button_that_is_let_go_stops_and_the_others_do_nothing() -> None:
    """False at Control/Run can mean nothing else, and a stop is never wrong."""
    for name, _ in BUTTONS:
        gate = Gate()
        gate.write((name, False))
        assert gate.verbs == ([Verb.STOP] if "Run" in name else [])
        assert gate.results == []


def test_values_are_set_by_their_metrics() -> None:
    """By name or by alias, in the register's unit, as exact as a decimal."""
    gate = Gate()
    gate.write(("Control/Frequency", 30.1))
    metrics = gate.plant.node.devices[LEASED].metrics
    alias = metrics.inputs["Control/Frequency"].alias
    gate.raw(DCMD + LEASED, encode(Payload(None, (Metric("", alias, None, DataType.FLOAT, 12.3),))))
    first, second = gate.door.submitted
    assert (first.verb, first.value) == (Verb.FREQUENCY, Decimal("30.1"))
    assert (second.verb, second.value) == (Verb.FREQUENCY, Decimal("12.3"))


def test_a_command_can_be_written_as_mqtt_has_it() -> None:
    """A word, or JSON with all that it may carry; the source is the host, whatever it says."""
    gate = Gate()
    gate.write(("Control/Command", "take"))
    gate.write(("Control/Command", '{"command": "run", "frequency": 30.0, "id": "7", "source": "somebody"}'))
    take, run = gate.door.submitted
    assert (take.verb, run.verb, run.id, run.value) == (Verb.TAKE, Verb.RUN, "7", Decimal("30.0"))
    assert (take.source, run.source) == (HOST, HOST)


def test_the_metrics_of_one_command_are_carried_out_in_their_order() -> None:
    """So that a host can take, arm and run at once."""
    gate = Gate()
    gate.write(("Control/Take", True), ("Control/Arm", True), ("Control/Frequency", 20.0), ("Control/Run", True))
    assert gate.verbs == [Verb.TAKE, Verb.ARM, Verb.FREQUENCY, Verb.RUN]


def test_a_heartbeat_is_a_sign_of_life() -> None:
    """A number or a text, handed on as it is written."""
    gate = Gate()
    gate.write(("Control/Heartbeat", 17))
    gate.write(("Control/Heartbeat", "x"))
    assert gate.door.beats == [(LEASED, HOST, b"17"), (LEASED, HOST, b'"x"')]


WRONG: list[tuple[str, Any, Reason]] = [
    ("Control/Frequency", True, Reason.MALFORMED),
    ("Control/Frequency", None, Reason.MALFORMED),
    ("Control/Frequency", float("nan"), Reason.MALFORMED),
    ("Control/Frequency", float("inf"), Reason.MALFORMED),
    ("Control/Frequency", "30 Hz", Reason.MALFORMED),
    ("Control/Frequency", b"\x00", Reason.MALFORMED),
    ("Control/Run", 1, Reason.MALFORMED),
    ("Control/Run", "true", Reason.MALFORMED),
    ("Control/Command", 5, Reason.MALFORMED),
    ("Control/Command", "fly", Reason.MALFORMED),
    ("Control/Heartbeat", True, Reason.MALFORMED),
    ("output_frequency", 30.0, Reason.NOT_IN_MODEL),
    ("Control/Standing", "armed", Reason.NOT_IN_MODEL),
    ("nothing", 1, Reason.NOT_IN_MODEL),
    ("", 1, Reason.NOT_IN_MODEL),
]


@pytest.mark.parametrize(("name", "value", "reason"), WRONG)
def test_what_cannot_be_written_is_refused_with_a_result(name: str, value: Any, reason: Reason) -> None:
    """Nothing comes to the door, and the host can read why."""
    gate = Gate()
    gate.write((name, value))
    assert (gate.door.submitted, gate.door.beats) == ([], [])
    assert gate.reasons == [reason]
    assert gate.results[0].command.source == HOST


def test_no_payload_is_refused_with_a_result() -> None:
    """JSON, text, a broken message."""
    gate = Gate()
    for payload in (b'{"command": "run"}', b"\xff" * 30, b"\x12"):
        gate.raw(DCMD + LEASED, payload)
    assert gate.reasons == [Reason.MALFORMED] * 3


@pytest.mark.hazard("H01")
def test_what_was_retained_is_refused_whatever_it_is() -> None:
    """A run, a stop, a heartbeat, a rebirth."""
    gate = Gate()
    gate.write(("Control/Run", True), ("Control/Stop", True), ("Control/Heartbeat", 1), is_retained=True)
    assert (gate.door.submitted, gate.door.beats) == ([], [])
    assert gate.reasons == [Reason.RETAINED] * 2
    gate.plant.settle()
    born = len(gate.plant.back.sent)
    gate.raw(NCMD, rebirth(), is_retained=True)
    gate.plant.now += 5
    assert gate.plant.settle() == []
    assert len(gate.plant.back.sent) == born


@pytest.mark.hazard("H02")
@pytest.mark.parametrize("late", [2.5, -2.5])
def test_what_was_sent_too_long_ago_is_refused_and_a_stop_is_not(late: float) -> None:
    """By the time that every command must carry; so is what comes from the future."""
    gate = Gate()
    gate.write(("Control/Run", True), ("Control/Heartbeat", 3), late=late)
    gate.write(("Control/Stop", True), late=late)
    assert gate.verbs == [Verb.STOP]
    assert gate.door.beats == []
    assert gate.reasons == [Reason.EXPIRED]


@pytest.mark.hazard("H02")
def test_what_came_before_the_subscription_or_twice_is_refused() -> None:
    """It may be from an earlier session."""
    gate = Gate()
    gate.write(("Control/Run", True), is_early=True)
    gate.write(("Control/Run", True), is_repeated=True)
    assert gate.verbs == []
    assert gate.reasons == [Reason.EXPIRED] * 2


@pytest.mark.hazard("H05")
def test_a_host_that_goes_offline_loses_its_lease_at_once() -> None:
    """Its death is known: nobody waits for heartbeats to stay away. The lease of another way in stays."""
    gate = Gate()
    for drive, source in ((LEASED, HOST), (DIRECT, Source(Channel.MQTT, "room"))):
        assert gate.door.controls[drive].lease.take(source, gate.clock.now())
    gate.state(False, 1000)
    assert gate.door.controls[LEASED].lease.owner is None
    assert gate.door.controls[DIRECT].lease.owner is not None
    assert gate.door.controls[LEASED].reason == "the primary host scada is offline"


@pytest.mark.hazard("H05")
def test_an_online_host_renews_no_lease() -> None:
    """The broker keeps that message: it says nothing of now. A heartbeat does."""
    gate = Gate()
    lease = gate.door.controls[LEASED].lease
    lease.take(HOST, gate.clock.now())
    until = lease.until
    gate.clock.seconds += 1.0
    gate.state(True, 2000)
    gate.state(True, 3000, is_retained=True)
    assert lease.until == until


@pytest.mark.hazard("H05")
def test_an_old_word_of_the_hosts_death_ends_nothing() -> None:
    """It is of a session that has ended already, and a newer one has begun."""
    gate = Gate()
    gate.door.controls[LEASED].lease.take(HOST, gate.clock.now())
    gate.state(False, 999)
    assert gate.door.controls[LEASED].lease.owner == HOST
    assert gate.plant.node.session.phase is not Phase.LEAVING


@pytest.mark.hazard("H05")
def test_while_the_host_is_not_online_only_stops_are_carried_out() -> None:
    """Only the primary host may command, and it says that it is not there."""
    gate = Gate()
    gate.state(False, 1001)
    gate.write(("Control/Take", True), ("Control/Run", True), ("Control/Stop", True))
    assert gate.verbs == [Verb.STOP]
    assert gate.reasons == [Reason.NOT_PERMITTED] * 2


def test_without_a_primary_host_commands_are_taken_at_once() -> None:
    """And births are sent at once."""
    gate = Gate(None)
    gate.write(("Control/Run", True))
    assert [command.source for command in gate.door.submitted] == [Source(Channel.SPARKPLUG)]
    assert gate.plant.node.session.phase is Phase.NODE_BIRTH


def rebirth(value: object = True, kind: DataType = DataType.BOOLEAN) -> bytes:
    """Return a request for all births."""
    return encode(Payload(5, (Metric("Node Control/Rebirth", None, 5, kind, value),)))  # type: ignore[arg-type]


def test_a_rebirth_is_asked_for_by_true_alone() -> None:
    """False, null, a number or a text are no request."""
    for payload, is_asked in (
        (rebirth(), True),
        (rebirth(False), False),
        (rebirth(None), False),
        (rebirth(1, DataType.INT32), False),
        (rebirth("true", DataType.STRING), False),
        (b"\xff", False),
    ):
        gate = Gate()
        gate.plant.settle()
        gate.raw(NCMD, payload)
        assert (gate.plant.node.session.phase is Phase.NODE_BIRTH) is is_asked
        assert gate.stats.ignored == (not is_asked)


def test_a_line_is_stopped_by_its_metric_of_the_node() -> None:
    """stop, coast and emergency_stop, for every drive of it."""
    gate = Gate()
    for word in ("stop", "emergency_stop", "run"):
        metric = Metric("Lines/a/Command", None, None, DataType.STRING, word)
        gate.raw(NCMD, encode(Payload(None, (metric,))))
    assert gate.door.stopped_lines == [("a", Verb.STOP, HOST), ("a", Verb.EMERGENCY_STOP, HOST)]
    assert gate.reasons[-1] is Reason.MALFORMED


@pytest.mark.hazard("H24")
def test_a_stop_waits_for_nothing_and_a_flood_finds_little_room() -> None:
    """The inbox of MQTT: so many for a drive, and a stop ahead of them."""
    gate = Gate()
    for _ in range(MOST + 5):
        gate.listener.hear(Message(DCMD + LEASED, encode(Payload(None, (_pressed("Control/Run"),)))))
    assert gate.reasons == [Reason.BUSY] * 5
    gate.listener.hear(Message(DCMD + LEASED, encode(Payload(None, (_pressed("Control/Stop"),)))))
    assert gate.verbs == [Verb.RUN] * MOST + [Verb.STOP]


def _pressed(name: str) -> Metric:
    return Metric(name, None, None, DataType.BOOLEAN, True)


def test_what_is_for_others_is_passed_over() -> None:
    """Other hosts, other nodes, other drives."""
    gate = Gate()
    for topic in (DCMD + READ_ONLY, DCMD + "nobody", "spBv1.0/STATE/other", "spBv1.0/x/NCMD/hall-3"):
        gate.raw(topic, b'{"online": false, "timestamp": 9999999999999}')
    assert gate.door.submitted == []
    assert gate.stats.ignored == 4
    assert gate.plant.node.session.phase is Phase.NODE_BIRTH


def test_a_state_that_is_none_changes_nothing() -> None:
    """It is counted."""
    gate = Gate()
    gate.raw(STATE, b"OFFLINE")
    assert gate.plant.node.session.phase is Phase.NODE_BIRTH
    assert gate.stats.ignored == 1


@pytest.mark.unmeasured
@pytest.mark.hazard("H17")
def test_whatever_a_host_sends_nothing_escapes_and_each_command_has_one_result() -> None:
    """Mutated commands for the node and for drives: they come to the door, are refused, or mean nothing."""
    chance = random.Random(20260302)
    gate = Gate()
    seeds: list[Callable[[], bytes]] = [
        lambda: encode(Payload(None, (_pressed(chance.choice(BUTTONS)[0]), _pressed("Control/Stop")))),
        lambda: encode(Payload(chance.randrange(2**64), (_pressed("Control/Run"),))),
        lambda: encode(Payload(None, (Metric("Control/Heartbeat", None, 5, 4, 1),))),
        lambda: encode(Payload(None, (Metric("Control/Frequency", None, 5, 10, chance.uniform(-9, 99)),))),
        lambda: encode(Payload(None, (Metric("", chance.randrange(200), 5, 9, 30.1),))),
        lambda: encode(Payload(None, (Metric("Control/Command", None, 5, 12, '{"command": "run", "id": "1"}'),))),
        lambda: encode(Payload(None, (Metric("Lines/a/Command", None, 5, 12, "stop"),))),
        rebirth,
    ]
    topics = (DCMD + LEASED, DCMD + DIRECT, NCMD, STATE)
    for _ in range(INPUTS):
        message = bytearray(chance.choice(seeds)())
        for _ in range(chance.randrange(4)):
            at = chance.randrange(len(message) + 1)
            if chance.randrange(2):
                message[at : at + chance.randrange(4)] = chance.randbytes(chance.randrange(4))
            else:
                message[at:at] = chance.choice(seeds)()[: chance.randrange(30)]
        gate.raw(chance.choice(topics), bytes(message))
        gate.clock.seconds += 0.1
        gate.door.finish()
    assert len(gate.door.submitted) > INPUTS // 20
    assert {Reason.MALFORMED, Reason.NOT_IN_MODEL, Reason.EXPIRED} <= set(gate.reasons)
    assert gate.plant.node.session.phase is Phase.NODE_BIRTH
