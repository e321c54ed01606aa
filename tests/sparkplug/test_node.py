"""What an edge node tells of itself and its drives, and in which order."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gateway import site
from gateway.control.command import Channel, Command, Result, Source, Status, Verb
from gateway.control.door import Door
from gateway.image import Image, LinkState
from gateway.sparkplug import payload as payloads
from gateway.sparkplug.listener import Listener
from gateway.sparkplug.payload import DataType, Property, QualityCode
from gateway.sparkplug.session import Happening
from tests.mqtt import drives
from tests.mqtt.doors import DIRECT, LEASED, READ_ONLY, KeptDoor, StandingClock, small_site
from tests.sparkplug.rig import WALL_MS, Plant, Sent, named

TOPICS = [
    "spBv1.0/Plant 1/NBIRTH/hall-3",
    "spBv1.0/Plant 1/DBIRTH/hall-3/pump-1",
    "spBv1.0/Plant 1/DDATA/hall-3/pump-1",
    "spBv1.0/Plant 1/DDEATH/hall-3/pump-1",
    "spBv1.0/Plant 1/NDATA/hall-3",
]


def controlled(**settings: object) -> tuple[Plant, KeptDoor]:
    """Return a plant with the drives of the small site, which can be commanded but for one."""
    door = KeptDoor.small(StandingClock())
    image = Image(small_site().drives)
    for each in image.drives:
        each.set_link(LinkState.ONLINE)
    return Plant(image, door, **{"commands": True, **settings}), door


def metrics_of(sent: Sent) -> dict[str, object]:
    """Return the values of a birth by name."""
    return {metric.name: metric.value for metric in sent.payload.metrics}


def test_the_node_is_born_first_and_then_every_drive_that_is_there() -> None:
    """A drive that is silent has no birth, so hosts do not know it."""
    plant = Plant(drives.image(drives.drive("pump-1"), drives.drive("pump-2"), drives.drive("fan-1")))
    plant.image.by_name["pump-2"].set_link(LinkState.OFFLINE, "no answer")
    plant.live()
    assert plant.back.kinds == ["NBIRTH", "DBIRTH pump-1", "DBIRTH fan-1"]
    assert [sent.payload.seq for sent in plant.back.sent] == [0, 1, 2]


def test_topics_are_those_of_the_specification() -> None:
    """Namespace, group, kind, edge node, device."""
    plant = Plant()
    plant.live()
    plant.read(output_frequency=5000)
    plant.pump.set_link(LinkState.OFFLINE, "no answer")
    plant.settle()
    assert plant.back.topics == TOPICS


def test_nothing_is_sent_before_the_primary_host_is_online() -> None:
    """Births are for somebody who listens."""
    plant = Plant()
    plant.connect(host=False)
    plant.read(output_frequency=5000)
    assert plant.settle() == []
    plant.node.take(Happening.HOST_ONLINE)
    assert [sent.kind for sent in plant.settle()] == ["NBIRTH", "DBIRTH"]


def test_the_birth_of_the_node_has_the_number_of_the_will() -> None:
    """So that hosts know which death belongs to it, and when connections come quickly."""
    plant = Plant()
    for number in range(3):
        will = payloads.decode(plant.node.will(5))
        born = plant.live()[0]
        assert will.seq is None
        assert [(m.name, m.datatype, m.value) for m in will.metrics] == [("bdSeq", DataType.INT64, number)]
        assert metrics_of(born)["bdSeq"] == number
        assert payloads.decode(plant.node.death(5)) == will
        plant.node.take(Happening.LOST)
        plant.now += 10


def test_the_birth_of_the_node_can_be_asked_for_again() -> None:
    """Node Control/Rebirth: boolean, false, without an alias; bdSeq stays as it was."""
    plant = Plant()
    plant.live()
    (rebirth,) = [m for m in plant.back.sent[0].payload.metrics if m.name == "Node Control/Rebirth"]
    assert (rebirth.datatype, rebirth.value, rebirth.alias) == (DataType.BOOLEAN, False, None)
    plant.now += 10
    plant.node.rebirth()
    plant.read(output_frequency=5000)
    assert plant.back.kinds[2:] == []
    again = plant.settle()
    assert [(sent.kind, sent.payload.seq) for sent in again] == [("NBIRTH", 0), ("DBIRTH", 1)]
    assert metrics_of(again[0])["bdSeq"] == 0
    assert metrics_of(again[1])["output_frequency"] == 50.0


@pytest.mark.hazard("H24")
def test_a_flood_of_requests_for_a_rebirth_is_no_flood_of_births() -> None:
    """One a second, and nothing is sent in between."""
    plant = Plant()
    plant.live()
    for _ in range(100):
        plant.now += 0.05
        plant.node.rebirth()
        plant.settle()
    assert 4 <= plant.back.kinds.count("NBIRTH") <= 6


def test_a_rebirth_in_the_middle_of_births_begins_with_the_node() -> None:
    """Every drive has one birth after it."""
    plant = Plant(drives.image(drives.drive("pump-1"), drives.drive("pump-2")))
    plant.connect()
    for _ in range(2):
        plant.node.settle(plant.back, plant.moment, 1)
    plant.node.rebirth()
    plant.now += 2
    plant.settle()
    assert plant.back.kinds == ["NBIRTH", "DBIRTH pump-1", "NBIRTH", "DBIRTH pump-1", "DBIRTH pump-2"]


def test_a_drive_is_born_with_every_metric_that_it_will_ever_tell() -> None:
    """Each with a name, an alias of its own, a type, a time, and a value or null."""
    plant, _ = controlled()
    aliases: list[int] = []
    for sent in plant.live():
        for metric in sent.payload.metrics:
            assert metric.name
            assert metric.datatype in list(DataType)
            assert metric.timestamp
            if metric.name not in ("bdSeq", "Node Control/Rebirth"):
                assert metric.alias is not None
                aliases.append(metric.alias)
        lower = [name.lower() for name in sent.names]
        assert len(set(lower)) == len(lower)
        folders = {name.split("/")[0] for name in lower if "/" in name}
        assert not folders & set(lower), "a tag cannot be a folder too"
    assert len(set(aliases)) == len(aliases)


def test_values_are_told_as_numbers_of_their_kind() -> None:
    """A value with decimals as Double, a bit field as UInt16 with its words beside it, units as engUnit."""
    plant = Plant()
    plant.read(output_frequency=5012, torque=0xFF9C, status=0x0001, trip_code=1, output_current_rate=10000)
    born = {metric.name: metric for metric in plant.live()[1].payload.metrics}
    shown = {name: (born[name].datatype, born[name].value) for name in plant.pump.names}
    assert shown == {
        "output_frequency": (DataType.DOUBLE, 50.12),
        "torque": (DataType.DOUBLE, -1.0),
        "status": (DataType.UINT16, 1),
        "trip_code": (DataType.UINT16, 1),
        "command": (DataType.UINT16, None),
        "output_current_rate": (DataType.DOUBLE, 100.0),
        "output_current": (DataType.DOUBLE, 12.5),
    }
    assert born["status_text"].value == "running"
    assert born["trip_code_text"].value == "OC1: overcurrent during acceleration"
    assert born["output_frequency"].timestamp == WALL_MS + 100_000


def test_properties_say_unit_quality_and_whether_it_can_be_written() -> None:
    """Read from the definitions, since our own decoder passes over them; foreign ones judge the bytes."""
    plant = Plant()
    frequency = plant.node.devices["pump-1"].metrics.values["output_frequency"]
    assert frequency.properties == (
        Property("readOnly", DataType.BOOLEAN, True),
        Property("engUnit", DataType.STRING, "Hz"),
    )


def test_only_what_changed_is_told_and_by_its_alias() -> None:
    """Nothing is told again for having been read again."""
    plant = Plant()
    plant.read(output_frequency=5000, torque=100)
    plant.live()
    before = len(plant.back.sent)
    plant.now += 0.1
    plant.read(output_frequency=5000, torque=100)
    assert plant.back.sent[before:] == []
    plant.read(output_frequency=5001, torque=100)
    (data,) = plant.back.sent[before:]
    (metric,) = data.payload.metrics
    assert (metric.name, metric.value, metric.datatype) == ("", 50.01, DataType.DOUBLE)
    assert metric.alias == plant.node.devices["pump-1"].metrics.values["output_frequency"].alias
    assert metric.timestamp == WALL_MS + 100_100


def test_a_deadband_holds_small_changes_back() -> None:
    """As for MQTT."""
    plant = Plant(deadband={"output_frequency": 0.5})
    plant.read(output_frequency=5000)
    plant.live()
    before = len(plant.back.sent)
    plant.read(output_frequency=5050)
    assert plant.back.sent[before:] == []
    plant.read(output_frequency=5051)
    assert len(plant.back.sent[before:]) == 1


@pytest.mark.hazard("H19")
def test_a_stale_value_is_null_and_says_so() -> None:
    """Never an old number as if it were new: null, with the property Quality 500 from now on; then 192 again."""
    plant = Plant()
    plant.read(output_frequency=5000)
    plant.live()
    before = len(plant.back.sent)
    plant.now += 2 * drives.MAX_AGE
    plant.pump.sweep(plant.now)
    (stale,) = plant.back.sent[before:]
    metrics = plant.node.devices["pump-1"].metrics
    metric = named(stale, metrics)["output_frequency"]
    assert metric.value is None
    assert metric.timestamp == WALL_MS + round(plant.now * 1000)
    assert _qualities(stale) == [QualityCode.STALE]
    plant.now += 0.1
    plant.read(output_frequency=5000)
    good = plant.back.sent[-1]
    assert (named(good, metrics)["output_frequency"].value, _qualities(good)) == (50.0, [QualityCode.GOOD])
    plant.now += 0.1
    plant.read(output_frequency=5100)
    assert _qualities(plant.back.sent[-1]) == []


def _qualities(sent: Sent) -> list[int]:
    """Return the values of the property Quality in a message, read from its bytes."""
    found = []
    for code in QualityCode:
        wanted = encode_quality(code)
        found += [int(code)] * sent.raw.count(wanted)
    return found


def encode_quality(code: QualityCode) -> bytes:
    """Return a set of properties with nothing but a quality, as it stands in a message."""
    quality = Property("Quality", DataType.INT32, int(code))
    whole = payloads.encode_metric(payloads.Metric(value=None, properties=(quality,)))
    return whole[2:]  # without is_null


@pytest.mark.hazard("H19")
def test_a_value_that_was_never_read_is_null_and_bad() -> None:
    """Born all the same, since it will be told of."""
    plant = Plant()
    born = plant.live()[1]
    assert metrics_of(born)["output_frequency"] is None
    assert b"\x08\x03\x18\x00" in born.raw  # Int32, int_value 0


@pytest.mark.hazard("H19")
def test_a_lost_drive_dies_and_is_born_again_when_it_is_back() -> None:
    """All of its metrics are stale with a host in between."""
    plant = Plant()
    plant.read(output_frequency=5000)
    plant.live()
    plant.pump.set_link(LinkState.SUSPECT, "no answer")
    assert plant.settle() == []
    plant.pump.set_link(LinkState.OFFLINE, "no answer")
    assert plant.back.kinds[2:] == ["DDEATH pump-1"]
    assert plant.back.sent[-1].payload.metrics == ()
    plant.pump.set_link(LinkState.ONLINE)
    plant.settle()
    assert plant.back.kinds[3:] == ["DBIRTH pump-1"]
    assert metrics_of(plant.back.sent[-1])["output_frequency"] is None


def test_a_drive_that_was_lost_while_the_broker_was_slow_dies_all_the_same() -> None:
    """It is back by then: a host that saw no death would take the values before for unbroken."""
    plant = Plant()
    plant.live()
    plant.back.room = 0
    plant.pump.set_link(LinkState.OFFLINE, "no answer")
    plant.pump.set_link(LinkState.ONLINE)
    plant.back.room = 10
    plant.settle()
    assert plant.back.kinds[2:] == ["DDEATH pump-1", "DBIRTH pump-1"]


def test_what_finds_no_room_is_told_later_as_it_is_then() -> None:
    """The newest value, once."""
    plant = Plant()
    plant.read(output_frequency=5000)
    plant.live()
    plant.back.room = 0
    for frequency in range(5001, 5100):
        plant.now += 0.01
        plant.read(output_frequency=frequency)
    plant.back.room = 10
    (data,) = plant.settle()
    assert [metric.value for metric in data.payload.metrics] == [50.99]


def test_metrics_stand_in_the_order_of_their_times() -> None:
    """As every message must have them."""
    plant = Plant()
    plant.read(torque=100)
    plant.now += 0.5
    plant.read(output_frequency=5000)
    for sent in plant.live():
        times = [metric.timestamp or 0 for metric in sent.payload.metrics]
        assert times == sorted(times)


def test_the_node_tells_how_many_drives_it_has() -> None:
    """When that changes."""
    plant = Plant(drives.image(drives.drive("pump-1"), drives.drive("pump-2")))
    assert metrics_of(plant.live()[0])["Drives Connected"] == 2
    plant.pump.set_link(LinkState.OFFLINE, "no answer")
    (data,) = [sent for sent in plant.settle() if sent.kind == "NDATA"]
    assert [(metric.name, metric.value) for metric in data.payload.metrics] == [("", 1)]


def test_drives_that_came_while_there_was_no_connection_are_counted() -> None:
    """Nobody is told of links then."""
    plant = Plant()
    plant.image.drives[0].set_link(LinkState.OFFLINE)
    plant.pump.link = LinkState.ONLINE
    plant.connect()
    (birth, *_) = plant.settle()
    assert {metric.name: metric.value for metric in birth.payload.metrics}["Drives Connected"] == 1


def test_numbers_go_on_after_255() -> None:
    """With 0, whatever kind the message is of."""
    plant = Plant()
    plant.live()
    for turn in range(300):
        plant.now += 0.01
        plant.read(output_frequency=turn)
    numbers = [sent.payload.seq for sent in plant.back.sent]
    assert numbers == [turn % 256 for turn in range(302)]


def test_a_birth_that_the_broker_does_not_take_is_left_out_and_no_number_with_it() -> None:
    """The others go on without a gap; no data follows that nobody could read."""
    sizes = {sent.device: len(sent.raw) for sent in controlled()[0].live()}
    assert sizes[LEASED] > sizes[READ_ONLY]
    plant, _ = controlled()
    plant.back.largest = sizes[READ_ONLY]
    plant.live()
    assert plant.back.kinds == ["NBIRTH", f"DBIRTH {READ_ONLY}"]
    drives_read = plant.image.by_name[LEASED]
    drives_read.apply([(0xFD00, 5000)], plant.now, 1000.0)
    assert plant.settle() == []
    assert [sent.payload.seq for sent in plant.back.sent] == [0, 1]


def test_control_is_told_by_metrics() -> None:
    """Who may command, and what can be written, where somebody may."""
    plant, door = controlled()
    born = {sent.device: metrics_of(sent) for sent in plant.live()}
    assert [born[name]["Control/Mode"] for name in (LEASED, DIRECT, READ_ONLY)] == ["leased", "direct", "off"]
    assert born[LEASED]["Control/Owner"] == ""
    assert born[LEASED]["Control/Run"] is False
    assert "Control/Run" not in born[READ_ONLY]
    assert born[""]["Lines/a/Command"] == ""
    door.controls[LEASED].lease.take(Source(Channel.SPARKPLUG, "scada"), 1.0)
    plant.node.look()
    (data,) = plant.settle()
    told = named(data, plant.node.devices[LEASED].metrics)
    assert {name: metric.value for name, metric in told.items()} == {"Control/Owner": "sparkplug scada"}


def test_without_commands_nothing_can_be_written() -> None:
    """Control is told, and no metric says that it can be written."""
    plant, _ = controlled(commands=False)
    plant.live()
    for device in plant.node.devices.values():
        assert device.metrics.writable == {}
        assert device.metrics.inputs == {}
    assert plant.node.line_inputs == {}


def test_a_drive_that_sparkplug_may_not_command_shows_nothing_to_write() -> None:
    """`sources` of the drive leave it out: its metrics are read only, and nobody listens to commands for it."""
    drive = {"name": "p", "number": 1, "model": "vf-nc3", "control": "direct", "unwatched": True, "sources": ["mqtt"]}
    line = {"name": "a", "port": "/dev/null", "drive": [drive]}
    built = site.build({"gateway": {"name": "hall-3"}, "line": [line]}, "test", Path())
    door = Door.of(built, StandingClock())
    plant = Plant(Image(built.drives), door, commands=True)
    assert plant.node.devices["p"].metrics.writable == {}
    listener = Listener(plant.section, plant.node, plant.stats, StandingClock(), door)
    assert listener.command_topics == ["spBv1.0/Plant 1/NCMD/hall-3"]


def test_results_and_events_are_told_each_by_each_in_order() -> None:
    """Several of one metric in a message, in the order of time; the newest stands in the next birth."""
    plant, _ = controlled()
    plant.live()
    source = Source(Channel.SPARKPLUG)
    for number, verb in enumerate((Verb.TAKE, Verb.ARM)):
        plant.node.note_result(Result(Command(LEASED, verb, source, 0, 1), Status.DONE), 1000.0 + number)
    plant.node.note_event(LEASED, "armed", "", 1002.0)
    (data,) = plant.settle()
    metrics = plant.node.devices[LEASED].metrics
    results = [m for m in data.payload.metrics if m.alias == metrics.told["Control/Result"].alias]
    assert [json.loads(str(m.value))["command"] for m in results] == ["take", "arm"]
    assert [m.timestamp for m in data.payload.metrics] == [1_000_000, 1_001_000, 1_002_000]
    plant.now += 5
    plant.node.rebirth()
    born = next(metrics_of(sent) for sent in plant.settle() if sent.device == LEASED)
    assert json.loads(str(born["Control/Result"]))["command"] == "arm"
    assert json.loads(str(born["Control/Event"]))["event"] == "armed"


@pytest.mark.parametrize("happening", [Happening.LOST, Happening.HOST_OFFLINE, Happening.REBIRTH])
def test_an_event_without_a_session_cannot_be_told(happening: Happening) -> None:
    """Whoever tells of it keeps it, though hosts knew the drive before: they hear no more of this session."""
    plant, _ = controlled()
    plant.live()
    assert plant.node.note_event(LEASED, "armed", "", 1000.0)
    plant.settle()
    plant.node.take(happening)
    assert not plant.node.note_event(LEASED, "disarmed", "", 1001.0)
    assert plant.node.tells_events(LEASED)
    assert not plant.node.tells_events(READ_ONLY)


def test_an_event_is_sent_by_itself_at_once() -> None:
    """How the drive stands comes behind it: who tells of an event is about to change that, too."""
    plant, _ = controlled()
    plant.live()
    plant.node.note_event(LEASED, "taken", "", 1000.0)
    assert plant.node.send_told(plant.back, LEASED, plant.moment)
    data = plant.back.sent[-1]
    assert [m.alias for m in data.payload.metrics] == [plant.node.devices[LEASED].metrics.told["Control/Event"].alias]
    assert data.payload.seq == (plant.back.sent[-2].payload.seq or 0) + 1
    assert plant.settle() == []
    plant.node.note_event(LEASED, "released", "", 1001.0)
    plant.back.room = 0
    assert not plant.node.send_told(plant.back, LEASED, plant.moment)
    plant.back.room = 10
    assert len(plant.settle()) == 1, "it is told as soon as there is room"


@pytest.mark.hazard("H24")
def test_results_that_nobody_takes_are_bounded_and_counted() -> None:
    """The broker does not read: the first are kept, the rest is counted."""
    plant, _ = controlled()
    plant.live()
    plant.back.room = 0
    result = Result(Command(LEASED, Verb.TAKE, Source(Channel.SPARKPLUG), 0, 1), Status.DONE)
    for number in range(50):
        plant.node.note_result(result, 1000.0 + number)
    assert plant.stats.untold == 18
    assert not plant.node.note_event(LEASED, "armed", "", 1050.0), "whoever tells of it keeps it, or counts it"
