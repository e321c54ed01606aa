"""What a metric is: its name, alias, type and properties, and how a value of it goes into a message. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from gateway.image import Quality
from gateway.sparkplug.payload import DataType, Metric, Property, QualityCode, Value

QUALITY = "Quality"  # the one key that the specification defines (6.4.12)
UNIT, DOCUMENTATION, READ_ONLY = "engUnit", "documentation", "readOnly"  # as Ignition's MQTT Engine reads them
CODES = {
    Quality.GOOD: QualityCode.GOOD,
    Quality.STALE: QualityCode.STALE,
    Quality.OFFLINE: QualityCode.STALE,
    Quality.NEVER_READ: QualityCode.BAD,
}
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


def in_order(metrics: Iterable[Metric]) -> tuple[Metric, ...]:
    """Return metrics in the order of time, as messages must have them."""
    return tuple(sorted(metrics, key=lambda metric: metric.timestamp or 0))
