"""The configuration file: its model, and how it is read with all its errors named at once."""

from __future__ import annotations

import difflib
import ipaddress
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    StringConstraints,
    Tag,
    ValidationError,
    WithJsonSchema,
    model_validator,
)

from gateway.broker_tables import shared
from gateway.errors import BadConfig
from gateway.protocol.timing import LineTiming

DURATION = re.compile(r"^(\d+(?:\.\d+)?)\s*(ms|s|min|h)$")
SERVER_SCHEMES = ("socket://", "rfc2217://")
ROUNDING = 1e-6  # what multiplying a duration may be off by
RTS_KEYS = ("rts_on_send", "rts_delay_before", "rts_delay_after")  # of a line, the delays last
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

class Section(BaseModel):
    """A table of the file: unknown keys are refused, values are not coerced."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

class Secret(Section):
    """A secret that stands elsewhere: in an environment variable or in a file."""

    env: str | None = Field(None, description="name of the environment variable that holds it")
    file: str | None = Field(None, description="path of the file that holds it (its last newline is dropped)")

    @model_validator(mode="after")
    def _one_place(self) -> Secret:
        if (self.env is None) == (self.file is None):
            raise ValueError('say where it stands: { env = "NAME" } or { file = "/path" }')
        return self

    def reveal(self, environment: Mapping[str, str] = os.environ) -> str:
        """Return the secret; BadConfig says which variable or file is missing."""
        if self.env is not None:
            if self.env not in environment:
                raise BadConfig(f"environment variable {self.env} is not set")
            return environment[self.env]
        try:
            return Path(self.file or "").read_text(encoding="utf-8").removesuffix("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise BadConfig(f"secret file {self.file}: {error}") from error

class LogSection(Section):
    """How the daemon logs."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["text", "json"] = "text"
    show: list[Literal["points", "frames", "bytes"]] = Field(
        [], description="shown in full at any level: values, frames in words, bytes on the wire"
    )

class GatewaySection(Section):
    """The gateway itself."""

    name: TopicLevel = Field(description="name of this gateway, a level of its topics")
    catalogue: list[str] = Field([], description="further catalogue files, relative to this file")
    log: LogSection = LogSection()
    loop: Literal["uvloop", "asyncio"] = "uvloop"

class TlsSection(Section):
    """TLS towards the broker; fails closed."""

    ca: str | None = Field(None, description="file of trusted certificates; the system's by default")
    certificate: str | None = Field(None, description="client certificate (PEM)")
    key: str | None = Field(None, description="its private key (PEM)")

    @model_validator(mode="after")
    def _both(self) -> TlsSection:
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key belong together: give both or neither")
        return self

BROKER_SCHEMES = ("mqtt", "mqtts", "ws", "wss")
TLS_SCHEMES = ("mqtts:", "wss:")
BROKER_FORMS = '"mqtt://host:1883", "mqtts://host:8883", or by WebSocket "ws://host:80/mqtt", "wss://host:443/mqtt"'

def _broker_url(value: str) -> str:
    try:
        url = urlsplit(value)
        port = url.port
    except ValueError as error:
        raise ValueError(f"not a URL: {error}") from error
    if url.scheme not in BROKER_SCHEMES or not url.hostname or port == 0:
        raise ValueError(f"a broker is wanted: {BROKER_FORMS}")
    if url.path not in ("", "/") and not url.scheme.startswith("ws"):
        raise ValueError('a path is for WebSockets only: "wss://host/mqtt"')
    if url.fragment:
        raise ValueError(f"nothing can stand behind a #: {BROKER_FORMS}")
    if url.username or url.password:
        raise ValueError("user and password do not belong into the URL: use the keys user and password")
    return value

BrokerUrl = Annotated[str, AfterValidator(_broker_url)]

