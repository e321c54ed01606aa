"""What hosts have missed: told behind all births, as historical metrics, and never as the present."""

from __future__ import annotations

import contextlib
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from gateway.backlog import BacklogStats, HistoricalReading, Kept, Kind
from gateway.image import Image, LinkState, Quality
from gateway.metrics import MqttStats
from gateway.sparkplug.definition import CODES, OF_QUALITY
from gateway.sparkplug.device import Device
from gateway.sparkplug.drive_metrics import EVENT
from gateway.sparkplug.history import unpack
from gateway.sparkplug.node import Node
from gateway.sparkplug.payload import Metric
from gateway.store.backlog import FiledBacklog
from gateway.store.backlog_schema import Limits
from tests.mosquitto import Mosquitto
from tests.mqtt import drives
from tests.mqtt.doors import LEASED, KeptDoor, small_site
from tests.mqtt.rig import Cable
from tests.sparkplug.edge_rig import Host, Running
from tests.sparkplug.foreign import Decoder
from tests.sparkplug.rig import section
from tests.store.backlogs import QUICK

LIMITS = Limits(4 * 1024**2, 1e9)
FIRST = 3000


class Keeping(Running):
    """An edge node with a backlog."""

    def __init__(self, port: int, folder: Path, **settings: Any) -> None:
        self.backlog = FiledBacklog(folder / "backlog.sqlite", LIMITS, BacklogStats(), QUICK)
        self.backlog.start()
        super().__init__(port, drives.image(*map(_drive, ("pump-1", "fan-1"))), None, **settings)

    def made_backlog(self) -> FiledBacklog:
        """Return the backlog."""
        return self.backlog


def _drive(name: str) -> Any:
    return drives.drive(name, max_age=drives.LONG)


@contextlib.asynccontextmanager
async def keeping(port: int, folder: Path, **settings: Any) -> AsyncIterator[Keeping]:
    """Run an edge node with a backlog to the broker on a port."""
    made = Keeping(port, folder, **settings)
    try:
        yield made
    finally:
        await made.stop()
        await made.backlog.close()


def historical(host: Host, drive: str) -> list[Metric]:
    """Return the historical metrics of a drive, in the order of arrival."""
    data = [sent for sent in host.sent if (sent.kind, sent.device) == ("DDATA", drive)]
    return [metric for sent in data for metric in sent.payload.metrics if metric.is_historical]


@pytest.mark.e2e
async def test_what_hosts_missed_comes_behind_the_births(tmp_path: Path) -> None:
    """In order, with its own times, historical; seq goes on; a drive that is away waits until it is born."""
    with Mosquitto() as broker:
        async with Cable(broker.port) as cable, keeping(cable.port, tmp_path) as edge:
            fan = edge.image.drives[1]
            await edge.until(lambda: edge.edge.node.is_live)
            await edge.until(lambda: not edge.edge._missed or not edge.edge._missed.is_unsure)
            cable.cut()
            await edge.until(lambda: not edge.stats.is_connected)
            for word in range(FIRST, FIRST + 20):
                edge.read(output_frequency=word)
                drives.read(fan, edge.clock.now(), output_frequency=word)
            fan.set_link(LinkState.OFFLINE, "unplugged")
            await edge.until(lambda: edge.backlog.stats.stored >= 41)
            async with Host(broker.port) as host:
                await cable.plug()
                await host.until(lambda: len(historical(host, "pump-1")) == 20)
                assert not historical(host, "fan-1")
                fan.set_link(LinkState.ONLINE)
                await host.until(lambda: len(historical(host, "fan-1")) >= 21)
                await edge.until(lambda: edge.backlog.stats.waiting == 0)
    born = [metric for sent in host.sent if "BIRTH" in sent.kind for metric in sent.payload.metrics]
    births = {metric.alias: metric.name for metric in born}
    pump, of_fan = historical(host, "pump-1"), historical(host, "fan-1")
    assert [metric.value for metric in pump] == [word / 100 for word in range(FIRST, FIRST + 20)]
    assert [metric.value for metric in of_fan][:20] == [word / 100 for word in range(FIRST, FIRST + 20)]
    assert [(metric.value, births[metric.alias]) for metric in of_fan][20:21] == [(None, "output_frequency")]
    assert {births[metric.alias] for metric in pump} == {"output_frequency"}
    times = [metric.timestamp for metric in pump]
    assert times == sorted(times, key=lambda ms: ms or 0)
    assert host.kinds.index("DBIRTH pump-1") < host.kinds.index("DDATA pump-1")
    seqs = [sent.payload.seq for sent in host.sent]
    assert seqs == [number % 256 for number in range(len(seqs))]
    assert _historical_to_others(host) == len(pump) + len(of_fan)


def _historical_to_others(host: Host) -> int:
    """Return how many metrics foreign decoders take for historical: as many each, and none of them live."""
    with Decoder("pysparkplug") as google, Decoder("sparkplug-payload") as node:
        counts = [0, 0]
        for sent in host.sent:
            ours = [bool(metric.is_historical) for metric in sent.payload.metrics]
            raw = google.decode(sent.kind, sent.raw, sent.device)["raw"].get("metrics", [])
            others = node.decode(sent.kind, sent.raw, sent.device).get("metrics", [])
            theirs = ([m.get("is_historical", False) for m in raw], [m.get("isHistorical", False) for m in others])
            assert theirs == (ours, ours)
            counts = [count + sum(each) for count, each in zip(counts, theirs, strict=True)]
    assert counts[0] == counts[1]
    return counts[0]


