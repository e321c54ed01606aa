"""How readings are taken, remembered until they are there, and written as history."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.backlog import BacklogStats, HistoricalReading, Kept, Kind, milliseconds
from gateway.control.command import Channel, Command, Result, Source, Status, Verb
from gateway.image import DriveImage, Image, LinkState
from gateway.metrics import MqttStats
from gateway.mqtt import payload
from gateway.mqtt.bridge import Bridge
from gateway.mqtt.filters import policies
from gateway.mqtt.forwarding import Forwarder, Parcel
from gateway.mqtt.history import Historian
from gateway.mqtt.in_flight import InFlight
from gateway.mqtt.missed import SHORT, Missed
from gateway.mqtt.outgoing import Outgoing
from gateway.mqtt.receipts import BETWEEN, Receipts
from gateway.mqtt.sampling import Sampler
from gateway.mqtt.unconfirmed import Unconfirmed
from tests.mqtt import drives
from tests.mqtt.doors import LEASED, KeptDoor, small_site
from tests.mqtt.rig import GATEWAY, SkippingClock, section

ROOT = "tosvert/hall-3/pump-1/history"


@given(st.floats(1.7e9, 2.0e9))
@example(1_772_366_400.0005)
@example(1_772_366_400.9999999)
def test_history_has_the_time_that_was_told_live(wall: float) -> None:
    """To the millisecond: receivers tell by topic and time what comes a second time."""
    assert payload.timestamp(milliseconds(wall) / 1000) == payload.timestamp(wall)


class Store:
    """Where numbers come from."""

    origin = "cafe0001"


def pump() -> DriveImage:
    """Return a drive that is online and was never read."""
    return drives.image().drives[0]


def sampler(image: DriveImage, **settings: object) -> Sampler:
    """Return what takes the readings of a drive."""
    return Sampler(image, policies(section(**settings), image))


def written(image: DriveImage, names: tuple[str, ...], now: float, taker: Sampler) -> dict[str, Any] | None:
    """Return what is kept of an answer; None for nothing."""
    taken = taker.take(names, now, drives.WALL + now)
    return None if taken is None else json.loads(taken.written().body)


def test_a_reading_is_kept_as_it_is_published() -> None:
    """Numbers with their decimals, words of bits and codes, the qualities of what is not good."""
    image = pump()
    taker = sampler(image)
    drives.read(image, 1.0, output_frequency=5000, status=1, trip_code=1)
    body = written(image, ("output_frequency", "status", "trip_code"), 1.0, taker)
    assert body == {
        "v": {"output_frequency": "50.00", "status": "1", "trip_code": "1"},
        "t": {"status": "running", "trip_code": "OC1: overcurrent during acceleration"},
    }
    image.set_link(LinkState.OFFLINE, "unplugged")
    assert written(image, (), 1.1, taker) == {
        "v": {"output_frequency": None, "status": None, "trip_code": None},
        "q": {"output_frequency": "offline", "status": "offline", "trip_code": "offline"},
    }


@pytest.mark.parametrize("bases", [{}, {"rated_current": Decimal(25)}])
def test_a_reading_is_kept_by_the_base_that_it_was_published_by(bases: dict[str, Decimal]) -> None:
    """A drive may come back with another one, or without, before the broker is known to be lost."""
    image = pump()
    drives.read(image, 1.0, output_current_rate=5000)
    taken = sampler(image).take(("output_current",), 1.0, drives.WALL + 1.0)
    assert taken is not None
    image.bases = bases
    assert json.loads(taken.written().body)["v"] == {"output_current": "6.25"}


def test_what_is_not_worth_publishing_is_not_worth_keeping() -> None:
    """The same deadband and intervals; what had to wait for its turn is kept when it has come."""
    image = pump()
    taker = sampler(image, filter=[{"values": ["output_*"], "deadband": 1.0, "min_interval": "1s"}])

    def read(word: int, now: float) -> dict[str, Any] | None:
        drives.read(image, now, output_frequency=word)
        return written(image, ("output_frequency",), now, taker)

    assert read(5000, 0.0) is not None
    assert read(5050, 2.0) is None
    assert read(5200, 2.1) is not None
    assert read(5400, 2.2) is None
    assert taker.release(2.5, 0.0) is None
    late = taker.release(3.2, drives.WALL + 3.2)
    assert late is not None
    assert json.loads(late.written().body)["v"] == {"output_frequency": "54.00"}
    assert late.ms == round((drives.WALL + 2.2) * 1000), "when it was read"


def test_a_reading_becomes_a_message_for_each_value_and_one_of_all() -> None:
    """As `publish` says; the last of them finishes it."""
    body = '{"v":{"output_frequency":"50.00","status":null},"q":{"status":"stale"}}'
    kept = Kept(17, HistoricalReading("pump-1", Kind.VALUES, 1_772_366_400_250, body))
    mark = '"time":"2026-03-01T12:00:00.250Z","historical":true,"id":"cafe0001-17"'
    of_values = [
        (f"{ROOT}/output_frequency", f'{{"value":50.00,"quality":"good",{mark}}}'),
        (f"{ROOT}/status", f'{{"value":null,"quality":"stale",{mark}}}'),
    ]
    of_state = (f"{ROOT}/state", f'{{{mark},"output_frequency":50.00,"status":null}}')
    for publish, wanted in (
        (["values"], of_values),
        (["state"], [of_state]),
        (["values", "state"], [*of_values, of_state]),
    ):
        parcels = Historian(section(publish=publish), "hall-3", Store()).unpack(kept)
        assert [parcel.what for parcel in parcels] == wanted
        assert [parcel.number for parcel in parcels] == [0] * (len(wanted) - 1) + [17]


def test_words_go_with_their_value() -> None:
    """And a value whose name is taken stands where it always does."""
    body = '{"v":{"status":"1","state":"2"},"t":{"status":"läuft"}}'
    kept = Kept(1, HistoricalReading("pump-1", Kind.VALUES, 0, body))
    told = {
        parcel.what[0]: json.loads(parcel.what[1]) for parcel in Historian(section(), "hall-3", Store()).unpack(kept)
    }
    assert told[f"{ROOT}/status"]["text"] == "läuft"
    assert told[f"{ROOT}/state_value"]["value"] == 2
    assert told[f"{ROOT}/state"]["status_text"] == "läuft"


def test_an_event_is_told_as_it_was() -> None:
    """With what marks it as history."""
    body = '{"event":"trip","reason":"OC1","code":1,"time":"then"}'
    kept = Kept(3, HistoricalReading("pump-1", Kind.EVENT, 0, body))
    (parcel,) = Historian(section(), "hall-3", Store()).unpack(kept)
    assert parcel.what[0] == f"{ROOT}/event"
    told = json.loads(parcel.what[1])
    assert (told["event"], told["code"], told["historical"], told["id"]) == ("trip", 1, True, "cafe0001-3")


@pytest.mark.parametrize("body", ["", "{", "[]", "1", "{}", '{"v":1}', '{"v":{"a":"nan"}}', '{"v":{"a":"x"}}'])
@pytest.mark.parametrize("kind", [Kind.VALUES, Kind.EVENT])
def test_what_cannot_be_understood_is_no_message(body: str, kind: Kind) -> None:
    """It is let go, and nothing else happens."""
    parcels = Historian(section(), "hall-3", Store()).unpack(Kept(1, HistoricalReading("pump-1", kind, 0, body)))
    assert parcels == [] or kind is Kind.EVENT


@given(
    sent=st.lists(st.integers(0, 3), max_size=30),
    there=st.lists(st.integers(0, 40), max_size=10).map(sorted),
    most=st.integers(1, 40),
)
def test_nothing_is_forgotten_that_is_not_there(sent: list[int], there: list[int], most: int) -> None:
    """Each reading is with the broker, or is kept, once and in order; 0 messages: it found no room."""
    unconfirmed: Unconfirmed[int] = Unconfirmed(most)
    kept, handed, marks = [], 0, {}
    for number, messages in enumerate(sent):
        handed += messages
        marks[number] = handed if messages else None
        kept += unconfirmed.add(number, marks[number])
    for count in there:
        kept += unconfirmed.settle(min(count, handed))
    assert len(unconfirmed) <= most
    kept += unconfirmed.give_up()
    has = min(there[-1], handed) if there else 0
    assert kept == sorted(set(kept))
    for number, mark in marks.items():
        assert number in kept or (mark is not None and mark <= has)


def test_an_event_counts_as_there_when_it_is_acknowledged_itself() -> None:
    """What comes behind it waits, so that the order is kept."""
    unconfirmed: Unconfirmed[str] = Unconfirmed()
    acknowledged: list[bool] = []
    unconfirmed.add("event", 1, lambda: bool(acknowledged))
    unconfirmed.add("value", 2)
    assert unconfirmed.settle(2) == []
    assert len(unconfirmed) == 2
    acknowledged.append(True)
    assert unconfirmed.settle(2) == []
    assert len(unconfirmed) == 0


class Pinged:
    """As much of paho's client as is asked for a ping."""

    def __init__(self) -> None:
        self._ping_t = 0.0
        self.pings = 0
        self.is_connected = True

    def _send_pingreq(self) -> None:
        self.pings += 1
        self._ping_t = 5.0 * self.is_connected


