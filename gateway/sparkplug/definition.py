"""What a metric is: its name, alias, type and properties, and how a value of it goes into a message. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

from gateway.image import Quality
from gateway.sparkplug import payload, protobuf
from gateway.sparkplug.payload import DataType, Metric, Property, QualityCode, Value, Written

QUALITY = "Quality"  # the one key that the specification defines (6.4.12)
UNIT, DOCUMENTATION, READ_ONLY = "engUnit", "documentation", "readOnly"  # as Ignition's MQTT Engine reads them
CODES = {
    Quality.GOOD: QualityCode.GOOD,
    Quality.STALE: QualityCode.STALE,
    Quality.OFFLINE: QualityCode.STALE,
    Quality.NEVER_READ: QualityCode.BAD,
}
KEPT_STAMPS = 16
DOUBLE_VALUE = 13  # the number of its field
AnyMetric = TypeVar("AnyMetric", Metric, Metric | Written)
OF_QUALITY = {code: Property(QUALITY, DataType.INT32, int(code)) for code in QualityCode}


@dataclass(frozen=True, slots=True)
class Definition:
    """A metric that a birth announces; the alias is unique within the edge node."""

    name: str
    alias: int
    datatype: DataType
    properties: tuple[Property, ...] = ()

    def born(self, value: Value, timestamp: int, quality: Quality | None = None) -> Metric:
        """Return it as a birth has it, with all that it is; `quality` of a value of the drive."""
        properties = self.properties if quality is None else (*self.properties, OF_QUALITY[CODES[quality]])
        return Metric(self.name, self.alias, timestamp, self.datatype, value, properties=properties)

    def told(self, value: Value, timestamp: int, quality: Quality | None = None) -> Metric:
        """Return it as data: by its alias.

        The type is told again though it need not be (6.4.5): decoders without a memory of births are common.
        """
        properties = () if quality is None else (OF_QUALITY[CODES[quality]],)
        return Metric("", self.alias, timestamp, self.datatype, value, properties=properties)


class Teller:
    """Writes a metric as data without a word of its quality, as `Definition.told` has it: of values that are good."""

    __slots__ = ("_datatype", "_head", "_tail")

    def __init__(self, definition: Definition) -> None:
        self._datatype = definition.datatype
        self._head = protobuf.whole(2, definition.alias)
        self._tail = protobuf.whole(4, definition.datatype)

    def told(self, value: bool | int | float | str, timestamp: int) -> Written:
        """Return it in bytes."""
        field = protobuf.double(DOUBLE_VALUE, value) if type(value) is float else self._other(value)
        return Written(timestamp, self._head + _stamp(timestamp) + self._tail + field)

    def _other(self, value: bool | int | float | str) -> bytes:
        return payload.value_field(self._datatype, value)


@lru_cache(KEPT_STAMPS)
def _stamp(timestamp: int) -> bytes:
    """Return the field of a time, which the values of one answer share."""
    return protobuf.whole(3, timestamp)


@dataclass(slots=True)
class Definer:
    """Makes the definitions of one edge node, each with an alias of its own."""

    _aliases: Iterator[int]

    def define(
        self, name: str, datatype: DataType, unit: str = "", documentation: str = "", *, is_writable: bool = False
    ) -> Definition:
        """Define a metric."""
        properties = [Property(READ_ONLY, DataType.BOOLEAN, not is_writable)]
        properties += [Property(UNIT, DataType.STRING, unit)] if unit else []
        properties += [Property(DOCUMENTATION, DataType.STRING, documentation)] if documentation else []
        return Definition(name, next(self._aliases), datatype, tuple(properties))


def in_order(metrics: Iterable[AnyMetric]) -> tuple[AnyMetric, ...]:
    """Return metrics in the order of time, as messages must have them."""
    return tuple(sorted(metrics, key=lambda metric: metric.timestamp or 0))
