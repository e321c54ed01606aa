"""How single keys are written: durations, addresses, networks, numbers and names. Pure."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints, WithJsonSchema

DURATION = re.compile(r"^(\d+(?:\.\d+)?)\s*(ms|s|min|h)$")
SECONDS = {"ms": 0.001, "s": 1.0, "min": 60.0, "h": 3600.0}
OFF = "off"
FUNCTIONS = ("read", "write", 3, 4, 6, 16, 23, 43)  # what a right over MODBUS-TCP may name


def seconds(value: object) -> float:
    """Read a duration such as "100ms", "2s", "1.5min" or "1h"; ValueError says the form."""
    match = DURATION.match(value) if isinstance(value, str) else None
    if match is None:
        raise ValueError('a duration in quotes is wanted: "100ms", "2s", "5min" or "1h"')
    return float(match[1]) * SECONDS[match[2]]


def address(value: str) -> tuple[str, int]:
    """Split "host:port"; IPv6 in brackets; ValueError says the form."""
    host, colon, port = value.rpartition(":")
    if not colon or not host or not port.isdigit() or not 0 <= int(port) <= 65535:
        raise ValueError('an address and a port are wanted: "127.0.0.1:5020", "[::]:502"')
    return host.removeprefix("[").removesuffix("]"), int(port)


def _checked_address(value: str) -> str:
    address(value)
    return value


def _checked_or_off(value: str) -> str:
    return value if value == OFF else _checked_address(value)


def _network(value: str) -> str:
    try:
        network = ipaddress.ip_network(value, strict=False)
    except ValueError:
        raise ValueError('an address or a network is wanted: "10.0.0.7", "10.0.0.0/8", "fd00::/8"') from None
    if isinstance(network, ipaddress.IPv6Network) and network.network_address.ipv4_mapped and network.prefixlen >= 96:
        wanted = f"{network.network_address.ipv4_mapped}/{network.prefixlen - 96}"
        raise ValueError(f'clients by IPv4 are known by their IPv4 address: "{wanted}"')
    if str(network.network_address) != str(ipaddress.ip_address(value.partition("/")[0])):
        raise ValueError(f'bits beyond the network are set: "{network}" is meant?')
    return value


def span(value: object) -> tuple[int, int]:
    """Read a number, or [first, last]; ValueError says the form."""
    ends: list[Any] = value if isinstance(value, list) else [value, value]
    if len(ends) != 2 or any(type(end) is not int for end in ends) or ends[0] > ends[1]:
        raise ValueError("a number or [first, last] is wanted: 0xFD00, [0xFD00, 0xFD1F]")
    return ends[0], ends[1]


def _within(most: int) -> AfterValidator:
    def check(value: tuple[int, int]) -> tuple[int, int]:
        if value[0] < 0 or value[1] > most:
            raise ValueError(f"0 to {most} are possible")
        return value

    return AfterValidator(check)


def _function(value: object) -> int | str:
    if not isinstance(value, int | str) or isinstance(value, bool) or value not in FUNCTIONS:
        known = ", ".join(f'"{one}"' if isinstance(one, str) else f"{one}" for one in FUNCTIONS)
        raise ValueError(f"a function is wanted: {known}")
    return value


def _span_schema(most: int) -> WithJsonSchema:
    number = {"type": "integer", "minimum": 0, "maximum": most}
    return WithJsonSchema({"anyOf": [number, {"type": "array", "items": number, "minItems": 2, "maxItems": 2}]})


Duration = Annotated[
    float,
    BeforeValidator(seconds),
    WithJsonSchema({"type": "string", "pattern": DURATION.pattern, "examples": ["100ms", "2s"]}),
]
Listen = Annotated[str, AfterValidator(_checked_address)]
ListenOrOff = Annotated[str, AfterValidator(_checked_or_off)]
Network = Annotated[str, AfterValidator(_network)]
Units = Annotated[tuple[int, int], BeforeValidator(span), _within(0xFF), _span_schema(0xFF)]
Registers = Annotated[tuple[int, int], BeforeValidator(span), _within(0xFFFF), _span_schema(0xFFFF)]
Function = Annotated[int | str, BeforeValidator(_function), WithJsonSchema({"enum": list(FUNCTIONS)})]
TopicLevel = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
TopicPath = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*(/[A-Za-z0-9][A-Za-z0-9_.-]*)*$")
]
SparkplugId = Annotated[str, StringConstraints(pattern=r"^[^+/#\x00-\x1f\x7f]{1,128}$")]
Deadband = Annotated[float, Field(ge=0, allow_inf_nan=False)]
CommandSource = Literal["mqtt", "modbus-tcp", "sparkplug"]
CommandName = Annotated[str, StringConstraints(pattern=r"^(\*|[a-z][a-z_]*)$")]
ValueName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]*$")]
PointName = Annotated[
    str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}\.[a-z][a-z0-9_]*$")
]
ValuePattern = Annotated[str, StringConstraints(pattern=r"^[a-z0-9_*?]+$")]
NamePattern = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_.*?-]+$")]
SourceName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]