@pytest.fixture
def outgoing() -> Outgoing:
    """Return a way to the broker on which two messages were handed over at QoS 0."""
    made = Outgoing.__new__(Outgoing)
    made.needs_ping, made.handed, made.there, made._batch, made._in_flight = True, 2, 0, None, InFlight()
    return made


def test_a_ping_proves_what_was_handed_over_before_it(outgoing: Outgoing) -> None:
    """And nothing that came later."""
    client = Pinged()
    receipts = Receipts(client, outgoing)
    receipts.ask(0.0)
    outgoing.handed = 3
    assert not receipts.look()
    client._ping_t = 0.0
    assert receipts.look()
    assert outgoing.there == 2
    receipts.ask(BETWEEN / 2)
    assert client.pings == 1, "not more often than that"
    receipts.ask(BETWEEN)
    assert client.pings == 2


def test_a_ping_of_pahos_own_proves_nothing(outgoing: Outgoing) -> None:
    """When it is answered it is time to ask."""
    client = Pinged()
    receipts = Receipts(client, outgoing)
    client._ping_t = 1.0
    receipts.ask(0.0)
    assert client.pings == 0
    client._ping_t = 0.0
    assert receipts.look()
    assert outgoing.there == 0
    receipts.ask(0.0)
    assert client.pings == 1