class FilterSection(Section):
    """How often some values are published; the last filter that says something of a value is the one that holds."""

    values: list[ValuePattern] = Field(["*"], min_length=1, description="values by name; * and ? stand for any")
    drives: list[NamePattern] = Field(["*"], min_length=1, description="drives by name; * and ? stand for any")
    deadband: Deadband | None = Field(None, description="smallest change that is published, in the value's unit")
    deadband_percent: Annotated[float, Field(ge=0, le=100)] | None = Field(
        None, description="the same in % of what was published last; the larger of the two counts"
    )
    min_interval: Duration | None = Field(None, ge=0, le=86_400, description="not published more often than that")
    max_interval: Duration | None = Field(
        None, ge=0, le=86_400, description="published again after that though it has not changed; 0s: every reading"
    )

    @model_validator(mode="after")
    def _says_something(self) -> FilterSection:
        if self.model_fields_set <= {"values", "drives"}:
            raise ValueError("it says nothing: give deadband, deadband_percent, min_interval or max_interval")
        if self.min_interval and self.max_interval and self.min_interval > self.max_interval:
            raise ValueError(f"min_interval {self.min_interval:g} s is above max_interval {self.max_interval:g} s")
        return self

class HomeAssistantSection(Section):
    """Discovery by Home Assistant."""

    enabled: bool = False
    prefix: TopicPath = Field("homeassistant", description="its discovery prefix")
    birth: TopicPath = Field("homeassistant/status", description="where it says that it has started")
    source: SourceName = Field("home-assistant", description="what its commands call themselves")
    heartbeat: bool = Field(
        False, description="true: an automation sends heartbeats, so that it may hold the lease of a leased drive"
    )

class BacklogSection(Section):
    """What is kept of readings while the broker is away, and sent afterwards as history; never commands."""

    enabled: bool = True
    path: str | None = Field(
        None,
        min_length=1,
        description="SQLite file; by default backlog-<names>.sqlite in the folder of the file of [store]",
    )
    max_bytes: int = Field(64 * 1024**2, ge=1024**2, le=1024**4, description="of the file; the oldest go first")
    max_age: Duration = Field(seconds("168h"), ge=1, description="older is dropped")
    rate: float = Field(500.0, ge=1, le=100_000, description="values a second that are sent afterwards, at the most")
    sync: bool = Field(True, description="what is stored outlasts a loss of power; false: only the process's end")

class BrokerSection(Section):
    """A connection to a broker; `table` is the key of the section, by which errors name what to change."""

    table: ClassVar[str] = "mqtt"

    url: BrokerUrl = Field(description="mqtt://, mqtts://, ws:// or wss://, host, port, and the path of a WebSocket")
    client_id: str | None = Field(None, min_length=1, description="made of the names by default")
    version: Literal["5", "3.1.1"] = "5"
    user: str | Secret | None = None
    password: Secret | None = None
    tls: TlsSection = TlsSection()
    keep_alive: Duration = Field(seconds("30s"), ge=1, le=3600)
    queue: int = Field(10_000, ge=100, le=1_000_000, description="messages that may wait for the broker")
    reconnect_after: Duration = Field(seconds("1s"), gt=0)
    reconnect_at_most: Duration = Field(seconds("30s"), gt=0)
    command_max_age: Duration = Field(
        seconds("2s"), gt=0, le=60, description="a command that says it is older is refused"
    )
    store: BacklogSection = BacklogSection()

    @property
    def label(self) -> str:
        """Return what the log calls the broker."""
        return self.url

    @property
    def channel(self) -> str:
        """Return the channel of the log in which all that concerns this connection is told."""
        return f"gateway.{self.table}"

    @model_validator(mode="after")
    def _sound(self) -> BrokerSection:
        if self.password is not None and self.user is None:
            raise ValueError("password without user: give both")
        if self.tls != TlsSection() and not self.url.lower().startswith(TLS_SCHEMES):
            raise ValueError("tls is given but the url is not mqtts:// or wss://")
        return self

