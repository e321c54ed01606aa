"""Says how hosts are told what they have missed of a drive: as data whose metrics are historical (6.4.5). Pure."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from gateway.backlog import HistoricalReading, Kept, Kind
from gateway.image import Quality
from gateway.mqtt.forwarding import Parcel
from gateway.sparkplug.device import MOST_VALUES, Device
from gateway.sparkplug.drive_metrics import EVENT
from gateway.sparkplug.payload import DataType, Metric, Value

QUALITIES = {quality.word: quality for quality in Quality}


@dataclass(frozen=True, slots=True)
class Missed:
    """Metrics of one drive for one message."""

    drive: str
    metrics: tuple[Metric, ...]


def unpack(devices: Mapping[str, Device], kept: Kept) -> list[Parcel[Missed]]:
    """Return the messages of a reading, the last of which finishes it; none where no host knows what it speaks of."""
    reading = kept.reading
    device = devices.get(reading.drive)
    if device is None:
        return []
    try:
        metrics = list(_metrics(device, reading))
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError):
        return []
    parts = [tuple(metrics[place : place + MOST_VALUES]) for place in range(0, len(metrics), MOST_VALUES)]
    last = len(parts) - 1
    return [
        Parcel(Missed(device.name, part), len(part), kept.number if place == last else 0)
        for place, part in enumerate(parts)
    ]


def _metrics(device: Device, reading: HistoricalReading) -> Iterator[Metric]:
    known, ms = device.metrics, reading.ms
    if reading.kind is Kind.EVENT:
        if EVENT in known.told:
            yield replace(known.told[EVENT].told(reading.body, ms), is_historical=True)
        return
    body: Mapping[str, Any] = json.loads(reading.body)
    for name, number in body["v"].items():
        definition, text = known.values.get(name), known.texts.get(name)
        if definition is None:
            continue
        quality = QUALITIES[body.get("q", {}).get(name, Quality.GOOD.word)]
        shown = None if quality is Quality.GOOD else quality
        value = _value(definition.datatype, number)
        yield replace(definition.told(value, ms, shown), is_historical=True)
        if text is not None:
            words = body.get("t", {}).get(name)
            yield replace(text.told(words, ms, shown), is_historical=True)


def _value(datatype: DataType, number: str | None) -> Value:
    if number is None:
        return None
    return float(number) if datatype is DataType.DOUBLE else int(number)
