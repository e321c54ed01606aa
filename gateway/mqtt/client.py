"""Makes paho's clients: how a connection begins, what goes with a message, and what is subscribed."""

from __future__ import annotations

import socket
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, cast

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, LogLevel, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from gateway.config import BrokerSection, MqttSection
from gateway.errors import BadConfig
from gateway.mqtt import access, payload, reasons, topics
from gateway.mqtt.connecting import in_thread
from gateway.mqtt.in_flight import FIRST_ID, IN_FLIGHT
from gateway.mqtt.made import BrokerAway, LastError, Made
from gateway.mqtt.packets import FAILURE
from gateway.mqtt.ws_socket import WebSocket

CONNECT_LIMIT = 5.0  # seconds, for TCP, for the TLS handshake and for that of a WebSocket each
LARGEST_PACKET = 64 * 1024  # bytes that the broker may send us in one packet
RECEIVE_MAXIMUM = 20  # messages of QoS 1 and 2 that may be under way to us
REASON_AT = 2  # bytes of its packet identifier stand before the reason code of a PUBREC (MQTT 5 3.5.2)
LEFT_WITH_WILL = ReasonCode(PacketTypes.DISCONNECT, "Disconnect with will message")
SEND_BUFFER = 256 * 1024  # bytes; what the kernel holds for a broker that does not read, no queue can bound
RECEIVE_BUFFER = 64 * 1024  # bytes; of a flood no more is to be ahead of a stop, and no packet to grow unseen


@dataclass(frozen=True, slots=True)
class Introduction:
    """As what a client connects, and the will that the broker publishes when it is lost.

    `wills_at_leave`: the broker publishes the will even after a DISCONNECT in order (MQTT 5).
    """

    client_id: str
    topic: str
    will: str | bytes
    qos: int
    retain: bool
    wills_at_leave: bool = False


def introduction(section: MqttSection, gateway: str) -> Introduction:
    """Return as what the bridge connects: its will says that the gateway is offline."""
    client_id = section.client_id or f"{section.base.replace('/', '-')}-{gateway}"
    return Introduction(client_id, topics.status(section.base, gateway), payload.OFFLINE, section.qos, retain=True)


async def connect(section: BrokerSection, introduced: Introduction) -> Made:
    """Connect in a thread, since paho blocks meanwhile; BrokerAway says why not."""
    return await in_thread(lambda: _connect(section, introduced))


def _connect(section: BrokerSection, introduced: Introduction) -> Made:
    """Connect TCP and TLS and send CONNECT."""
    try:
        reach = access.read(section)  # anew for each connection: secrets and certificates may have been renewed
        client, errors = _make_client(section, introduced, reach)
        client.max_inflight_messages = IN_FLIGHT
        options: dict[str, Any] = {}
        if section.version == "5":
            options = {"clean_start": True, "properties": _connect_properties()}
        client.connect(reach.host, reach.port, int(section.keep_alive), **options)
        _set_up(client.socket())
    except (OSError, ValueError, BadConfig) as error:
        traceback.clear_frames(error.__traceback__)  # lets go of a socket whose handshake failed; paho does not
        raise BrokerAway(reasons.of_error(str(error), section.table)) from error
    if section.version == "5":
        reason = LEFT_WITH_WILL if introduced.wills_at_leave else None
        return Made(client, errors, _Expiry, _correlated, _reason_name, is_5=True, reason=reason)
    return Made(client, errors, _nothing, _nothing, _reason_name, is_5=False)