def test_a_ping_that_could_not_be_sent_proves_nothing(outgoing: Outgoing) -> None:
    """The connection is gone, and nobody has said so yet."""
    client = Pinged()
    client.is_connected = False
    receipts = Receipts(client, outgoing)
    receipts.ask(0.0)
    assert not receipts.look()
    assert outgoing.there == 0


def test_no_ping_is_sent_where_acknowledgements_come_or_nothing_is_open(outgoing: Outgoing) -> None:
    """Above QoS 0, and when all is there."""
    client = Pinged()
    receipts = Receipts(client, outgoing)
    outgoing.there = 2
    receipts.ask(0.0)
    outgoing.there, outgoing.needs_ping = 0, False
    receipts.ask(0.0)
    assert client.pings == 0


class Stored:
    """A backlog that keeps readings in a list."""

    origin = "cafe0001"

    def __init__(self) -> None:
        self.stats = BacklogStats()
        self.readings: list[HistoricalReading] = []

    def put(self, reading: HistoricalReading) -> None:
        """Keep a reading."""
        self.readings.append(reading)

    def ask(self, after: int, count: int, without: frozenset[str], then: Callable[[Sequence[Kept]], None]) -> None:
        """Answer never."""

    def let_go(self, numbers: Sequence[int]) -> None:
        """Nobody has anything while the broker is away."""
        raise NotImplementedError


@pytest.mark.hazard("H12")
@pytest.mark.hazard("H02")
@pytest.mark.parametrize("verb", list(Verb))
async def test_no_command_and_no_result_is_ever_kept(verb: Verb) -> None:
    """Whatever ends while the broker is away; that a drive was reset is an event."""
    clock, stored = SkippingClock(), Stored()
    door = KeptDoor.small(clock)
    door.is_prompt = True
    image = Image(small_site().drives)
    bridge = Bridge(section(), GATEWAY, image, MqttStats(), clock, door=door, backlog=stored)
    asked, now = Source(Channel.MQTT, "hmi"), clock.now()
    command = Command(LEASED, verb, asked, now, now + 1, value=Decimal(30), id="42")
    door.submit(command, lambda _result: None)
    bridge._on_result(Result(command, Status.DONE))
    kept = [json.loads(reading.body) for reading in stored.readings]
    assert [event["event"] for event in kept] == ["reset"] * len(kept)
    assert bool(kept) is (verb is Verb.RESET)
    assert {reading.kind for reading in stored.readings} <= {Kind.EVENT}


async def test_what_happens_to_the_control_of_a_drive_is_kept() -> None:
    """Who lost the lease while the broker was away is told later."""
    clock, stored = SkippingClock(), Stored()
    door = KeptDoor.small(clock)
    Bridge(section(), GATEWAY, Image(small_site().drives), MqttStats(), clock, door=door, backlog=stored)
    door._tell(LEASED, "lease_lost", "the heartbeat has stopped")
    (event,) = [json.loads(reading.body) for reading in stored.readings]
    assert (event["event"], event["reason"]) == ("lease_lost", "the heartbeat has stopped")


@dataclass
class Way:
    """A way to the broker on which some messages wait."""

    waiting: int
    handed: int = 0
    there: int = 0


def test_history_waits_while_much_that_is_live_does() -> None:
    """And rests meanwhile, rather than to look again and again."""
    stored = Stored()
    stored.stats.waiting = 1
    forwarder: Forwarder[Any] = Forwarder(10.0, lambda kept: [Parcel(kept, 1, kept.number)])
    forwarder.begin()
    question = forwarder.question(0.0)
    assert question is not None
    forwarder.take([Kept(1, HistoricalReading("pump-1", Kind.VALUES, 0, "{}"))], question[-1], 0.0)
    image = drives.image()
    missed = Missed(stored, image, lambda each: policies(section(), each), forwarder, SkippingClock())
    assert forwarder.is_due(0.0)
    assert not missed.is_due(Way(SHORT), 0.0)
    assert missed.patience(Way(SHORT), 0.0, 1.0) > 0.01
    assert missed.is_due(Way(SHORT - 1), 0.0)
    assert missed.patience(Way(SHORT - 1), 0.0, 1.0) == 0.0
