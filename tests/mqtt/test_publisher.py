"""What goes to the broker: news at once, what is owed in time, and nothing wrong for good."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.config import MqttSection
from gateway.image import DriveImage, Image, LinkState
from gateway.metrics import MqttStats
from gateway.mqtt import outcome, payload
from gateway.mqtt.outlet import FOR_EVER, PER_VALUE
from gateway.mqtt.publisher import Publisher
from tests.mqtt import drives

ROOT = "tosvert/hall-3/pump-1"
STATUS = "tosvert/hall-3/status"
EVERY = dict.fromkeys(drives.MODEL.registers, 0)


@dataclass
class Broker:
    """A broker that remembers, behind a wire that holds only so much."""

    room: int = 1000
    retained: dict[str, str] = field(default_factory=dict)
    newest: dict[str, str] = field(default_factory=dict)
    heard: list[tuple[str, str]] = field(default_factory=list)
    expiries: dict[str, int] = field(default_factory=dict)

    def send(self, topic: str, text: str, *, retain: bool, expiry: int) -> None:
        """Take a message at once; look that no quality promises a number that is not there."""
        assert self.room > 0
        self.room -= 1
        self.heard.append((topic, text))
        self.expiries[topic] = expiry
        if retain and text:
            self.retained[topic] = text
        elif retain:
            self.retained.pop(topic, None)
        self.newest[topic] = text
        for name, quality in self.newest.items():
            if name.endswith("/quality") and quality == "good":
                assert self.newest[name.removesuffix("/quality")], name

    def topics(self) -> list[str]:
        """Return the topics of all messages so far, in order, and forget the messages."""
        heard, self.heard = self.heard, []
        return [topic for topic, _ in heard]


class Published:
    """An image whose publisher tells a broker, by a clock that stands until it is set."""

    def __init__(self, image: Image | None = None, **settings: object) -> None:
        self.image = image or drives.image()
        self.pump: DriveImage = self.image.drives[0]
        self.broker = Broker()
        self.stats = MqttStats()
        self.now = 0.0
        section = MqttSection.model_validate({"url": "mqtt://localhost", **settings})
        self.publisher = Publisher(section, "hall-3", self.image, self.stats)
        self.image.subscribe(lambda image, names: self.publisher.tell(self.broker, image, names, self.now))

    def connect(self) -> None:
        """Begin a connection and send all that is owed."""
        self.publisher.owe_everything()
        self.settle()

    def settle(self) -> None:
        """Send what is owed, as far as there is room."""
        while self.publisher.is_owing and self.broker.room >= PER_VALUE:
            self.publisher.settle(self.broker, self.now, 4)

    def read(self, **words: int) -> None:
        """Read values now."""
        drives.read(self.pump, self.now, **words)


def expected(image: DriveImage, now: float) -> dict[str, str]:
    """Return what a broker must retain of a drive, from the image alone; the state apart."""
    named = {"command": "command_value"}
    wanted = {f"{ROOT}/availability": payload.presence(image.link.is_connected)}
    wanted[f"{ROOT}/reset_needed"] = "true" if image.is_reset_needed else "false"
    wanted[f"{ROOT}/control"] = outcome.standing(None)
    if image.is_tripped is not None:
        wanted[f"{ROOT}/tripped"] = "true" if image.is_tripped else "false"
    for name in image.names:
        sample = image.sample(name, now)
        topic = f"{ROOT}/{named.get(name, name)}"
        wanted[f"{topic}/quality"] = sample.quality.word
        if sample.quality.word == "good":
            wanted[topic] = image.show(name, sample.word)
            words = image.text(name, sample.word)
            if words is not None:
                wanted[f"{topic}_text"] = words or "none"
    return wanted


def test_a_connect_brings_everything_and_the_birth_last() -> None:
    """Being online vouches for what was said before it."""
    made = Published()
    made.read(**EVERY)
    made.connect()
    assert made.broker.heard[-1] == (STATUS, "online")
    state = made.broker.retained.pop(f"{ROOT}/state")
    assert json.loads(made.broker.retained.pop(f"{ROOT}/description"))["drive"] == "pump-1"
    assert made.broker.retained == expected(made.pump, 0.0) | {STATUS: "online"}
    assert json.loads(state)["quality"] == "good"


def test_an_answer_is_news_by_value_and_state_once() -> None:
    """Only what changed, and one state for all of it."""
    made = Published()
    made.read(**EVERY)
    made.connect()
    made.broker.topics()
    made.read(output_frequency=6000, torque=0, status=1)
    assert made.broker.topics() == [
        f"{ROOT}/output_frequency",
        f"{ROOT}/status",
        f"{ROOT}/status_text",
        f"{ROOT}/state",
    ]


def test_an_answer_without_news_says_nothing() -> None:
    """Neither value nor state."""
    made = Published()
    made.connect()
    made.read(**EVERY)
    made.broker.topics()
    made.now = 0.5
    made.read(**EVERY)
    assert made.broker.topics() == []


@pytest.mark.hazard("H21")
def test_an_answer_without_a_value_of_the_image_says_nothing() -> None:
    """A look at a register that is not polled; a change of the link is said as ever."""
    made = Published()
    made.pump.set_link(LinkState.ONLINE)
    made.connect()
    made.read(output_frequency=6000)
    made.broker.topics()
    made.pump.apply([(0xFA99, 1)], made.now, made.now)
    made.settle()
    assert made.broker.topics() == []
    made.pump.set_tripped(True)
    made.settle()
    assert f"{ROOT}/tripped" in made.broker.topics()


def test_the_state_shows_one_answer_whole() -> None:
    """All words of an answer stand in the same state."""
    made = Published(publish=["state"])
    made.connect()
    made.read(output_frequency=6000, torque=100)
    state = json.loads(made.broker.retained[f"{ROOT}/state"])
    assert (state["output_frequency"], state["torque"]) == (60, 1)
    assert made.broker.heard[-1][0] == f"{ROOT}/state"


def test_values_alone_and_the_state_alone() -> None:
    """By choice."""
    values, state = Published(publish=["values"]), Published(publish=["state"])
    for made in (values, state):
        made.read(**EVERY)
        made.connect()
    assert f"{ROOT}/state" not in values.broker.retained
    drive = {f"{ROOT}/{name}" for name in ("availability", "reset_needed", "control", "description", "state")}
    assert set(state.broker.retained) == {STATUS, *drive}


def test_a_trip_is_said_at_once_and_taken_back_with_the_drive() -> None:
    """True, false, and nothing when the drive cannot be seen; each once, and in the state too."""
    made = Published()
    made.read(**EVERY)
    made.connect()
    made.broker.topics()
    made.pump.set_tripped(True)
    assert made.broker.heard[-2:][0] == (f"{ROOT}/tripped", "true")
    made.pump.set_tripped(True)
    made.settle()
    assert made.broker.topics() == [f"{ROOT}/tripped", f"{ROOT}/state"]
    assert json.loads(made.broker.retained[f"{ROOT}/state"])["tripped"] is True
    made.pump.set_tripped(False)
    assert made.broker.retained[f"{ROOT}/tripped"] == "false"
    made.pump.set_reset_needed(True)
    assert made.broker.retained[f"{ROOT}/reset_needed"] == "true"
    made.pump.set_link(LinkState.OFFLINE, "silent")
    made.settle()
    assert f"{ROOT}/tripped" not in made.broker.retained
    assert json.loads(made.broker.retained[f"{ROOT}/state"])["tripped"] is None


@pytest.mark.hazard("H19")
def test_a_stale_value_is_taken_back() -> None:
    """The quality says so first, then the number is cleared; the state has null."""
    made = Published()
    made.read(**EVERY)
    made.connect()
    made.broker.topics()
    made.now = 2.0
    made.image.sweep(made.now)
    topics = made.broker.topics()
    number = topics.index(f"{ROOT}/output_frequency")
    assert topics.index(f"{ROOT}/output_frequency/quality") < number
    assert made.broker.retained[f"{ROOT}/output_frequency/quality"] == "stale"
    assert f"{ROOT}/output_frequency" not in made.broker.retained
    assert f"{ROOT}/status_text" not in made.broker.retained
    assert json.loads(made.broker.retained[f"{ROOT}/state"])["output_frequency"] is None


@pytest.mark.hazard("H19")
def test_a_lost_drive_is_offline_at_once_and_a_returned_one_good_when_read() -> None:
    """Availability, qualities and state follow the link without waiting for anything."""
    made = Published()
    made.read(**EVERY)
    made.connect()
    made.pump.set_link(LinkState.OFFLINE, "silent")
    assert made.broker.retained[f"{ROOT}/availability"] == "offline"
    assert made.broker.retained[f"{ROOT}/torque/quality"] == "offline"
    assert f"{ROOT}/torque" not in made.broker.retained
    assert json.loads(made.broker.retained[f"{ROOT}/state"])["quality"] == "offline"
    made.pump.set_link(LinkState.ONLINE)
    assert made.broker.retained[f"{ROOT}/availability"] == "online"
    assert f"{ROOT}/torque" not in made.broker.retained
    made.now = 0.1
    made.read(**EVERY)
    assert made.broker.retained[f"{ROOT}/torque"] == "0.00"


@pytest.mark.hazard("H19")
def test_numbers_of_an_earlier_life_are_cleared_by_a_connect() -> None:
    """Retained by a gateway that was killed; this one has not read them yet."""
    made = Published(retain=False)
    made.broker.retained = {f"{ROOT}/output_frequency": "12.34", f"{ROOT}/status_text": "running"}
    made.connect()
    assert f"{ROOT}/output_frequency" not in made.broker.retained
    assert f"{ROOT}/status_text" not in made.broker.retained


def test_numbers_are_retained_by_choice_and_presence_always() -> None:
    """A newcomer still learns who is there, and what to think of the numbers."""
    made = Published(retain=False)
    made.read(**EVERY)
    made.connect()
    assert (f"{ROOT}/torque", "0.00") in made.broker.heard
    assert f"{ROOT}/torque" not in made.broker.retained
    assert f"{ROOT}/state" not in made.broker.retained


@pytest.mark.hazard("H19")
def test_numbers_expire_later_than_they_are_said_again() -> None:
    """Nobody renews the numbers of a dead gateway; presence has no end."""
    made = Published(longest_silence="60s")
    made.read(**EVERY)
    made.connect()
    assert made.broker.expiries[f"{ROOT}/torque"] == 2 * (60 + drives.MAX_AGE)
    assert made.broker.expiries[f"{ROOT}/state"] == 2 * (60 + drives.MAX_AGE)
    for topic in (STATUS, f"{ROOT}/availability", f"{ROOT}/torque/quality"):
        assert made.broker.expiries[topic] == FOR_EVER


@pytest.mark.hazard("H24")
def test_what_finds_no_room_is_counted_and_sent_as_it_is_then() -> None:
    """The newest of it, once."""
    made = Published()
    made.read(**EVERY)
    made.connect()
    made.broker.room = 0
    for word in (1, 2, 3):
        made.read(output_frequency=word, torque=word)
    made.read(torque=0)
    assert made.stats.dropped == 3 * (2 + 1)  # values and states; 0 is what the broker knows of the torque
    made.broker.room = 100
    made.broker.topics()
    made.settle()
    assert [heard for heard in made.broker.heard if heard[0] != f"{ROOT}/state"] == [
        (f"{ROOT}/output_frequency", "0.03"),
        (f"{ROOT}/torque", "0.00"),
    ]
    assert json.loads(made.broker.retained[f"{ROOT}/state"])["output_frequency"] == 0.03
    assert not made.publisher.is_owing


@pytest.mark.hazard("H24")
def test_settling_goes_in_small_steps_and_stops_where_the_room_ends() -> None:
    """The line's timing and the queue's bound come first."""
    made = Published(drives.image(*(drives.drive(f"pump-{i}") for i in range(1, 30))))
    made.publisher.owe_everything()
    made.publisher.settle(made.broker, 0.0, 4)
    assert len(made.broker.heard) <= 4 * PER_VALUE
    made.broker.room = 10
    made.settle()
    assert 0 <= made.broker.room < PER_VALUE
    assert made.publisher.is_owing


def test_leaving_takes_the_trust_first_and_then_the_numbers() -> None:
    """Gateway, drives, values."""
    made = Published()
    made.read(output_frequency=6000)
    made.connect()
    made.broker.topics()
    made.publisher.leave(made.broker, 0.0)
    assert made.broker.heard[:2] == [(STATUS, "offline"), (f"{ROOT}/availability", "offline")]
    assert made.broker.retained[f"{ROOT}/output_frequency/quality"] == "offline"
    assert f"{ROOT}/output_frequency" not in made.broker.retained
    assert json.loads(made.broker.retained[f"{ROOT}/state"])["quality"] == "never_read"


readings = st.dictionaries(st.sampled_from(sorted(EVERY)), st.integers(0, 0xFFFF), max_size=6).map(
    lambda words: ("read", words)
)
links = st.sampled_from(list(LinkState)).map(lambda link: ("link", link))
rooms = st.integers(0, 40).map(lambda room: ("room", room))
waits = st.sampled_from([0.1, 0.9, 1.1, 70.0]).map(lambda seconds: ("wait", seconds))
others = st.sampled_from([("sweep", None), ("settle", None), ("connect", None), ("restart", None)])
steps = st.lists(st.one_of(readings, links, rooms, waits, others), max_size=30)


def play(made: Published, step: str, argument: object) -> None:
    """Let something happen."""
    match step, argument:
        case "read", Mapping() as words:
            made.read(**words)
        case "link", LinkState() as link:
            made.pump.set_link(link)
        case "room", int() as room:
            made.broker.room = room
        case "wait", float() as seconds:
            made.now += seconds
        case "sweep", _:
            made.image.sweep(made.now)
        case "settle", _:
            made.settle()
        case "restart", _:
            made.broker.retained.clear()
            made.broker.newest.clear()
            made.publisher.owe_everything()
        case _:
            made.publisher.owe_everything()


@pytest.mark.hazard("H19")
@pytest.mark.hazard("H24")
@given(story=steps, silence=st.sampled_from(["0s", "1s", "60s"]))
def test_what_a_broker_retains_always_comes_to_be_the_image(story: list[tuple[str, object]], silence: str) -> None:
    """Whatever happened, however little room there was: nothing stays wrong, no quality lies on the way."""
    made = Published(longest_silence=silence)
    made.publisher.owe_everything()
    for step, argument in story:
        play(made, step, argument)
    made.broker.room = 10_000
    made.image.sweep(made.now)
    made.settle()
    state = json.loads(made.broker.retained.pop(f"{ROOT}/state"), parse_float=Decimal, parse_int=Decimal)
    assert made.broker.retained.pop(f"{ROOT}/description")
    assert made.broker.retained == expected(made.pump, made.now) | {STATUS: "online"}
    fresh = json.loads(payload.StateWriter(made.pump).write(made.now), parse_float=Decimal, parse_int=Decimal)
    assert {**state, "time": None} == {**fresh, "time": None}


def test_a_held_value_is_owed_when_its_time_has_come() -> None:
    """Though it is not read again."""
    made = Published(filter=[{"values": ["output_frequency"], "min_interval": "500ms"}], publish=["values"])
    made.connect()
    made.read(**EVERY)
    made.now = 0.1
    made.read(output_frequency=6000)
    made.publisher.look(0.4)
    assert not made.publisher.is_owing
    assert made.broker.newest[f"{ROOT}/output_frequency"] == "0.00"
    made.now = 0.5
    made.publisher.look(0.5)
    made.settle()
    assert made.broker.newest[f"{ROOT}/output_frequency"] == "60.00"


def test_states_are_no_more_frequent_than_asked() -> None:
    """The last one comes when its time has come; a quality that changes is never kept waiting."""
    made = Published(publish=["state"], state_interval="1s")
    made.connect()
    made.read(**EVERY)
    made.broker.topics()
    for step in range(1, 10):
        made.now = step / 10
        made.read(output_frequency=6000 + step)
    assert made.broker.topics() == []
    made.publisher.look(1.0)
    made.now = 1.0
    made.settle()
    assert made.broker.topics() == [f"{ROOT}/state"]
    assert json.loads(made.broker.retained[f"{ROOT}/state"])["output_frequency"] == 60.09
    made.now = 1.1
    made.pump.set_link(LinkState.OFFLINE)
    made.settle()
    assert f"{ROOT}/state" in made.broker.topics()
