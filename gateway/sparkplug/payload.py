"""Sparkplug B payloads: metrics to protocol buffers and back (Sparkplug 3.0, 6.4). Pure.

Only what drives and their commands need has a meaning: numbers, truth and text. Templates, data sets and files of
others are passed over as bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

from gateway.sparkplug import protobuf
from gateway.sparkplug.protobuf import FIXED32, FIXED64, LENGTH, VARINT, BadPayload

LARGEST = 16 * 1024  # bytes of a payload that is read: a command for a hundred metrics
MOST_METRICS = 256  # in a payload that is read
DIGITS = 9  # that tell one float of 32 bits from all others

Value = bool | int | float | str | bytes | None


class DataType(IntEnum):
    """The data types that are used here, by the specification's numbers (6.4.16)."""

    INT8 = 1
    INT16 = 2
    INT32 = 3
    INT64 = 4
    UINT8 = 5
    UINT16 = 6
    UINT32 = 7
    UINT64 = 8
    FLOAT = 9
    DOUBLE = 10
    BOOLEAN = 11
    STRING = 12
    DATETIME = 13
    TEXT = 14
    UUID = 15


class QualityCode(IntEnum):
    """The values of the property Quality (6.4.12)."""

    BAD = 0
    GOOD = 192
    STALE = 500


BITS: Mapping[int | None, int] = {  # of numbers with a sign, in two's complement
    DataType.INT8: 8,
    DataType.INT16: 16,
    DataType.INT32: 32,
    DataType.INT64: 64,
}
LONG = (DataType.INT64, DataType.UINT64, DataType.DATETIME)  # in long_value; other whole numbers in int_value
KEPT_PROPERTIES = 4096  # sets that are not written anew each time: they are few, and the same in every birth
METRIC_VALUE, PROPERTY_VALUE = 10, 3  # the number of int_value; long, float, double, boolean, string follow


@dataclass(frozen=True, slots=True)
class Property:
    """A property of a metric: its unit, its quality."""

    key: str
    datatype: DataType
    value: bool | int | float | str


@dataclass(frozen=True, slots=True)
class Metric:
    """A value on its way. Without a value it is null; `name` is empty where the alias says all.

    `timestamp` is in milliseconds of UTC since 1970. What is read keeps the number of its data type, known or not.
    """

    name: str = ""
    alias: int | None = None
    timestamp: int | None = None
    datatype: int | None = None
    value: Value = None
    is_historical: bool = False
    properties: tuple[Property, ...] = ()


class Written(NamedTuple):
    """A metric in bytes already, and its timestamp."""

    timestamp: int
    raw: bytes


@dataclass(frozen=True, slots=True)
class Payload:
    """One message. `timestamp` is that of sending; a death of the edge node and commands have no `seq`."""

    timestamp: int | None = None
    metrics: tuple[Metric, ...] = ()
    seq: int | None = None


# ---- out


def encode(payload: Payload) -> bytes:
    """Return the bytes of a payload."""
    return message(payload.timestamp, payload.metrics, payload.seq)


def message(timestamp: int | None, metrics: Iterable[Metric | Written], seq: int | None) -> bytes:
    """Return the bytes of a payload of which some metrics are bytes already."""
    written = [protobuf.whole(1, timestamp)] if timestamp is not None else []
    for metric in metrics:
        raw = metric.raw if isinstance(metric, Written) else encode_metric(metric)
        written.append(protobuf.block(2, raw))
    if seq is not None:
        written.append(protobuf.whole(3, seq))
    return b"".join(written)


def encode_metric(metric: Metric) -> bytes:
    """Return the bytes of a metric."""
    written = []
    if metric.name:
        written.append(protobuf.text(1, metric.name))
    if metric.alias is not None:
        written.append(protobuf.whole(2, metric.alias))
    if metric.timestamp is not None:
        written.append(protobuf.whole(3, metric.timestamp))
    if metric.datatype is not None:
        written.append(protobuf.whole(4, metric.datatype))
    if metric.is_historical:
        written.append(protobuf.whole(5, True))
    if metric.value is None:
        written.append(protobuf.whole(7, True))
    if metric.properties:
        written.append(protobuf.block(9, _properties(metric.properties)))
    if metric.value is not None:
        written.append(value_field(metric.datatype, metric.value))
    return b"".join(written)


def value_field(datatype: int | None, value: bool | int | float | str | bytes) -> bytes:
    """Return the value of a metric."""
    return _value(METRIC_VALUE, datatype, value)


@lru_cache(KEPT_PROPERTIES)
def _properties(properties: tuple[Property, ...]) -> bytes:
    """Return a set of properties: first all keys, then all values."""
    keys = [protobuf.text(1, each.key) for each in properties]
    values = [
        protobuf.block(2, protobuf.whole(1, each.datatype) + _value(PROPERTY_VALUE, each.datatype, each.value))
        for each in properties
    ]
    return b"".join(keys + values)