class MqttSection(BrokerSection):
    """The MQTT side: one broker; several are a list of them, each with a name."""

    name: TopicLevel | None = Field(
        None, description="of the broker, for the log, metrics and rights; of several each has one"
    )
    base: TopicPath = Field("tosvert", description="first level or levels of every topic")
    publish: list[Literal["values", "state"]] = Field(
        ["values", "state"], min_length=1, description="a topic per value, one JSON state per drive, or both"
    )
    retain: bool = True
    qos: Literal[0, 1, 2] = 0
    longest_silence: Duration = Field(seconds("60s"), ge=0, description="0s: publish every reading")
    deadband: dict[ValueName, Deadband] = Field({}, description="value name: smallest change that is published")
    filter: list[FilterSection] = Field([], description="finer: how often which values are published")
    state_interval: Duration = Field(0.0, ge=0, le=3600, description="least time between two states of a drive")
    commands: bool = Field(
        True, description="false: nothing is subscribed, so that nobody can command by this broker, not even a stop"
    )
    home_assistant: HomeAssistantSection = HomeAssistantSection()

    @property
    def label(self) -> str:
        """Return what the log calls the broker."""
        return self.url if self.name is None else f"{self.name} ({self.url})"

    @property
    def channel(self) -> str:
        """Return the channel of the log, which has the broker's name."""
        return super().channel if self.name is None else f"{super().channel}.{self.name}"

    @property
    def origin(self) -> str:
        """Return what commands by this broker have as theirs; "" where it is the only one, without a name."""
        return self.name or ""

class SparkplugSection(BrokerSection):
    """Sparkplug B: the gateway as an edge node, on a connection of its own."""

    table: ClassVar[str] = "sparkplug"

    broker: TopicLevel | None = Field(
        None, description="of the one in [[mqtt]] whose url, user, password, tls... are taken; the first one's"
    )
    url: BrokerUrl = Field("", description="of a broker of its own; by default that of a broker in [mqtt]")
    group_id: SparkplugId = Field(description="the group that the edge node belongs to")
    edge_node_id: SparkplugId | None = Field(None, description="the gateway's name by default")
    primary_host: SparkplugId | None = Field(
        None, description="host id of the application whose STATE is waited for; its loss ends the lease it holds"
    )
    commands: bool = Field(False, description="drives may be commanded by DCMD and lines by NCMD")
    deadband: dict[ValueName, Deadband] = Field({}, description="value name: smallest change that is published")

    @model_validator(mode="after")
    def _has_broker(self) -> SparkplugSection:
        if not self.url:
            raise ValueError("url is missing, and there is no [mqtt] to take it from")
        return self

    @property
    def qos(self) -> Literal[0]:
        """Return the quality of service of births and data: 0, as Sparkplug has it."""
        return 0

class MapSection(Section):
    """One value at an address of the user's own."""

    point: PointName = Field(description='drive and value: "pump-1.output_frequency"')
    address: int = Field(ge=0, le=0xFFFF, description="of its first register, counted from 0")
    type: Literal["word", "signed", "int32", "uint32", "float32"] = Field(
        "word", description="word: as the drive has it; signed: 16 bits; all but word are the value in its unit"
    )
    scale: float = Field(1.0, ge=1e-6, le=1e6, description="the value is multiplied by it, and rounded where whole")
    word_order: Literal["big", "little"] = Field("big", description="of 32 bits; big: the high word first")
    unit: int | None = Field(None, ge=1, le=255, description="MODBUS-TCP unit id; map_unit by default")

    @model_validator(mode="after")
    def _sound(self) -> MapSection:
        if self.type == "word" and "scale" in self.model_fields_set:
            raise ValueError('scale: a "word" is as the drive has it; give it another type, such as "signed"')
        if self.type in ("word", "signed") and "word_order" in self.model_fields_set:
            raise ValueError(f'word_order: "{self.type}" is one word; only 32 bits have an order')
        return self

    @property
    def drive(self) -> str:
        """Return the drive's name, which may contain dots."""
        return self.point.rpartition(".")[0]

    @property
    def value(self) -> str:
        """Return the value's name."""
        return self.point.rpartition(".")[2]

    @property
    def factor(self) -> Decimal:
        """Return the scale exactly as it is written."""
        return Decimal(str(self.scale))

