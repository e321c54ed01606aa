"""Metrics: named by Prometheus' rules, documented, and true to the counters."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest
from prometheus_client.core import Metric
from prometheus_client.exposition import generate_latest
from prometheus_client.parser import text_string_to_metric_families

from gateway import site
from gateway.backlog import BacklogStats, Loss
from gateway.control.state import Standing
from gateway.control.wear import MEMORY, Wear
from gateway.image import LinkState, Quality
from gateway.metrics import MqttStats, Responses
from gateway.web.exposition import families
from tests.web.rig import NOW, Rig, table

PAGE = Path(__file__).parents[2] / "docs" / "monitoring.md"
ROW = re.compile(r"^\| `(tosvert_\w+)` \| (\w+) \| ([\w, ]*) ?\|", re.MULTILINE)
DOCUMENTED = {
    name: (kind, set(filter(None, labels.strip().split(", "))))
    for name, kind, labels in ROW.findall(PAGE.read_text(encoding="utf-8"))
}


class Whole:
    """All families as a registry hands them out."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig

    def collect(self) -> list[Metric]:
        """Return the families now."""
        rig = self.rig
        return list(families(rig.built, rig.image, rig.stats, rig.clock.now(), rig.ledger))


def scraped(rig: Rig) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    """Return every sample of the text form, by name and labels."""
    text = generate_latest(Whole(rig)).decode()
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def value(rig: Rig, name: str, **labels: str) -> float:
    """Return one sample."""
    return scraped(rig)[name, frozenset(labels.items())]


def exposed_name(family: Metric) -> str:
    """Return the name that stands in the text form's TYPE line."""
    return family.name + {"counter": "_total", "info": "_info"}.get(family.type, "")


@pytest.fixture
def busy() -> Rig:
    """Return a gateway that has counted something everywhere."""
    rig = Rig()
    rig.open()
    rig.answer()
    line, pump = rig.stats.lines["a"], rig.stats.drives["pump-1"]
    line.exchanges, line.busy, line.load = 1000, 41.5, 0.83
    line.errors.update(no_reply=3, bad_reply=1)
    line.is_low_latency, line.has_echo = True, False
    for gap in (0.0021, 0.0024, 7.0):
        line.gaps.observe(gap)
    pump.exchanges, pump.timeouts, pump.bad_replies, pump.refusals, pump.longest_gap = 500, 3, 1, 2, 0.41
    pump.answers.observe(0.02)
    pump.eeprom_writes.update({0x0875: 2})
    pump.communication_timeout, pump.least_margin, pump.standing = 1.5, 0.9, "armed"
    pump.commands.update({("done", ""): 7, ("refused", "not_owner"): 2})
    pump.events.update(armed=3, lease_lost=1)
    pump.responses = {0.1: Responses(0.07, 0.4, worst=0.09, late=3, very_late=0), 0.0: Responses(0.05, 0.5)}
    rig.ledger.wear["pump-1", 0x0875] = Wear(9000, 0.01, NOW)
    rig.ledger.dropped = 6
    rig.image.by_name["pump-1"].set_tripped(True)
    rig.image.by_name["pump-1"].set_reset_needed(True)
    mqtt, tcp = rig.stats.brokers.setdefault("", MqttStats()), rig.stats.tcp
    mqtt.is_connected, mqtt.connects, mqtt.published, mqtt.dropped, mqtt.waiting = True, 2, 900, 4, 17
    mqtt.inbox_dropped = 5
    sparkplug = rig.stats.sparkplug
    sparkplug.is_connected, sparkplug.connects, sparkplug.published, sparkplug.dropped = True, 3, 70, 1
    sparkplug.inbox_dropped, sparkplug.waiting = 6, 8
    tcp.connections, tcp.accepted, tcp.turned_away = 5, 9, 1
    tcp.not_allowed, tcp.denied = 2, 3
    tcp.handshakes["expired"] = 4
    for certificates in (tcp.certificates, mqtt.certificates, rig.stats.sparkplug.certificates):
        certificates["ca"] = 2_000_000_000
    tcp.requests.update({3: 700, 4: 20, 43: 1})
    tcp.exceptions.update({2: 6, 11: 8})
    return rig


