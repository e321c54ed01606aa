"""The configuration file: `read` takes it from the disk, `problems` says all that is wrong, `Config` is its model."""

from __future__ import annotations

from gateway.config.brokers import (
    BacklogSection,
    BrokerSection,
    FilterSection,
    HomeAssistantSection,
    MqttSection,
    SparkplugSection,
    TlsSection,
)
from gateway.config.daemon import GatewaySection, LogSection, StoreSection, TraceSection, WebSection
from gateway.config.drives import (
    DriveSection,
    FallbackSection,
    FrequencySection,
    PollSection,
    RightSection,
    StoredWritesSection,
)
from gateway.config.file import Config, read, valid_parts
from gateway.config.lines import GroupSection, LineSection, server_address
from gateway.config.modbus_tcp import (
    MapSection,
    ModbusRtuSection,
    ModbusTcpSection,
    ModbusTlsSection,
    ReservedSection,
    TcpRightSection,
)
from gateway.config.notation import FUNCTIONS, OFF, Duration, ValueName, address, seconds
from gateway.config.problems import problems
from gateway.config.section import Secret, Section

__all__ = [
    "FUNCTIONS",
    "OFF",
    "BacklogSection",
    "BrokerSection",
    "Config",
    "DriveSection",
    "Duration",
    "FallbackSection",
    "FilterSection",
    "FrequencySection",
    "GatewaySection",
    "GroupSection",
    "HomeAssistantSection",
    "LineSection",
    "LogSection",
    "MapSection",
    "ModbusRtuSection",
    "ModbusTcpSection",
    "ModbusTlsSection",
    "MqttSection",
    "PollSection",
    "ReservedSection",
    "RightSection",
    "Secret",
    "Section",
    "SparkplugSection",
    "StoreSection",
    "StoredWritesSection",
    "TcpRightSection",
    "TlsSection",
    "TraceSection",
    "ValueName",
    "WebSection",
    "address",
    "problems",
    "read",
    "seconds",
    "server_address",
    "valid_parts",
]