class ReservedSection(Section):
    """Places of the MODBUS-TCP server that are kept for some clients."""

    addresses: list[Network] = Field(min_length=1, description="whose: addresses or networks")
    places: int = Field(ge=1, le=1000, description="how many of `connections`")

class ModbusTlsSection(Section):
    """MODBUS/TCP Security: clients show a certificate, which says their role."""

    listen: Listen = "127.0.0.1:802"
    certificate: str = Field(min_length=1, description="the gateway's certificate (PEM), its intermediates behind it")
    key: str = Field(min_length=1, description="its private key (PEM), without a passphrase")
    ca: str = Field(min_length=1, description="file of the authorities that sign clients' certificates (PEM)")
    crl: str | None = Field(None, min_length=1, description="file of revocation lists (PEM), one of each authority")
    handshake_timeout: Duration = Field(seconds("5s"), ge=0.1, le=60)
    warn_days: int = Field(30, ge=1, le=365, description="it is warned so long before a certificate expires")

class ModbusRtuSection(Section):
    """MODBUS-RTU frames over TCP, for masters that know nothing else."""

    listen: Listen = "127.0.0.1:5021"

class TcpRightSection(Section):
    """What some clients of the MODBUS-TCP server may do. It takes away only: `control` and `sources` hold besides."""

    role: str | None = Field(
        None, min_length=1, max_length=64, description="of clients by TLS, * and ? stand for any; without: all others"
    )
    addresses: list[Network] | None = Field(None, min_length=1, description="only clients from there; all by default")
    units: list[Units] | None = Field(None, min_length=1, description="unit ids or [first, last]; all by default")
    functions: list[Function] = Field(["read"], min_length=1, description='"read", "write", or function codes')
    registers: list[Registers] | None = Field(
        None, min_length=1, description="numbers or [first, last]; all by default"
    )

class ModbusTcpSection(Section):
    """The MODBUS-TCP server."""

    listen: ListenOrOff = Field("127.0.0.1:5020", description='without TLS; "off": not at all')
    connections: int = Field(32, ge=1, le=1000)
    per_address: int | None = Field(None, ge=1, le=1000, description="connections of one client; no limit by default")
    reserved: list[ReservedSection] = Field([], description="places that are kept for some clients")
    allow: list[Network] | None = Field(None, min_length=1, description="who may connect at all; all by default")
    idle_timeout: Duration = Field(seconds("60s"), ge=1)
    tls: ModbusTlsSection | None = None
    rtu: ModbusRtuSection | None = None
    right: list[TcpRightSection] = Field([], description="what clients may do; see docs/modbus-tcp.md")
    map_unit: int = Field(247, ge=1, le=255, description="unit id of the user-defined map; no drive's")
    map: list[MapSection] = Field([], description="the user-defined map: values at addresses of your own")

    @model_validator(mode="after")
    def _served(self) -> ModbusTcpSection:
        if self.listen == OFF and self.tls is None and self.rtu is None:
            raise ValueError('listen = "off": nobody is served; give [modbus_tcp.tls] or [modbus_tcp.rtu]')
        kept = sum(reserved.places for reserved in self.reserved)
        if kept > self.connections:
            raise ValueError(f"reserved: {kept} places are kept, and connections are {self.connections}")
        if self.tls is None and any(right.role is not None for right in self.right):
            raise ValueError("right: a role is told by certificates only: give [modbus_tcp.tls]")
        return self

    def unit_of(self, entry: MapSection) -> int:
        """Return the unit id under which an entry is read."""
        return self.map_unit if entry.unit is None else entry.unit

class WebSection(Section):
    """The web server: /healthz and /metrics."""

    listen: Listen = "127.0.0.1:8080"

class StoreSection(Section):
    """What outlives the process: EEPROM write counters and the audit of commands. Setpoints are never kept."""

    path: str | None = Field(
        None,
        min_length=1,
        description="SQLite file; by default state.sqlite in $STATE_DIRECTORY, else beside this file",
    )
    audit_rows: int = Field(100_000, ge=100, le=10_000_000, description="kept; the oldest go first")

