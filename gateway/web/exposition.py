"""Puts the counters and the state of every drive into metric families, named by Prometheus' conventions."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Generic, TypeVar

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)

from gateway import __version__
from gateway.control.ledger import Ledger
from gateway.control.state import Standing
from gateway.image import DriveImage, Image, LinkState, Quality
from gateway.metrics import LATEST, DriveStats, Histogram, LineStats, MqttStats, Stats, TcpStats
from gateway.site import Site
from gateway.web import backlogs, certificates
from gateway.web.page import age

Labels = tuple[str, ...]
S = TypeVar("S")

LINE = ("line",)
DRIVE = ("line", "drive")
BROKER = ("broker",)
NEVER = float("inf")  # the age of what was never heard: an alert on "older than" must fire


@dataclass(frozen=True, slots=True)
class Number(Generic[S]):
    """A plain metric: its name, its help, and how it is read from what it counts of. Counters end in _total."""

    name: str
    text: str
    read: Callable[[S], float]

    def family(self, labels: Labels, each: Iterable[tuple[Labels, S]]) -> Metric:
        """Return the metric for each label set."""
        kind = CounterMetricFamily if self.name.endswith("_total") else GaugeMetricFamily
        family = kind(self.name, self.text, labels=labels)
        for of, stats in each:
            family.add_metric(of, self.read(stats))
        return family


OF_LINES: tuple[Number[LineStats], ...] = (
    Number("tosvert_line_up", "Whether the port is open.", lambda line: line.is_up),
    Number("tosvert_line_opened_total", "Times that the port was opened.", lambda line: line.opened),
    Number("tosvert_line_exchanges_total", "Requests sent to drives.", lambda line: line.exchanges),
    Number(
        "tosvert_line_busy_seconds_total",
        "Seconds in which the wire and the drives were necessarily busy.",
        lambda line: line.busy,
    ),
    Number(
        "tosvert_line_load_ratio",
        "Share of the last second in which the line was necessarily busy.",
        lambda line: line.load,
    ),
)

OF_DRIVES: tuple[Number[DriveStats], ...] = (
    Number("tosvert_drive_exchanges_total", "Requests sent to the drive.", lambda drive: drive.exchanges),
    Number("tosvert_drive_timeouts_total", "Requests without an answer.", lambda drive: drive.timeouts),
    Number("tosvert_drive_bad_replies_total", "Answers that fit no request.", lambda drive: drive.bad_replies),
    Number("tosvert_drive_refusals_total", "Requests that the drive refused.", lambda drive: drive.refusals),
    Number(
        "tosvert_drive_answer_longest_seconds",
        "Longest time from the end of a request to the end of its answer.",
        lambda drive: drive.answers.longest,
    ),
    Number(
        "tosvert_drive_longest_gap_seconds",
        "Longest time between two answers; the drive's F803 must be longer.",
        lambda drive: drive.longest_gap,
    ),
    Number(
        "tosvert_drive_communication_timeout_seconds",
        "The drive's own communication time-out F803; 0 while it is off or not known.",
        lambda drive: drive.communication_timeout,
    ),
)

OF_MQTT: tuple[Number[MqttStats], ...] = (
    Number("tosvert_mqtt_connected", "Whether the broker is connected.", lambda mqtt: mqtt.is_connected),
    Number("tosvert_mqtt_connects_total", "Connections made to the broker.", lambda mqtt: mqtt.connects),
    Number("tosvert_mqtt_published_total", "Messages handed to the broker.", lambda mqtt: mqtt.published),
    Number("tosvert_mqtt_dropped_total", "Messages dropped because the queue was full.", lambda mqtt: mqtt.dropped),
    Number("tosvert_mqtt_inbox_dropped_total", "Commands that found no room.", lambda mqtt: mqtt.inbox_dropped),
    Number("tosvert_mqtt_waiting_messages", "Messages that wait for the broker.", lambda mqtt: mqtt.waiting),
)

OF_SPARKPLUG: tuple[Number[MqttStats], ...] = (
    Number("tosvert_sparkplug_connected", "Whether Sparkplug's broker is connected.", lambda spb: spb.is_connected),
    Number("tosvert_sparkplug_connects_total", "Connections made to that broker.", lambda spb: spb.connects),
    Number("tosvert_sparkplug_published_total", "Births, data and deaths handed to it.", lambda spb: spb.published),
    Number("tosvert_sparkplug_dropped_total", "Messages that were too large for it.", lambda spb: spb.dropped),
    Number("tosvert_sparkplug_inbox_dropped_total", "Commands that found no room.", lambda spb: spb.inbox_dropped),
    Number("tosvert_sparkplug_waiting_messages", "Messages that wait for it.", lambda spb: spb.waiting),
)

OF_MODBUS_TCP: tuple[Number[TcpStats], ...] = (
    Number("tosvert_modbus_tcp_connections", "Clients that are connected.", lambda tcp: tcp.connections),
    Number("tosvert_modbus_tcp_accepted_total", "Connections that were accepted.", lambda tcp: tcp.accepted),
    Number("tosvert_modbus_tcp_turned_away_total", "Connections beyond the limit.", lambda tcp: tcp.turned_away),
    Number("tosvert_modbus_tcp_not_allowed_total", "Connections that are not allowed.", lambda tcp: tcp.not_allowed),
    Number("tosvert_modbus_tcp_denied_total", "Requests that rights refused.", lambda tcp: tcp.denied),
)


OF_STORES: tuple[Number[Ledger], ...] = (
    Number(
        "tosvert_store_problem",
        "Whether writes to the EEPROM are refused since they cannot be counted.",
        lambda ledger: bool(ledger.problem),
    ),
    Number(
        "tosvert_store_audit_dropped_total",
        "Rows of the audit that were dropped since the store did not take them.",
        lambda ledger: ledger.dropped,
    ),
)


def families(site: Site, image: Image, stats: Stats, now: float, ledger: Ledger | None = None) -> Iterator[Metric]:
    """Yield every metric family as it stands at `now` (monotonic seconds); documented in docs/monitoring.md."""
    build = {"version": __version__, "python": platform.python_version(), "gateway": site.config.gateway.name}
    yield InfoMetricFamily("tosvert_build", "Version of the gateway and of Python, and its name.", value=build)
    yield from _of_lines(site, stats)
    yield from _of_drives(site, stats)
    yield from _of_control(site, stats)
    yield from _of_values([((i.drive.line, i.drive.name), i) for i in image.drives], now)
    if ledger is not None:
        yield from _of_store(site, ledger, now)
    if names := [broker.origin for broker in site.config.brokers]:
        each = [((name,) if name else (), stats.brokers.get(name) or MqttStats()) for name in names]
        labels = BROKER if any(names) else ()
        for number in OF_MQTT:
            yield number.family(labels, each)
        yield from backlogs.families("tosvert_mqtt", labels, [(of, mqtt.missed) for of, mqtt in each])
        held = [(of, mqtt.certificates) for of, mqtt in each]
        yield certificates.family("tosvert_mqtt", "the connection to a broker", labels, held)
    if site.config.sparkplug is not None:
        for number in OF_SPARKPLUG:
            yield number.family((), [((), stats.sparkplug)])
        yield from backlogs.families("tosvert_sparkplug", (), [((), stats.sparkplug.missed)])
        held = [((), stats.sparkplug.certificates)]
        yield certificates.family("tosvert_sparkplug", "the connection to Sparkplug's broker", (), held)
    if site.config.modbus_tcp is not None:
        yield from _of_modbus_tcp(stats.tcp)


def _of_lines(site: Site, stats: Stats) -> Iterator[Metric]:
    each = [((line.name,), stats.lines.get(line.name) or LineStats()) for line in site.lines]
    for number in OF_LINES:
        yield number.family(LINE, each)
    errors = CounterMetricFamily("tosvert_line_errors_total", "What went wrong, by kind.", labels=(*LINE, "kind"))
    for of, line in each:
        for kind, count in sorted(line.errors.items()):
            errors.add_metric((*of, kind), count)
    yield errors
    text = "Whether the driver hands bytes on at once; absent where no driver could hold them back."
    latencies = GaugeMetricFamily("tosvert_line_low_latency", text, labels=LINE)
    text = "Whether the adapter echoes what it sends; absent until that is known."
    echoes = GaugeMetricFamily("tosvert_line_local_echo", text, labels=LINE)
    for of, line in each:
        if line.is_low_latency is not None:
            latencies.add_metric(of, line.is_low_latency)
        if line.has_echo is not None:
            echoes.add_metric(of, line.has_echo)
    yield from (latencies, echoes)
    gaps = ((of, line.gaps) for of, line in each)
    yield _histogram("tosvert_line_gap_seconds", "Silence on the line before each request.", LINE, gaps)


def _of_drives(site: Site, stats: Stats) -> Iterator[Metric]:
    each = [((drive.line, drive.name), stats.drives.get(drive.name) or DriveStats()) for drive in site.drives]
    for number in OF_DRIVES:
        yield number.family(DRIVE, each)
    answers = ((of, drive.answers) for of, drive in each)
    text = "Time from the end of a request to the end of its answer."
    yield _histogram("tosvert_drive_answer_seconds", text, DRIVE, answers)
    text = f"The same of the latest {LATEST} answers: the time within which that share of them came."
    quantiles = GaugeMetricFamily("tosvert_drive_answer_quantile_seconds", text, labels=(*DRIVE, "quantile"))
    for of, drive in each:
        for share, seconds in drive.answers.latest().items():
            quantiles.add_metric((*of, str(share)), seconds)
    yield quantiles
    text = "Requests since the start that write the drive's EEPROM, by communication number."
    writes = CounterMetricFamily("tosvert_drive_eeprom_writes_total", text, labels=(*DRIVE, "number"))
    for of, drive in each:
        for address, count in sorted(drive.eeprom_writes.items()):
            writes.add_metric((*of, f"{address:04X}"), count)
    yield writes
    yield from _of_polls(each)


def _of_polls(each: Sequence[tuple[Labels, DriveStats]]) -> Iterator[Metric]:
    text = "Longest time from when a poll fell due to its answer; as fast as possible (0): from the answer before."
    worst = GaugeMetricFamily("tosvert_drive_poll_response_seconds", text, labels=(*DRIVE, "every"))
    text = "The same as check reckons it: while every drive answers, and while exchanges are lost now and then."
    predicted = GaugeMetricFamily("tosvert_drive_poll_predicted_seconds", text, labels=(*DRIVE, "every", "premise"))
    text = "Answers to polls that came later than was reckoned on that premise."
    late = CounterMetricFamily("tosvert_drive_poll_late_total", text, labels=(*DRIVE, "every", "premise"))
    for of, drive in each:
        for period, responses in sorted(drive.responses.items()):
            every = (*of, f"{period:g}")
            worst.add_metric(every, responses.worst)
            predicted.add_metric((*every, "undisturbed"), responses.predicted)
            predicted.add_metric((*every, "disturbed"), responses.disturbed)
            late.add_metric((*every, "undisturbed"), responses.late)
            late.add_metric((*every, "disturbed"), responses.very_late)
    yield from (worst, predicted, late)


def _of_control(site: Site, stats: Stats) -> Iterator[Metric]:
    each = [((drive.line, drive.name), stats.drives.get(drive.name) or DriveStats()) for drive in site.drives]
    text = "Least time that was left of F803 between two answers; absent while F803 is off or not known."
    margins = GaugeMetricFamily("tosvert_drive_timeout_margin_seconds", text, labels=DRIVE)
    text = "1 for how the drive stands to commands, 0 otherwise; absent where nobody may command it."
    standings = GaugeMetricFamily("tosvert_drive_standing", text, labels=(*DRIVE, "standing"))
    text = "Commands by how they ended, and why they were refused or failed."
    commands = CounterMetricFamily("tosvert_drive_commands_total", text, labels=(*DRIVE, "status", "reason"))
    text = "What happened to the permission to command the drive, by event."
    events = CounterMetricFamily("tosvert_drive_control_events_total", text, labels=(*DRIVE, "event"))
    for of, drive in each:
        if isfinite(drive.least_margin):
            margins.add_metric(of, drive.least_margin)
        for standing in Standing if drive.standing else ():
            standings.add_metric((*of, standing.value), standing.value == drive.standing)
        for (status, reason), count in sorted(drive.commands.items()):
            commands.add_metric((*of, status, reason), count)
        for event, count in sorted(drive.events.items()):
            events.add_metric((*of, event), count)
    yield from (margins, standings, commands, events)


def _of_store(site: Site, ledger: Ledger, now: float) -> Iterator[Metric]:
    """Show what outlives the process; drives that are not configured any more are left out."""
    for number in OF_STORES:
        yield number.family((), [((), ledger)])
    lines = {drive.name: drive.line for drive in site.drives}
    text = "Writes to the drive's EEPROM ever counted (about 10,000 are allowed), by communication number."
    writes = CounterMetricFamily("tosvert_drive_eeprom_lifetime_writes_total", text, labels=(*DRIVE, "number"))
    text = "Time until a parameter will have been written 10,000 times, at the pace of the last day."
    left = GaugeMetricFamily("tosvert_drive_eeprom_life_left_seconds", text, labels=(*DRIVE, "number"))
    for (name, address), wear in sorted(ledger.wear.items()):
        if name in lines:
            of = (lines[name], name, f"{address:04X}")
            writes.add_metric(of, wear.writes)
            left.add_metric(of, wear.seconds_left(now))
    yield from (writes, left)


def _of_values(each: list[tuple[Labels, DriveImage]], now: float) -> Iterator[Metric]:
    up = GaugeMetricFamily("tosvert_drive_up", "Whether the drive answers, so that its values count.", labels=DRIVE)
    text = "1 for the state that the link is in, 0 for the others."
    links = GaugeMetricFamily("tosvert_drive_link_state", text, labels=(*DRIVE, "state"))
    text = "Whether the drive is tripped; absent while that is not known."
    trips = GaugeMetricFamily("tosvert_drive_tripped", text, labels=DRIVE)
    text = "Whether settings wait for a reset of the drive."
    resets = GaugeMetricFamily("tosvert_drive_reset_needed", text, labels=DRIVE)
    ages = GaugeMetricFamily("tosvert_drive_age_seconds", "Time since the last answer with values.", labels=DRIVE)
    text = "Number of values of each quality."
    values = GaugeMetricFamily("tosvert_drive_values", text, labels=(*DRIVE, "quality"))
    for of, image in each:
        up.add_metric(of, image.link.is_connected)
        for state in LinkState:
            links.add_metric((*of, state.word), image.link is state)
        if image.is_tripped is not None:
            trips.add_metric(of, image.is_tripped)
        resets.add_metric(of, image.is_reset_needed)
        seconds = age(image, now)
        ages.add_metric(of, NEVER if seconds is None else seconds)
        counts = Counter(image.quality(name, now) for name in image.names)
        for quality in Quality:
            values.add_metric((*of, quality.word), counts[quality])
    yield from (up, links, trips, resets, ages, values)


def _of_modbus_tcp(stats: TcpStats) -> Iterator[Metric]:
    for number in OF_MODBUS_TCP:
        yield number.family((), [((), stats)])
    text = "Requests by function code (hexadecimal)."
    yield _by_code("tosvert_modbus_tcp_requests_total", text, "function", stats.requests)
    text = "Exception answers by exception code (hexadecimal)."
    yield _by_code("tosvert_modbus_tcp_exceptions_total", text, "code", stats.exceptions)


    text = "TLS handshakes by how they ended: done, or what was wrong."
    handshakes = CounterMetricFamily("tosvert_modbus_tcp_handshakes_total", text, labels=("end",))
    for end, count in sorted(stats.handshakes.items()):
        handshakes.add_metric((end,), count)
    yield handshakes
    yield certificates.family("tosvert_modbus_tcp", "the MODBUS-TCP server", (), [((), stats.certificates)])


def _by_code(name: str, text: str, label: str, counts: Counter[int]) -> Metric:
    family = CounterMetricFamily(name, text, labels=(label,))
    for code, count in sorted(counts.items()):
        family.add_metric((f"{code:02X}",), count)
    return family


def _histogram(name: str, text: str, labels: Labels, each: Iterable[tuple[Labels, Histogram]]) -> Metric:
    family = HistogramMetricFamily(name, text, labels=labels)
    for of, histogram in each:
        bounds = [*(str(float(bound)) for bound in histogram.bounds), "+Inf"]
        family.add_metric(of, list(zip(bounds, histogram.cumulated(), strict=True)), histogram.total)
    return family