class _Client(paho.Client):
    """paho's client, which shares its socket: it is given whole packets, and others write while it does not.

    It has a WebSocket of our own where one is wanted.
    """

    def __init__(self, reach: access.Access, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._reach = reach
        self._given = b""  # what paho has not read yet of the packet that it was given

    def _create_socket(self) -> Any:
        sock = super()._create_socket()
        if self._reach.path is None:
            return sock
        return WebSocket.opened(cast(socket.socket, sock), self._reach.authority, self._reach.path, CONNECT_LIMIT)

    # ---- reading

    def receive(self, most: int) -> bytes:
        """Return what has come, at most so many bytes; b"" where nothing has. The end is told by `on_disconnect`."""
        if self._sock is None:
            return b""
        try:
            received = super()._sock_recv(most)
        except BlockingIOError:
            return b""
        except OSError as error:
            self._lose(error)
            return b""
        if not received:
            self._lose(None)
        self._last_bytes_received = paho.time_func()
        return received

    def take(self, packet: bytes) -> None:
        """Let paho read a whole packet."""
        self._given = packet
        self.loop_read()

    def _sock_recv(self, bufsize: int) -> bytes:
        """Let paho read from the packet that it was given, and no further."""
        if not self._given:
            raise BlockingIOError
        read, self._given = self._given[:bufsize], self._given[bufsize:]
        return read

    def _handle_connack(self) -> MQTTErrorCode:
        """Keep the keep-alive where the broker wants none: with 0 paho would take every question for unanswered."""
        asked = self._keepalive
        result = super()._handle_connack()
        self._keepalive = self._keepalive or asked
        return result

    def _handle_pubrec(self) -> MQTTErrorCode:
        """Take a refusal of QoS 2 for the end of it (MQTT 5 4.3.3); to paho it is none."""
        packet = self._in_packet["packet"]
        if self._protocol == MQTTProtocolVersion.MQTTv5 and len(packet) > REASON_AT and packet[REASON_AT] >= FAILURE:
            return self._handle_pubackcomp("PUBACK")  # which has the same reason codes
        return super()._handle_pubrec()

    # ---- writing

    def write(self, content: bytes) -> int:
        """Write to the socket, where paho has nothing that goes first; return how many bytes it has taken."""
        if self._sock is None or self._out_packet:
            return 0
        try:
            taken = self._sock_send(content)
        except BlockingIOError:
            return 0
        except OSError as error:
            self._lose(error)
            return 0
        self._last_msg_out = paho.time_func()
        return taken

    def _lose(self, error: OSError | None) -> None:
        """Do what paho does when its socket fails, or ends without an error."""
        if error is not None:
            self._easy_log(LogLevel.MQTT_LOG_ERR, "failed to receive on socket: %s", error)
        self._loop_rc_handle(MQTTErrorCode.MQTT_ERR_CONN_LOST)

    # ---- packet identifiers

    def limit_in_flight(self, most: int) -> None:
        """Take how many messages of QoS 2 the broker takes at a time; paho wants to know that before it connects."""
        self._max_inflight_messages = most

    def _mid_generate(self) -> int:
        """Return one of the identifiers that are paho's; the others are those of `InFlight`."""
        if self._last_mid >= FIRST_ID - 1:
            self._last_mid = 0
        return super()._mid_generate()


def _make_client(section: BrokerSection, introduced: Introduction, reach: access.Access) -> tuple[_Client, LastError]:
    is_5 = section.version == "5"
    client = _Client(
        reach,
        CallbackAPIVersion.VERSION2,
        client_id=introduced.client_id,
        clean_session=None if is_5 else True,
        protocol=MQTTProtocolVersion.MQTTv5 if is_5 else MQTTProtocolVersion.MQTTv311,
        reconnect_on_failure=False,  # or paho would reconnect on its own, blocking, from within loop_read
    )
    client.connect_timeout = CONNECT_LIMIT
    client.will_set(introduced.topic, introduced.will, introduced.qos, retain=introduced.retain)
    if reach.user is not None:
        client.username_pw_set(reach.user, reach.password)
    if reach.tls is not None:
        client.tls_set_context(reach.tls)
    errors = LastError()
    client.enable_logger(errors)
    return client, errors


def subscriptions(filters: Iterable[str], version: str, *, wants_kept: bool = False) -> list[tuple[str, Any]]:
    """Return what is subscribed; MQTT 5 can ask for no retained messages (SAFETY.md H01), unless they are wanted."""
    options: Any = 1
    if version == "5" and wants_kept:  # what this client id has published before, it is not sent with noLocal
        options = SubscribeOptions(qos=1, retainHandling=SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE)
    elif version == "5":
        options = SubscribeOptions(qos=1, noLocal=True, retainHandling=SubscribeOptions.RETAIN_DO_NOT_SEND)
    return [(topic, options) for topic in filters]


def subscription_to_state(topic: str, version: str) -> tuple[str, Any]:
    """Return a subscription that also wants what the broker has kept: for a state, never for a command."""
    return topic, SubscribeOptions(qos=1) if version == "5" else 1


def _connect_properties() -> Properties:
    """Make the properties of CONNECT: nothing outlives the connection, and what comes in is bounded (H02, H24)."""
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = 0
    properties.ReceiveMaximum = RECEIVE_MAXIMUM
    properties.MaximumPacketSize = LARGEST_PACKET
    return properties


def _set_up(sock: Any) -> None:
    """Let small messages go at once, and few wait in the kernel."""
    if sock is not None:
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)


class _Expiry:
    """A message expiry as paho wants it, packed once: Properties would pack it anew for every message."""

    def __init__(self, seconds: int) -> None:
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        properties.MessageExpiryInterval = seconds
        self._packed = properties.pack()  # type: ignore[no-untyped-call]

    def pack(self) -> bytes:
        """Return the bytes on the wire."""
        return cast(bytes, self._packed)


def _correlated(correlation: bytes) -> Properties:
    """Make the properties of an answer: those of the question come back."""
    properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
    if correlation:
        properties.CorrelationData = correlation
    return properties


def _reason_name(code: int) -> str:
    """Name the reason code of a PUBACK."""
    try:
        return ReasonCode(PacketTypes.PUBACK, identifier=code).getName()
    except (KeyError, ValueError):  # ValueError: of other packets alone
        return "Unknown reason"


def _nothing(_: object) -> None:
    """Make no properties: MQTT 3.1.1 has none."""