class TraceSection(Section):
    """What is kept of the frames on the lines, and who may see them; see docs/trace.md."""

    frames: int = Field(2000, ge=0, le=100_000, description="latest frames in memory; 0: none are kept")
    serve: bool = Field(True, description="a UNIX socket for tosvert-gateway trace")
    socket: str | None = Field(
        None,
        min_length=1,
        description="its path; by default trace-<name>.sock in $RUNTIME_DIRECTORY, else beside this file",
    )
    on_fault: bool = Field(True, description="the latest frames are written to a file after a fault")
    directory: str | None = Field(
        None, min_length=1, description="of those files; by default traces in $STATE_DIRECTORY, else beside this file"
    )
    files: int = Field(10, ge=1, le=1000, description="kept there; the oldest go first")
    pause: Duration = Field(seconds("60s"), ge=0.1, le=86_400, description="between two of them at the least")

class PollSection(Section):
    """Values that are read together."""

    values: list[ValueName] = Field(min_length=1)
    every: Duration = Field(ge=0, le=86_400, description='"0s": as fast as the line allows')
    max_age: Duration | None = Field(None, gt=0, description="older is stale; about three periods by default")

class FrequencySection(Section):
    """What a drive may be asked for, in Hz; the drive's own limits hold besides."""

    min: float = Field(0.0, ge=0, le=500)
    max: float = Field(500.0, ge=0, le=500)

    @model_validator(mode="after")
    def _in_order(self) -> FrequencySection:
        if self.min > self.max:
            raise ValueError(f"min {self.min} is above max {self.max}")
        return self

class FallbackSection(Section):
    """A frequency to go on with when the controller is lost, in Hz."""

    frequency: float = Field(ge=0, le=500)

class StoredWritesSection(Section):
    """How often the EEPROM of one drive may be written; the manuals give it 10,000 writes for each parameter."""

    burst: int = Field(10, ge=1, le=1000, description="writes that may come at once")
    per_hour: float = Field(20.0, gt=0, le=3600, description="writes an hour after that")
    warn: int = Field(1000, ge=1, le=100_000, description="writes of one parameter after which it is warned")
    refuse: int = Field(5000, ge=1, le=100_000, description="writes of one parameter after which none is made")

    @model_validator(mode="after")
    def _in_order(self) -> StoredWritesSection:
        if self.warn > self.refuse:
            raise ValueError(f"warn {self.warn} is above refuse {self.refuse}")
        return self

class RightSection(Section):
    """What one source may write; without any right a source of `sources` may write all that `control` permits."""

    source: CommandSource
    name: str = Field("*", description="of the controller, or its address; * and ? stand for any")
    broker: NamePattern = Field("*", description="of mqtt: the broker's name; * and ? stand for any")
    commands: list[CommandName] = Field(["*"], description="commands by name, or *")
    registers: list[str] = Field(["*"], description="registers by name; * and ? stand for any")
    min: float | None = Field(None, description="least value in the register's unit")
    max: float | None = Field(None, description="greatest value in the register's unit")

