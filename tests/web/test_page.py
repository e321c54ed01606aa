"""The verdict on health: every quality, every link state, and the reasons in words."""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path

import pytest

from gateway import site
from gateway.image import LinkState, Quality
from gateway.metrics import MqttStats
from gateway.web import page
from tests.web.rig import NOW, WALL, Rig, drive, table


@pytest.fixture
def rig() -> Rig:
    """Every line up, every drive just heard."""
    made = Rig()
    made.open()
    made.answer()
    return made


def judged(rig: Rig) -> page.Health:
    """Return the verdict now."""
    return page.judge(rig.built, rig.image, rig.stats, rig.clock.now())


def of_drive(rig: Rig, name: str) -> page.DriveHealth:
    """Return the verdict on one drive."""
    return next(drive for drive in judged(rig).drives if drive.name == name)


def test_fresh_data_on_open_lines_are_well(rig: Rig) -> None:
    """No reason against it."""
    health = judged(rig)
    assert health.is_well
    assert health.reasons == ()
    assert [d.quality for d in health.drives] == [Quality.GOOD] * 3


def test_before_the_first_answer_the_gateway_is_not_well() -> None:
    """Nothing opened, nothing read: every line and drive says so."""
    health = judged(Rig())
    assert health.reasons == (
        "line a: not opened yet",
        "line b: not opened yet",
        "drive pump-1: starting: not heard yet",
        "drive pump-2: starting: not heard yet",
        "drive fan: starting: not heard yet",
    )
    assert {(d.quality, d.age) for d in health.drives} == {(Quality.NEVER_READ, None)}


@pytest.mark.hazard("H19")
def test_a_stale_value_is_named_with_its_age(rig: Rig) -> None:
    """The drive is online, but its values are older than they may be."""
    rig.clock.moment += 3.25
    rig.answer("pump-1", "fan")
    health = judged(rig)
    assert health.reasons == (
        "drive pump-2: 3 of 3 values stale:"
        " status (3.2 s old), output_frequency (3.2 s old), alarm (3.2 s old)",
    )
    stale = of_drive(rig, "pump-2")
    assert (stale.link, stale.quality, stale.age) == (LinkState.ONLINE, Quality.STALE, 3.25)


@pytest.mark.hazard("H19")
def test_a_value_that_never_came_keeps_the_drive_from_being_well() -> None:
    """One register that the drive refuses is named; the others are good."""
    rig = Rig()
    rig.open()
    rig.answer("pump-2", "fan")
    image = rig.image.by_name["pump-1"]
    image.set_link(LinkState.ONLINE)
    words = [(point.register.address, 1) for name, point in image.points.items() if name != "alarm"]
    image.apply(words, NOW, WALL)
    assert judged(rig).reasons == ("drive pump-1: 1 of 3 values never_read: alarm",)
    assert of_drive(rig, "pump-1").quality is Quality.NEVER_READ


def test_a_derived_value_without_its_base_is_named() -> None:
    """Amperes need the drive's rated current: until it has been read, the value does not exist."""
    poll = [{"values": ["output_current"], "every": "1s"}]
    lines = [{"name": "a", "port": "/dev/ttyA", "drive": [drive("d", 1, poll=poll)]}]
    rig = Rig(site.build(table(line=lines), "test", Path()))
    rig.open()
    rig.answer()
    (derived,) = rig.built.drives[0].derived
    assert judged(rig).reasons == (f"drive d: 1 of 2 values never_read: {derived.name}",)
    rig.image.by_name["d"].bases[derived.base] = Decimal("7.7")
    assert judged(rig).is_well


def test_stale_and_never_read_values_are_told_apart() -> None:
    """Each quality gets its own reason; the worst one is the drive's."""
    rig = Rig()
    rig.open()
    image = rig.image.by_name["pump-1"]
    image.set_link(LinkState.ONLINE)
    image.apply([(image.points["status"].register.address, 1)], NOW, WALL)
    rig.clock.moment += 2
    assert of_drive(rig, "pump-1").reasons == (
        "1 of 3 values stale: status (2.0 s old)",
        "2 of 3 values never_read: output_frequency, alarm",
    )
    assert of_drive(rig, "pump-1").quality is Quality.NEVER_READ


@pytest.mark.parametrize("link", [state for state in LinkState if not state.is_connected])
@pytest.mark.hazard("H19")
def test_a_lost_link_is_one_reason_in_words(rig: Rig, link: LinkState) -> None:
    """Why the link is lost explains every value at once; its old values are offline."""
    rig.image.by_name["fan"].set_link(link, "because")
    assert judged(rig).reasons == (f"drive fan: {link.word}: because",)
    assert of_drive(rig, "fan").quality is Quality.OFFLINE
    rig.image.by_name["fan"].set_link(link, "")
    assert judged(rig).reasons == (f"drive fan: {link.word}",)


def test_a_suspect_link_with_fresh_values_is_well(rig: Rig) -> None:
    """One missing answer makes no value old."""
    rig.image.by_name["fan"].set_link(LinkState.SUSPECT, "1 request without an answer")
    assert judged(rig).is_well


def test_a_line_that_went_down_is_not_well_even_while_values_are_fresh(rig: Rig) -> None:
    """The verdict does not wait for the values to age."""
    rig.stats.lines["b"].is_up = False
    assert judged(rig).reasons == ("line b: down",)