def test_every_metric_is_documented_as_it_is(busy: Rig) -> None:
    """The page lists exactly the metrics there are, each with its type and its labels."""
    exposed = {}
    for family in Whole(busy).collect():
        labels = {label for sample in family.samples for label in sample.labels} - {"le"}
        exposed[exposed_name(family)] = ({"info": "gauge"}.get(family.type, family.type), labels)
    assert exposed == DOCUMENTED


def test_responses_stand_beside_what_was_reckoned(busy: Rig) -> None:
    """By period; 0 is as fast as possible."""
    of = {"line": "a", "drive": "pump-1", "every": "0.1"}
    assert value(busy, "tosvert_drive_poll_response_seconds", **of) == 0.09
    assert value(busy, "tosvert_drive_poll_predicted_seconds", **of, premise="undisturbed") == 0.07
    assert value(busy, "tosvert_drive_poll_predicted_seconds", **of, premise="disturbed") == 0.4
    assert value(busy, "tosvert_drive_poll_late_total", **of, premise="undisturbed") == 3
    assert value(busy, "tosvert_drive_poll_response_seconds", **{**of, "every": "0"}) == 0


def test_names_keep_to_the_conventions(busy: Rig) -> None:
    """Counters end in _total and nothing else does; no name carries a type, a milli unit or a reserved suffix."""
    for family in Whole(busy).collect():
        name = exposed_name(family)
        assert re.fullmatch(r"tosvert_[a-z]+(_[a-z]+)*", name), name
        assert name.endswith("_total") == (family.type == "counter"), name
        assert not re.search(r"_(count|sum|bucket|gauge|counter|histogram|ms|milliseconds|percent)$", name), name
        assert family.documentation.endswith("."), name


def test_no_sample_stands_twice(busy: Rig) -> None:
    """One family per name, one sample per label set: Prometheus refuses a page that repeats one."""
    samples = [
        (sample.name, frozenset(sample.labels.items()))
        for family in Whole(busy).collect()
        for sample in family.samples
    ]
    assert len(samples) == len(set(samples))
    names = [family.name for family in Whole(busy).collect()]
    assert len(names) == len(set(names))


def test_line_counters_are_shown(busy: Rig) -> None:
    """What the line has counted is what is scraped."""
    assert value(busy, "tosvert_line_up", line="a") == 1
    assert value(busy, "tosvert_line_opened_total", line="a") == 1
    assert value(busy, "tosvert_line_exchanges_total", line="a") == 1000
    assert value(busy, "tosvert_line_exchanges_total", line="b") == 0
    assert value(busy, "tosvert_line_busy_seconds_total", line="a") == 41.5
    assert value(busy, "tosvert_line_load_ratio", line="a") == 0.83
    assert value(busy, "tosvert_line_errors_total", line="a", kind="no_reply") == 3
    assert value(busy, "tosvert_line_errors_total", line="a", kind="bad_reply") == 1


def test_a_histogram_cumulates_up_to_all(busy: Rig) -> None:
    """Each bucket holds all below it, the last one all; sum and count agree."""
    name = "tosvert_line_gap_seconds"
    assert value(busy, f"{name}_bucket", line="a", le="0.002") == 0
    assert value(busy, f"{name}_bucket", line="a", le="0.0025") == 2
    assert value(busy, f"{name}_bucket", line="a", le="5.0") == 2
    assert value(busy, f"{name}_bucket", line="a", le="+Inf") == 3
    assert value(busy, f"{name}_count", line="a") == 3
    assert value(busy, f"{name}_sum", line="a") == pytest.approx(7.0045)
    assert value(busy, "tosvert_drive_answer_seconds_count", line="a", drive="pump-1") == 1


