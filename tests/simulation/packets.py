"""MQTT packets as values: 3.1.1 and 5, as far as QoS 1 (OASIS MQTT 3.1.1, 5.0)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

V311, V5 = 4, 5  # protocol levels

Properties = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Publish:
    """A message; also the will of a CONNECT."""

    topic: str
    payload: bytes
    qos: int = 0
    is_retained: bool = False
    is_duplicate: bool = False
    packet_id: int = 0
    properties: Properties = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Connect:
    """The first packet of a client."""

    client_id: str
    version: int = V5
    is_clean: bool = True
    keep_alive: int = 0  # seconds; 0 for none
    will: Publish | None = None
    user: str | None = None
    password: bytes | None = None
    properties: Properties = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Connack:
    """The answer to it; `code` 0 is yes."""

    is_session_present: bool = False
    code: int = 0
    properties: Properties = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Puback:
    """A message of QoS 1 has arrived."""

    packet_id: int
    code: int = 0


@dataclass(frozen=True, slots=True)
class Filter:
    """One topic filter of a SUBSCRIBE and its options."""

    topic: str
    qos: int = 0
    is_no_local: bool = False
    keeps_retain: bool = False
    retain_handling: int = 0


@dataclass(frozen=True, slots=True)
class Subscribe:
    """A wish for topics."""

    packet_id: int
    filters: tuple[Filter, ...]


@dataclass(frozen=True, slots=True)
class Suback:
    """What was granted, filter by filter."""

    packet_id: int
    codes: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Unsubscribe:
    """No more of those topics."""

    packet_id: int
    topics: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Unsuback:
    """The answer to it."""

    packet_id: int
    codes: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Pingreq:
    """A question whether anybody is there."""


@dataclass(frozen=True, slots=True)
class Pingresp:
    """The answer that somebody is."""


@dataclass(frozen=True, slots=True)
class Disconnect:
    """The last packet, of either side in MQTT 5."""

    code: int = 0
    properties: Properties = field(default_factory=dict)


Packet = (
    Connect
    | Connack
    | Publish
    | Puback
    | Subscribe
    | Suback
    | Unsubscribe
    | Unsuback
    | Pingreq
    | Pingresp
    | Disconnect
)