class Watched(Keeping):
    """An edge node with a backlog, and drives that can be commanded."""

    def __init__(self, port: int, folder: Path) -> None:
        self.backlog = FiledBacklog(folder / "backlog.sqlite", LIMITS, BacklogStats(), QUICK)
        self.backlog.start()
        image = Image(small_site().drives)
        for each in image.drives:
            each.set_link(LinkState.ONLINE)
        Running.__init__(self, port, image, KeptDoor.small)


def events(host: Host) -> list[tuple[str, bool | None]]:
    """Return the reasons of all events of the leased drive, and whether they came as history."""
    births = [sent for sent in host.sent if (sent.kind, sent.device) == ("DBIRTH", LEASED)]
    aliases = [metric.alias for sent in births for metric in sent.payload.metrics if metric.name == EVENT]
    data = [sent for sent in host.sent if (sent.kind, sent.device) == ("DDATA", LEASED)]
    found = [metric for sent in data for metric in sent.payload.metrics if metric.alias in aliases]
    return [(json.loads(str(metric.value))["reason"], metric.is_historical) for metric in found]


@pytest.mark.e2e
async def test_what_happens_to_a_drive_is_kept_until_hosts_have_it(tmp_path: Path) -> None:
    """Live once; what is swallowed with the connection, and what happens without one, comes as history."""
    with Mosquitto() as broker:
        async with Cable(broker.port) as cable, Host(broker.port) as host:
            edge = Watched(cable.port, tmp_path)
            await edge.until(lambda: edge.edge.node.is_live)
            edge.door._tell(LEASED, "armed", "live")
            await host.until(lambda: events(host) == [("live", False)])
            await edge.until(lambda: edge.edge._missed is not None and not edge.edge._missed.is_unsure)
            cable.cut()
            edge.door._tell(LEASED, "disarmed", "swallowed")
            await edge.until(lambda: not edge.stats.is_connected)
            edge.door._tell(LEASED, "armed", "alone")
            await cable.plug()
            await host.until(lambda: len(events(host)) >= 3)
            await edge.until(lambda: edge.backlog.stats.waiting == 0)
            await edge.stop()
            await edge.backlog.close()
            assert events(host) == [("live", False), ("swallowed", True), ("alone", True)]


BODY = (
    '{"v":{"output_frequency":"50.00","torque":null,"status":"1","gone":"7"},'
    '"q":{"torque":"stale"},"t":{"status":"running"}}'
)


def devices() -> dict[str, Device]:
    """Return one drive as hosts know it."""
    image = drives.image()
    return Node(section(), "hall-3", image, MqttStats()).devices


def told(kind: Kind, body: str, drive: str = "pump-1") -> list[list[tuple[object, ...]]]:
    """Return what is told of a reading, message by message."""
    known = devices()
    names = {definition.alias: name for name, definition in known["pump-1"].metrics.values.items()}
    names |= {definition.alias: f"{name}_text" for name, definition in known["pump-1"].metrics.texts.items()}
    parcels = unpack(known, Kept(17, HistoricalReading(drive, kind, 1234, body)))
    assert [parcel.number for parcel in parcels] == [0] * (len(parcels) - 1) + [17] * bool(parcels)
    assert all(parcel.values == len(parcel.what.metrics) for parcel in parcels)
    metrics = [metric for parcel in parcels for metric in parcel.what.metrics]
    assert all(metric.is_historical and metric.timestamp == 1234 for metric in metrics)
    return [[(names[m.alias or 0], m.value, m.properties) for m in parcel.what.metrics] for parcel in parcels]


def test_a_reading_is_told_by_metrics_that_hosts_know() -> None:
    """With type, words and quality; a value that no host knows is left out."""
    stale = (OF_QUALITY[CODES[Quality.STALE]],)
    assert told(Kind.VALUES, BODY) == [
        [("output_frequency", 50.0, ()), ("torque", None, stale), ("status", 1, ()), ("status_text", "running", ())]
    ]


@pytest.mark.parametrize(
    ("kind", "body", "drive"),
    [
        (Kind.VALUES, '{"v":{"gone":"7"}}', "pump-1"),
        (Kind.VALUES, BODY, "no-such-drive"),
        (Kind.VALUES, "[]", "pump-1"),
        (Kind.VALUES, '{"v":{"status":"x"}}', "pump-1"),
        (Kind.VALUES, '{"v":{"torque":null},"q":{"torque":"odd"}}', "pump-1"),
        (Kind.EVENT, "{}", "pump-1"),
    ],
)
def test_what_no_host_could_understand_is_not_told(kind: Kind, body: str, drive: str) -> None:
    """It is dropped: a drive or value that is no longer configured, events of a drive that nobody commands."""
    assert told(kind, body, drive) == []