def test_drive_counters_are_shown(busy: Rig) -> None:
    """What is counted for a drive is scraped with its line."""
    pump = {"line": "a", "drive": "pump-1"}
    assert value(busy, "tosvert_drive_exchanges_total", **pump) == 500
    assert value(busy, "tosvert_drive_timeouts_total", **pump) == 3
    assert value(busy, "tosvert_drive_bad_replies_total", **pump) == 1
    assert value(busy, "tosvert_drive_refusals_total", **pump) == 2
    assert value(busy, "tosvert_drive_longest_gap_seconds", **pump) == 0.41
    assert value(busy, "tosvert_drive_timeouts_total", line="b", drive="fan") == 0


def test_brokers_with_names_are_told_apart() -> None:
    """By a label; one that has counted nothing yet is there as well."""
    brokers = [{"name": name, "url": f"mqtt://{name}"} for name in ("plant", "cloud")]
    rig = Rig(site.build(table(mqtt=brokers), "test", Path()))
    rig.stats.brokers["cloud"] = MqttStats(is_connected=True, published=7)
    assert value(rig, "tosvert_mqtt_connected", broker="cloud") == 1
    assert value(rig, "tosvert_mqtt_published_total", broker="cloud") == 7
    assert value(rig, "tosvert_mqtt_connected", broker="plant") == 0


def test_northbound_counters_are_shown(busy: Rig) -> None:
    """MQTT and MODBUS-TCP, codes in hexadecimal as the standard writes them."""
    assert value(busy, "tosvert_mqtt_connected") == 1
    assert value(busy, "tosvert_mqtt_connects_total") == 2
    assert value(busy, "tosvert_mqtt_published_total") == 900
    assert value(busy, "tosvert_mqtt_dropped_total") == 4
    assert value(busy, "tosvert_mqtt_inbox_dropped_total") == 5
    assert value(busy, "tosvert_mqtt_waiting_messages") == 17
    assert value(busy, "tosvert_sparkplug_connected") == 1
    assert value(busy, "tosvert_sparkplug_connects_total") == 3
    assert value(busy, "tosvert_sparkplug_published_total") == 70
    assert value(busy, "tosvert_sparkplug_dropped_total") == 1
    assert value(busy, "tosvert_sparkplug_inbox_dropped_total") == 6
    assert value(busy, "tosvert_sparkplug_waiting_messages") == 8
    assert value(busy, "tosvert_modbus_tcp_connections") == 5
    assert value(busy, "tosvert_modbus_tcp_accepted_total") == 9
    assert value(busy, "tosvert_modbus_tcp_turned_away_total") == 1
    assert value(busy, "tosvert_modbus_tcp_not_allowed_total") == 2
    assert value(busy, "tosvert_modbus_tcp_denied_total") == 3
    assert value(busy, "tosvert_modbus_tcp_handshakes_total", end="expired") == 4
    assert value(busy, "tosvert_modbus_tcp_certificate_expires_seconds", certificate="ca") == 2_000_000_000
    assert value(busy, "tosvert_modbus_tcp_requests_total", function="2B") == 1
    assert value(busy, "tosvert_modbus_tcp_requests_total", function="03") == 700
    assert value(busy, "tosvert_modbus_tcp_exceptions_total", code="0B") == 8


@pytest.mark.parametrize("link", list(LinkState))
def test_the_link_is_in_exactly_one_state(busy: Rig, link: LinkState) -> None:
    """1 for the state, 0 for the others; up while the drive's values count."""
    busy.image.by_name["fan"].set_link(link, "because")
    states = {
        state: value(busy, "tosvert_drive_link_state", line="b", drive="fan", state=state.word) for state in LinkState
    }
    assert states == {state: float(state is link) for state in LinkState}
    assert value(busy, "tosvert_drive_up", line="b", drive="fan") == float(link.is_connected)


