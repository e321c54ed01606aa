"""The sections of a connection to a broker: `[mqtt]` or `[[mqtt]]` with all that is below it, and `[sparkplug]`."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator

from gateway.config.notation import (
    Deadband,
    Duration,
    NamePattern,
    SourceName,
    SparkplugId,
    TopicLevel,
    TopicPath,
    ValueName,
    ValuePattern,
    seconds,
)
from gateway.config.section import Secret, Section

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


class TlsSection(Section):
    """TLS towards the broker; fails closed."""

    ca: str | None = Field(None, description="file of trusted certificates; the system's by default")
    certificate: str | None = Field(None, description="client certificate (PEM)")
    key: str | None = Field(None, description="its private key (PEM)")
    warn_days: int = Field(30, ge=1, le=365, description="it is warned so long before one of them expires")

    @model_validator(mode="after")
    def _both(self) -> TlsSection:
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key belong together: give both or neither")
        return self


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