def _value(first: int, datatype: int | None, value: bool | int | float | str | bytes) -> bytes:
    """Return the field of a value; `first` is the number of the field for small whole numbers."""
    match value:
        case bool():
            return protobuf.whole(first + 4, value)
        case str():
            return protobuf.text(first + 5, value)
        case bytes():
            return protobuf.block(first + 6, value)
        case float() if datatype == DataType.FLOAT:
            return protobuf.single(first + 2, value)
        case float():
            return protobuf.double(first + 3, value)
    is_long = datatype in LONG
    bits = BITS.get(datatype, 64 if is_long else 32)
    return protobuf.whole(first + 1 if is_long else first, value & ((1 << bits) - 1))


# ---- in


def decode(message: bytes) -> Payload:
    """Read a payload; BadPayload says why it is none."""
    if len(message) > LARGEST:
        raise BadPayload(f"{len(message)} bytes; at most {LARGEST}")
    timestamp = seq = None
    metrics: list[Metric] = []
    for number, kind, value in protobuf.fields(message):
        if number == 1:
            timestamp = _whole(kind, value, "timestamp")
        elif number == 2:
            metrics.append(decode_metric(_bytes(kind, value, "metrics")))
        elif number == 3:
            seq = _whole(kind, value, "seq")
        if len(metrics) > MOST_METRICS:
            raise BadPayload(f"more than {MOST_METRICS} metrics")
    return Payload(timestamp, tuple(metrics), seq)


def decode_metric(message: bytes) -> Metric:
    """Read a metric without its properties; BadPayload says why it is none."""
    name, alias, timestamp, datatype = "", None, None, None
    is_historical = is_null = False
    raw: tuple[int, int, int | bytes] | None = None
    for number, kind, value in protobuf.fields(message):
        match number:
            case 1:
                name = _text(kind, value, "name")
            case 2:
                alias = _whole(kind, value, "alias")
            case 3:
                timestamp = _whole(kind, value, "timestamp")
            case 4:
                datatype = _whole(kind, value, "datatype") & 0xFFFF_FFFF
            case 5:
                is_historical = bool(_whole(kind, value, "is_historical"))
            case 7:
                is_null = bool(_whole(kind, value, "is_null"))
            case 10 | 11 | 12 | 13 | 14 | 15 | 16 | 17 | 18 | 19:
                raw = number, kind, value
    found = None if raw is None or is_null else _read(datatype, *raw)
    return Metric(name, alias, timestamp, datatype, found, is_historical)


def _read(datatype: int | None, number: int, kind: int, value: int | bytes) -> Value:
    match number:
        case 10 | 11:
            return _signed(datatype, number, _whole(kind, value, "a whole number"))
        case 12 if kind == FIXED32 and isinstance(value, bytes):
            return _shortest(struct.unpack("<f", value)[0])
        case 13 if kind == FIXED64 and isinstance(value, bytes):
            found: float = struct.unpack("<d", value)[0]
            return found
        case 14:
            return bool(_whole(kind, value, "boolean_value"))
        case 15:
            return _text(kind, value, "string_value")
    return _bytes(kind, value, "a value")


def _signed(datatype: int | None, number: int, value: int) -> int:
    """Return a whole number with its sign: two's complement in as many bits as its type has, or in 32 bits."""
    if number == 10:
        value &= 0xFFFF_FFFF
    bits = BITS.get(datatype)
    if bits is None:
        return value
    value &= (1 << bits) - 1
    return value - (1 << bits) if value >> (bits - 1) else value


def _shortest(value: float) -> float:
    """Return the number that was meant by a float of 32 bits: 30.1, not 30.100000381."""
    for digits in range(1, DIGITS):
        short = float(f"{value:.{digits}g}")
        try:
            if struct.pack("<f", short) == struct.pack("<f", value):
                return short
        except OverflowError:  # rounded up beyond the largest
            continue
    return value


def _whole(kind: int, value: int | bytes, what: str) -> int:
    if kind != VARINT or not isinstance(value, int):
        raise BadPayload(f"{what} has wire type {kind}")
    return value


def _bytes(kind: int, value: int | bytes, what: str) -> bytes:
    if kind != LENGTH or not isinstance(value, bytes):
        raise BadPayload(f"{what} has wire type {kind}")
    return value


def _text(kind: int, value: int | bytes, what: str) -> str:
    try:
        return _bytes(kind, value, what).decode()
    except UnicodeDecodeError as error:
        raise BadPayload(f"{what}: byte {error.start} is not UTF-8") from None