@pytest.mark.hazard("H19")
def test_values_are_counted_by_quality_and_age_grows(busy: Rig) -> None:
    """Good turns stale by the clock alone; offline and never read are told apart."""
    busy.image.by_name["fan"].set_link(LinkState.OFFLINE, "no answer")
    busy.clock.moment += 0.5
    busy.answer("pump-1")
    busy.clock.moment += 0.75

    def by_quality(line: str, drive: str) -> dict[Quality, float]:
        return {q: value(busy, "tosvert_drive_values", line=line, drive=drive, quality=q.word) for q in Quality}

    assert by_quality("a", "pump-1") == {q: 3.0 * (q is Quality.GOOD) for q in Quality}
    assert by_quality("a", "pump-2") == {q: 3.0 * (q is Quality.STALE) for q in Quality}
    assert by_quality("b", "fan") == {q: 3.0 * (q is Quality.OFFLINE) for q in Quality}
    assert value(busy, "tosvert_drive_age_seconds", line="a", drive="pump-1") == 0.75
    assert value(busy, "tosvert_drive_age_seconds", line="a", drive="pump-2") == 1.25


def test_a_drive_never_heard_is_older_than_any_alarm() -> None:
    """+Inf is above every threshold; a missing sample would be above none."""
    rig = Rig()
    assert value(rig, "tosvert_drive_age_seconds", line="a", drive="pump-1") == float("inf")
    assert value(rig, "tosvert_drive_values", line="a", drive="pump-1", quality="never_read") == 3


def test_what_is_not_configured_is_not_exposed() -> None:
    """Without the sections there are no zeros that look like a broker that is away."""
    without = {key: section for key, section in table().items() if key not in ("mqtt", "sparkplug", "modbus_tcp")}
    names = {name for name, _ in scraped(Rig(site.build(without, "test", Path())))}
    assert not [name for name in names if "mqtt" in name or "sparkplug" in name or "modbus" in name]
    assert "tosvert_line_up" in names


def test_the_build_is_named(busy: Rig) -> None:
    """Gateway, version and Python, always 1."""
    ((labels, one),) = [(of, number) for (name, of), number in scraped(busy).items() if name == "tosvert_build_info"]
    assert dict(labels).keys() == {"gateway", "version", "python"}
    assert (dict(labels)["gateway"], one) == ("hall-3", 1)


def test_trip_reset_and_eeprom_writes_are_told(busy: Rig) -> None:
    """A trip that is not known is absent, not 0."""
    here = {"line": "a", "drive": "pump-1"}
    assert value(busy, "tosvert_drive_tripped", **here) == 1
    assert value(busy, "tosvert_drive_reset_needed", **here) == 1
    assert value(busy, "tosvert_drive_eeprom_writes_total", **here, number="0875") == 2
    busy.image.by_name["pump-1"].set_tripped(None)
    assert ("tosvert_drive_tripped", frozenset(here.items())) not in scraped(busy)


def test_control_is_told_by_result_and_by_event(busy: Rig) -> None:
    """Commands by how they ended and why; what happened to the permission by its name."""
    here = {"line": "a", "drive": "pump-1"}
    assert value(busy, "tosvert_drive_commands_total", **here, status="done", reason="") == 7
    assert value(busy, "tosvert_drive_commands_total", **here, status="refused", reason="not_owner") == 2
    assert value(busy, "tosvert_drive_control_events_total", **here, event="armed") == 3
    assert value(busy, "tosvert_drive_control_events_total", **here, event="lease_lost") == 1


@pytest.mark.parametrize("standing", list(Standing))
def test_a_drive_stands_in_exactly_one_way_to_commands(busy: Rig, standing: Standing) -> None:
    """1 for how it stands, 0 for the others; nothing of a drive that nobody may command."""
    busy.stats.drives["pump-1"].standing = standing.value
    name = "tosvert_drive_standing"
    found = {of: value(busy, name, line="a", drive="pump-1", standing=of.value) for of in Standing}
    assert found == {of: float(of is standing) for of in Standing}
    assert {dict(labels)["drive"] for metric, labels in scraped(busy) if metric == name} == {"pump-1"}


@pytest.mark.hazard("H06")
def test_the_margin_to_the_communication_timeout_is_told(busy: Rig) -> None:
    """How close it came, where there is a time-out; a drive without one has 0 and no margin."""
    assert value(busy, "tosvert_drive_communication_timeout_seconds", line="a", drive="pump-1") == 1.5
    assert value(busy, "tosvert_drive_timeout_margin_seconds", line="a", drive="pump-1") == 0.9
    fan = {"line": "b", "drive": "fan"}
    assert value(busy, "tosvert_drive_communication_timeout_seconds", **fan) == 0
    assert ("tosvert_drive_timeout_margin_seconds", frozenset(fan.items())) not in scraped(busy)


