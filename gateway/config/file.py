"""The whole file: its model, how it is read, and which of its drives are right in themselves."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from gateway.config.broker_tables import shared
from gateway.config.brokers import MqttSection, SparkplugSection
from gateway.config.daemon import GatewaySection, StoreSection, TraceSection, WebSection
from gateway.config.drives import DriveSection
from gateway.config.lines import LineSection
from gateway.config.modbus_tcp import ModbusTcpSection
from gateway.config.section import Section
from gateway.errors import BadConfig

ONE, SEVERAL = "one", "several"  # forms of the key mqtt; they never stand in a file


def _form(value: object) -> str:
    return SEVERAL if isinstance(value, list) else ONE


class Config(Section):
    """The whole file."""

    gateway: GatewaySection
    mqtt: (
        Annotated[
            Annotated[MqttSection, Tag(ONE)]
            | Annotated[list[MqttSection], Field(min_length=1), Tag(SEVERAL)],
            Discriminator(_form),
        ]
        | None
    ) = Field(None, description="a broker, or a list of brokers with a name each")
    sparkplug: SparkplugSection | None = None
    modbus_tcp: ModbusTcpSection | None = None
    web: WebSection | None = None
    store: StoreSection = StoreSection()
    trace: TraceSection = TraceSection()
    line: list[LineSection] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _share(cls, table: Any) -> Any:
        return shared(table) if isinstance(table, dict) else table

    @property
    def brokers(self) -> tuple[MqttSection, ...]:
        """Return every broker, in the order of the file."""
        if isinstance(self.mqtt, list):
            return tuple(self.mqtt)
        return () if self.mqtt is None else (self.mqtt,)


def read(path: Path) -> dict[str, Any]:
    """Read the TOML of a configuration file; BadConfig says what and where."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise BadConfig(f"{path}: cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise BadConfig(f"{path}: not TOML: {error}") from error


def valid_parts(table: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any], DriveSection]]:
    """Yield key, line table and drive for each drive whose own form is right, whatever else is wrong."""
    lines = table.get("line")
    for i, line in enumerate(lines if isinstance(lines, list) else []):
        drives = line.get("drive") if isinstance(line, dict) else None
        for j, drive in enumerate(drives if isinstance(drives, list) else []):
            try:
                yield f"line[{i}].drive[{j}]", line, DriveSection.model_validate(drive)
            except ValidationError:
                continue  # its own problems are listed already