class DriveSection(Section):
    """One drive on a line."""

    name: TopicLevel
    number: int = Field(ge=0, le=247, description="inverter number F802")
    model: str
    protocol: Literal["modbus-rtu", "toshiba-ascii", "toshiba-binary"] = Field(
        "modbus-rtu", description="F829; the drives are shipped with TOSHIBA, ASCII and binary at the same time"
    )
    unit: int | None = Field(
        None, ge=0, le=247, description="MODBUS-TCP unit id; the number by default; 0: none, by unit 255 only"
    )
    control: Literal["off", "direct", "leased"] = Field(
        "off", description="off: read only; leased: by whoever keeps a lease alive; direct: without one"
    )
    sources: list[CommandSource] = Field(
        ["mqtt", "modbus-tcp", "sparkplug"], min_length=1, description="who may command"
    )
    right: list[RightSection] = Field([], description="finer rights of the sources")
    lease: Duration = Field(seconds("2s"), ge=0.1, le=60, description="how long a silent controller keeps the lease")
    on_loss: Literal["stop", "coast", "emergency-stop", "quiesce", "hold"] | FallbackSection = "stop"
    on_exit: Literal["stop", "hold"] = "stop"
    communication_timeout: Duration | None = Field(None, ge=0.1, le=100, description="F803, set where it differs")
    timeout_action: Literal["alarm", "coast", "stop"] | None = Field(None, description="F804, set where it differs")
    timeout_detection: Literal["always", "communication", "running"] | None = Field(
        None,
        validation_alias=AliasChoices("timeout_detection", "detection"),
        description="F808, set where it differs; detection is the same key",
    )
    unwatched: bool = Field(False, description="run commands though F803 or F804 would not stop the motor")
    allow_stored: bool = Field(False, description="parameters may be written to the EEPROM")
    stored_writes: StoredWritesSection = StoredWritesSection()
    frequency: FrequencySection = FrequencySection()
    command_timeout: Duration = Field(seconds("1s"), gt=0, le=10, description="a later command is not sent")
    provision: bool = Field(
        False, description="set F875-F879 where they differ from what is best: wears the EEPROM once"
    )
    block_write: bool = Field(
        False, description="run commands go with the block read where F870 = 1, F871 = 3; tried when the drive comes"
    )
    wait_time: Duration = Field(0.0, ge=0, le=2, description="F805 as set in the drive")
    poll: list[PollSection] = Field([], description="the model's profile where empty")
    deadband: dict[ValueName, Deadband] = Field({}, description="like mqtt.deadband, for this drive")

class GroupSection(Section):
    """Drives of one line that are written to together."""

    name: TopicLevel
    drives: list[TopicLevel] = Field(min_length=1)

def server_address(port: str) -> tuple[str, int] | None:
    """Return host and port of a serial server; None for a device, ValueError where the address is no address."""
    scheme = next((scheme for scheme in SERVER_SCHEMES if port.startswith(scheme)), None)
    if scheme is None:
        return None
    try:
        return address(port.removeprefix(scheme))
    except ValueError as error:
        raise ValueError(f'an address and a port are wanted: "{scheme}10.0.0.7:4001"') from error

def _port(value: str) -> str:
    if "\0" in value:
        raise ValueError("a path or an address cannot contain a NUL character")
    if server_address(value) is None:
        if "://" in value:
            raise ValueError(
                'a serial device or a serial server is wanted: "/dev/ttyUSB0", "socket://10.0.0.7:4001",'
                ' "rfc2217://10.0.0.7:4001"'
            )
        if not value.startswith("/"):
            raise ValueError(f'give the whole path: "/dev/{value}"')
    return value