@pytest.mark.hazard("H08")
def test_the_wear_of_each_parameter_is_told_with_what_is_left_of_it(busy: Rig) -> None:
    """A thousand writes are left, at one in 100 s; without any writes for a day the pace is a third of that."""
    here = {"line": "a", "drive": "pump-1", "number": "0875"}
    assert value(busy, "tosvert_drive_eeprom_lifetime_writes_total", **here) == 9000
    assert value(busy, "tosvert_drive_eeprom_life_left_seconds", **here) == pytest.approx(100_000)
    busy.clock.moment += MEMORY
    assert value(busy, "tosvert_drive_eeprom_life_left_seconds", **here) == pytest.approx(271_828, rel=1e-4)


def test_a_drive_that_is_not_configured_any_more_has_no_wear_on_the_page(busy: Rig) -> None:
    """Its count is kept, but its line is not known."""
    busy.ledger.note("old-fan", 0x0010)
    drives = {dict(labels).get("drive") for name, labels in scraped(busy) if "lifetime" in name}
    assert drives == {"pump-1"}


@pytest.mark.hazard("H35")
def test_a_problem_of_the_store_is_told(busy: Rig) -> None:
    """1 while stored writes are refused; what the audit lost is counted; without a store there is neither."""
    assert value(busy, "tosvert_store_problem") == 0
    busy.ledger.problem = "disk full"
    assert value(busy, "tosvert_store_problem") == 1
    assert value(busy, "tosvert_store_audit_dropped_total") == 6
    without = families(busy.built, busy.image, busy.stats, busy.clock.now())
    assert not [family.name for family in without if "store" in family.name or "lifetime" in family.name]


def test_answer_times_are_told_as_quantiles_too() -> None:
    """Exact ones of the latest answers, beside the histogram; none before the first answer."""
    rig = Rig()
    for milliseconds in range(1, 101):
        rig.stats.drives["fan"].answers.observe(milliseconds / 1000)
    of = {"line": "b", "drive": "fan"}
    assert value(rig, "tosvert_drive_answer_quantile_seconds", **of, quantile="0.95") == 0.095
    assert value(rig, "tosvert_drive_answer_longest_seconds", **of) == 0.1
    told = {labels for name, labels in scraped(rig) if name == "tosvert_drive_answer_quantile_seconds"}
    assert {dict(labels)["drive"] for labels in told} == {"fan"}


@pytest.mark.parametrize(("is_known", "number"), [(True, 1.0), (False, 0.0)])
def test_what_is_known_of_an_adapter_is_told(is_known: bool, number: float) -> None:
    """Nothing is said of what is not known."""
    rig = Rig()
    assert ("tosvert_line_local_echo", frozenset({("line", "b")})) not in scraped(rig)
    rig.stats.lines["a"].has_echo = rig.stats.lines["a"].is_low_latency = is_known
    for name in ("tosvert_line_local_echo", "tosvert_line_low_latency"):
        assert value(rig, name, line="a") == number
        assert (name, frozenset({("line", "b")})) not in scraped(rig)


def test_what_a_broker_missed_is_counted(busy: Rig) -> None:
    """What was kept, sent, waits, and was dropped by reason."""
    busy.stats.brokers.setdefault("", MqttStats()).missed = BacklogStats(7, 5, 2, Counter({Loss.SIZE: 3}), True)
    assert value(busy, "tosvert_mqtt_backlog_kept_total") == 7
    assert value(busy, "tosvert_mqtt_backlog_sent_total") == 5
    assert value(busy, "tosvert_mqtt_backlog_waiting") == 2
    assert value(busy, "tosvert_mqtt_backlog_dropped_total", reason="size") == 3
    assert value(busy, "tosvert_mqtt_backlog_dropped_total", reason="age") == 0
    assert value(busy, "tosvert_mqtt_backlog_problem") == 1