def test_a_line_that_nobody_counts_for_is_not_well(rig: Rig) -> None:
    """A configured line without a worker is down, not unknown."""
    del rig.stats.lines["b"]
    assert judged(rig).reasons == ("line b: not opened yet",)


def test_many_bad_values_are_counted_not_listed() -> None:
    """The reason stays readable."""
    values = ["status", "output_frequency", "alarm", "trip_code", "pid_feedback", "trip_status", "terminal_output"]
    poll = [{"values": values, "every": "1s"}]
    lines = [{"name": "a", "port": "/dev/ttyA", "drive": [drive("d", 1, poll=poll)]}]
    rig = Rig(site.build(table(line=lines), "test", Path()))
    rig.image.by_name["d"].set_link(LinkState.ONLINE)
    (reason,) = of_drive(rig, "d").reasons
    assert reason == (
        "7 of 7 values never_read: status, output_frequency, alarm, trip_code, pid_feedback and 2 more"
    )


def test_every_broker_with_a_name_is_in_the_document() -> None:
    """And all of them are connected only where each is."""
    brokers = [{"name": name, "url": f"mqtt://{name}"} for name in ("plant", "cloud")]
    rig = Rig(site.build(table(mqtt=brokers), "test", Path()))
    rig.stats.brokers = {"plant": MqttStats(is_connected=True), "cloud": MqttStats()}
    for cloud in (False, True):
        rig.stats.brokers["cloud"].is_connected = cloud
        told = page.as_document(judged(rig), rig.built, rig.stats, rig.clock.wall())["mqtt"]
        assert told == {"connected": cloud, "brokers": {"plant": {"connected": True}, "cloud": {"connected": cloud}}}


def test_the_document_says_it_all(rig: Rig) -> None:
    """Lines, drives, broker, times; and it is strict JSON."""
    rig.stats.lines["a"].load = 0.123456
    rig.stats.brokers[""] = MqttStats(is_connected=True)
    rig.clock.moment += 0.5
    rig.image.by_name["fan"].set_link(LinkState.OFFLINE, "no answer")
    document = page.as_document(judged(rig), rig.built, rig.stats, rig.clock.wall())
    json.dumps(document, allow_nan=False)
    assert document["status"] == "fail"
    assert document["reasons"] == ["drive fan: offline: no answer"]
    assert document["gateway"] == "hall-3"
    assert document["time"] == "2023-11-14T22:13:20.500Z"
    assert document["started"] == "2023-11-14T22:12:20.000Z"
    assert document["lines"]["a"] == {"up": True, "load": 0.1235, "reasons": []}
    assert document["drives"]["fan"] == {
        "line": "b",
        "link": "offline",
        "age": 0.5,
        "quality": "offline",
        "reasons": ["offline: no answer"],
    }
    assert document["mqtt"] == {"connected": True}
    assert document["sparkplug"] == {"connected": False}


def test_the_document_is_json_before_the_first_answer() -> None:
    """An age that does not exist is null, not infinity."""
    rig = Rig()
    document = page.as_document(judged(rig), rig.built, rig.stats, WALL)
    assert json.loads(json.dumps(document, allow_nan=False))["drives"]["fan"]["age"] is None


def test_the_broker_is_shown_only_where_one_is_configured() -> None:
    """Without a section there is nothing to say."""
    without = {key: section for key, section in table().items() if key not in ("mqtt", "sparkplug")}
    rig = Rig(site.build(without, "test", Path()))
    assert not {"mqtt", "sparkplug"} & set(page.as_document(judged(rig), rig.built, rig.stats, WALL))


def test_the_start_page_says_that_it_is_no_safety_function() -> None:
    """It links both pages and escapes the gateway's name."""
    text = page.start_page("<hall>")
    assert "not a safety function" in text
    assert 'href="/healthz"' in text
    assert 'href="/metrics"' in text
    assert "<hall>" not in text
    assert "&lt;hall&gt;" in text


@pytest.mark.hazard("H35")
def test_a_problem_of_the_store_is_shown_and_makes_no_value_old(rig: Rig) -> None:
    """The verdict is on the data; the problem stands beside it in words."""
    rig.ledger.problem = "state.sqlite: the disk is full"
    document = page.as_document(judged(rig), rig.built, rig.stats, WALL, rig.ledger)
    assert document["status"] == "ok"
    assert document["store"] == {"problem": "state.sqlite: the disk is full", "audit_dropped": 0}
    assert "store" not in page.as_document(judged(rig), rig.built, rig.stats, WALL)


def test_how_a_drive_stands_to_commands_is_shown_where_it_is_controlled(rig: Rig) -> None:
    """Only a drive that somebody may command has a standing."""
    rig.stats.drives["fan"].standing = "quiet"
    drives = page.as_document(judged(rig), rig.built, rig.stats, WALL)["drives"]
    assert drives["fan"]["control"] == "quiet"
    assert "control" not in drives["pump-1"]


def test_answer_times_are_shown_once_there_are_some(rig: Rig) -> None:
    """The same quantiles as in the metrics, in seconds."""
    for milliseconds in range(1, 101):
        rig.stats.drives["fan"].answers.observe(milliseconds / 1000)
    drives = page.as_document(judged(rig), rig.built, rig.stats, WALL)["drives"]
    assert drives["fan"]["answer"] == {"p50": 0.05, "p95": 0.095, "p99": 0.099, "longest": 0.1}
    assert "answer" not in drives["pump-1"]