class LineSection(Section):
    """One RS485 line."""

    name: TopicLevel
    port: Annotated[str, AfterValidator(_port)]
    baud: Literal[9600, 19200, 38400] = Field(19200, description="F800")
    parity: Literal["even", "odd", "none"] = Field("even", description="F801")
    answer_margin: Duration | None = Field(
        None, gt=0, le=5, description="time for adapters and networks beside the drive's own"
    )
    rs485: Literal["auto", "kernel", "rts", "off"] = Field(
        "auto", description="who switches between sending and receiving: the adapter, its driver, the gateway by RTS"
    )
    rts_on_send: bool = Field(True, description="RTS is asserted while sending and at no other time; false: reversed")
    rts_delay_before: Duration = Field(0.0, ge=0, le=0.1, description="from RTS to the first bit")
    rts_delay_after: Duration = Field(0.0, ge=0, le=0.1, description="from the last bit to RTS; less than the gap")
    local_echo: Literal["auto", "on", "off"] = Field("auto", description="the adapter hears what it sends itself")
    silent_share: float = Field(0.05, gt=0, le=0.5, description="share of the line for silent drives")
    probe_every: Duration = Field(seconds("1s"), gt=0, description="first interval of tries")
    probe_at_most: Duration = Field(seconds("5s"), gt=0, description="longest interval of tries")
    drive: list[DriveSection] = Field(min_length=1)
    group: list[GroupSection] = Field([], description="drives that are written to together")

    @model_validator(mode="after")
    def _tried_ever_more_seldom(self) -> LineSection:
        """Refuse tries of silent drives that would come more often as time goes by."""
        if "probe_at_most" in self.model_fields_set and self.probe_at_most < self.probe_every:
            least = f"{self.probe_every:g} s"
            given = f"{self.probe_at_most:g} s"
            raise ValueError(f"probe_at_most {given} is shorter than probe_every: give {least} or more")
        return self

    @model_validator(mode="after")
    def _switchable(self) -> LineSection:
        """Refuse settings of RTS that would do nothing, or spoil every answer."""
        has_rts = self.rs485 in ("kernel", "rts")
        if has_rts and server_address(self.port) is not None:
            raise ValueError(f'rs485 = "{self.rs485}" is for serial devices; a serial server switches by itself')
        given = [key for key in RTS_KEYS if key in self.model_fields_set]
        if given and not has_rts:
            raise ValueError(f'{" and ".join(given)}: only with rs485 = "kernel" or "rts"')
        gap = LineTiming(self.baud).gap
        if self.rts_delay_after >= gap:
            raise ValueError(
                f"rts_delay_after {self.rts_delay_after * 1000:g} ms cuts off answers, which begin"
                f" {gap * 1000:.2f} ms after a request: set it below"
            )
        for key in RTS_KEYS[1:] if self.rs485 == "kernel" else ():
            if abs((delay := 1000 * getattr(self, key)) - round(delay)) > ROUNDING:
                raise ValueError(f'{key}: the kernel counts whole milliseconds; rs485 = "rts" does not')
        return self

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

def problems(table: Mapping[str, Any]) -> list[str]:
    """List all that is wrong with the form of a configuration, a line each: key and what would be right."""
    try:
        Config.model_validate(table)
    except ValidationError as error:
        return [_explain(item, table) for item in error.errors(include_url=False)]
    return []

def _explain(item: Mapping[str, Any], table: Mapping[str, Any]) -> str:
    keys = list(item["loc"])
    if keys[:1] == ["mqtt"] and keys[1:2] in ([ONE], [SEVERAL]):
        del keys[1]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in keys).lstrip(".")
    names = "".join(f" ({name})" for name in _names_on_the_way(keys, table))
    if item["type"] == "extra_forbidden":
        return f"{key}{names}: unknown key{_nearest(keys)}"
    if item["type"] == "missing":
        return f"{key}{names}: is missing"
    reason = item["msg"].removeprefix("Value error, ")
    return f"{key}{names}: {reason}{_given(keys, item['input'])}"


def _given(keys: list[Any], value: object) -> str:
    """Repeat a short value, but none that may hold a secret."""
    is_secret = "password" in keys or "user" in keys or "@" in str(value)
    return "" if is_secret or isinstance(value, dict | list) else f" (given: {value!r:.60})"

def _names_on_the_way(keys: list[Any], table: Any) -> Iterator[str]:
    """Yield the `name` of every list entry on the way to the key, so that [[line.drive]] 7 is found."""
    for key in keys:
        try:
            table = table[key]
        except (KeyError, IndexError, TypeError):
            return
        if isinstance(key, int) and isinstance(table, dict) and isinstance(table.get("name"), str):
            yield table["name"]

def _nearest(keys: list[Any]) -> str:
    known = _known_keys(keys[:-1])
    near = difflib.get_close_matches(str(keys[-1]), known, 1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(known)}"

def _known_keys(keys: list[Any]) -> list[str]:
    schema: Any = Config.model_json_schema()
    definitions, node = schema["$defs"], schema

    def having(node: Any, part: str) -> Any:
        """Return what a node has as a part, it or what it stands for: one of several forms, or a definition."""
        if "$ref" in node:
            node = definitions[node["$ref"].rpartition("/")[2]]
        if part in node:
            return node[part]
        return next(filter(None, (having(form, part) for form in node.get("anyOf", node.get("oneOf", [])))), {})

    for key in keys:
        node = having(node, "items") if isinstance(key, int) else having(node, "properties").get(key, {})
    return sorted(having(node, "properties"))

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
