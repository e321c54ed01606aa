"""One connection to the broker, driven by the event loop: what is sent, what is on its way, how it ends.

paho's own client is handed in: only the bridge imports it.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gateway.config import MqttSection
from gateway.errors import GatewayError
from gateway.metrics import MqttStats
from gateway.mqtt import reasons
from gateway.mqtt.publisher import FOR_EVER

log = logging.getLogger("gateway.mqtt")

ANSWER_LIMIT = 10.0  # seconds from CONNECT to CONNACK
LEAVE_LIMIT = 2.0  # seconds from the last words to the end
LARGEST_OVERHEAD = 32  # bytes of a PUBLISH beside topic and payload
NO_RECEIVE_MAXIMUM = 65_535  # messages of QoS 1 and 2 under way (MQTT 5 3.2.2.3.3)
INBOX = 256  # messages of the broker that may wait to be looked at
PACKET_IDS = 60_000  # messages of QoS 1 and 2 that can be told apart, with a margin
CALLBACKS = (
    "on_connect",
    "on_disconnect",
    "on_publish",
    "on_message",
    "on_socket_close",
    "on_socket_register_write",
)
TCP_CORK = getattr(socket, "TCP_CORK", None)  # Linux
LOSSES = {  # what paho's names for the end of a connection mean
    "Unspecified error": "closed by the broker; if that repeats, another client may have the same client id",
    "Keep alive timeout": "the broker has not answered within the keep-alive",
}


class BrokerAway(GatewayError):
    """There is no connection: say why once, try again after a pause."""


class LastError(logging.Logger):
    """Keeps the last error that paho tells its logger: its callbacks do not say why a connection broke."""

    def __init__(self) -> None:
        super().__init__("paho")
        self.text = ""

    def log(self, level: int, msg: object, *args: object, **kwargs: Any) -> None:
        """Keep an error; pass over the rest."""
        if level >= logging.ERROR:
            self.text = (str(msg) % args).removeprefix("failed to receive on socket: ")


@dataclass(frozen=True, slots=True)
class Made:
    """A paho client that has sent its CONNECT, and what goes with it.

    `expiry` makes the properties of a message that the broker may forget after so many seconds; None where
    the protocol has no such thing.
    """

    client: Any
    errors: LastError
    expiry: Callable[[int], Any]


@dataclass(frozen=True, slots=True)
class Heard:
    """A message of the broker as it came."""

    topic: str
    payload: bytes
    is_retained: bool
    expiry: int | None
    response_topic: str
    correlation: bytes


class Connection:
    """One connection by a paho client that is thrown away with it, so that nothing of an old one is sent late.

    paho calls back from inside its own functions while it holds a lock that it needs for writing: callbacks
    only take notes here. An exception in one of them is raised by the next `wait`.
    """

    def __init__(self, made: Made, section: MqttSection, stats: MqttStats) -> None:
        self.lost: str | None = None
        self.receive_maximum = NO_RECEIVE_MAXIMUM
        self.capacity = min(section.queue, PACKET_IDS) if section.qos else section.queue
        self._client = made.client
        self._errors = made.errors
        self._make_expiry = made.expiry
        self._answer: Any = None
        self._stats = stats
        self._qos = section.qos
        self._expiries: dict[int, Any] = {FOR_EVER: None}
        self._on_their_way: deque[Any] = deque()
        self._unwritten = 0
        self._largest: int | None = None
        self._was_refused = False
        self._inbox: deque[Heard] = deque(maxlen=INBOX)
        self._hear: Callable[[Heard], None] | None = None
        self._news = asyncio.Event()
        self._wanted_room = 0
        self._error: Exception | None = None
        self._loop = asyncio.get_running_loop()
        self._fd = -1
        self._is_writing = False
        self._attach()

    def _attach(self) -> None:
        client = self._client
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_socket_close = self._on_socket_close
        client.on_socket_register_write = _do_nothing  # it keeps paho from writing message by message
        client.on_message = self._on_message
        if self._qos:
            client.on_publish = self._on_publish
        sock = client.socket()
        if sock is None:
            raise BrokerAway(reasons.of_silence(self._errors.text))
        self._fd = sock.fileno()
        self._loop.add_reader(self._fd, self._readable)
        self.flush()

    # What paho tells.

    def _on_connect(self, _client: Any, _data: Any, _flags: Any, code: Any, properties: Any) -> None:
        self._answer = code
        self._largest = getattr(properties, "MaximumPacketSize", None)
        self.receive_maximum = getattr(properties, "ReceiveMaximum", NO_RECEIVE_MAXIMUM)
        self._news.set()

    def _on_disconnect(self, _client: Any, _data: Any, flags: Any, code: Any, _properties: Any) -> None:
        if flags.is_disconnect_packet_from_server:
            self.lost = reasons.of_code(code.value, code.getName())
        else:
            self.lost = self._errors.text or LOSSES.get(code.getName(), code.getName())
        self._news.set()

    def _on_publish(self, _client: Any, _data: Any, _mid: int, code: Any, _properties: Any) -> None:
        if code.is_failure and not self._was_refused:
            self._was_refused = True
            log.warning("the broker refuses messages: %s", reasons.of_code(code.value, code.getName()))

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        """Take note of a message; of a flood the oldest are forgotten, which only the latest could matter against."""
        if len(self._inbox) == INBOX:
            self._stats.inbox_dropped += 1
        known = getattr(message, "properties", None)
        self._inbox.append(
            Heard(
                topic=message.topic,
                payload=bytes(message.payload),
                is_retained=bool(message.retain),
                expiry=getattr(known, "MessageExpiryInterval", None),
                response_topic=getattr(known, "ResponseTopic", ""),
                correlation=getattr(known, "CorrelationData", b""),
            )
        )

    def _on_socket_close(self, _client: Any, _data: Any, _sock: Any) -> None:
        self._detach()

    def _detach(self) -> None:
        if self._fd >= 0:
            self._loop.remove_reader(self._fd)
            if self._is_writing:
                self._loop.remove_writer(self._fd)
        self._fd, self._is_writing = -1, False

    # The socket.

    def _readable(self) -> None:
        try:
            self._client.loop_read()
            while self._has_pending():
                self._client.loop_read()
            self._hand_over()
            self.flush()
        except Exception as error:
            self.fail(error)

    def _hand_over(self) -> None:
        """Hand on what has come, outside of paho's lock."""
        while self._inbox:
            heard = self._inbox.popleft()
            if self._hear is not None:
                self._hear(heard)

    def listen(self, subscriptions: Any, hear: Callable[[Heard], None]) -> None:
        """Subscribe, and hand every message that comes to `hear`."""
        self._hear = hear
        self._client.subscribe(subscriptions)
        self.flush()

    def _has_pending(self) -> bool:
        """Say whether TLS holds bytes that it has read already, of which the socket tells nothing."""
        sock = self._client.socket()
        return isinstance(sock, ssl.SSLSocket) and sock.pending() > 0

    def _writable(self) -> None:
        try:
            self.flush()
        except Exception as error:
            self.fail(error)

    def flush(self) -> None:
        """Write what was sent to the socket, now; what it does not take is written as soon as it does."""
        if self._unwritten > 1:
            self._write_corked()
        else:
            self._client.loop_write()
        self._unwritten = 0
        wants_write = self._client.want_write()
        if self._fd >= 0 and wants_write is not self._is_writing:
            self._is_writing = wants_write
            if wants_write:
                self._loop.add_writer(self._fd, self._writable)
            else:
                self._loop.remove_writer(self._fd)
        self._count(is_all_written=not wants_write)

    def _write_corked(self) -> None:
        """Write several messages as one segment: paho hands them to the socket one by one."""
        sock = self._client.socket()
        if sock is None or TCP_CORK is None:
            self._client.loop_write()
            return
        sock.setsockopt(socket.IPPROTO_TCP, TCP_CORK, 1)
        self._client.loop_write()
        if self._fd >= 0:
            sock.setsockopt(socket.IPPROTO_TCP, TCP_CORK, 0)

    def _count(self, *, is_all_written: bool) -> None:
        waiting = self._on_their_way
        if is_all_written and not self._qos:
            waiting.clear()
        while waiting and waiting[0].is_published():
            waiting.popleft()
        self._stats.waiting = len(waiting)
        if self._wanted_room and self.room >= self._wanted_room:
            self._news.set()

    def tend(self) -> None:
        """Keep the connection alive, or find that it is not."""
        self._client.loop_misc()
        self.flush()

    # What the publisher does.

    @property
    def room(self) -> int:
        """Return how many more messages may be on their way."""
        return self.capacity - len(self._on_their_way)

    def send(self, topic: str, text: str, *, retain: bool, expiry: int) -> None:
        """Hand a message to paho; `flush` writes it."""
        if self._largest is not None and len(topic) + len(text.encode()) + LARGEST_OVERHEAD > self._largest:
            self._stats.dropped += 1
            log.warning("%s: larger than the %d bytes that the broker takes", topic, self._largest)
            return
        self._on_their_way.append(self._client.publish(topic, text, self._qos, retain, self._expiry(expiry)))
        self._unwritten += 1
        self._stats.published += 1

    def reply(self, topic: str, text: str, properties: Any) -> None:
        """Hand an answer to paho, with properties of its own; `flush` writes it."""
        self._on_their_way.append(self._client.publish(topic, text, self._qos, False, properties))
        self._unwritten += 1
        self._stats.published += 1

    def _expiry(self, seconds: int) -> Any:
        if seconds not in self._expiries:
            self._expiries[seconds] = self._make_expiry(seconds)
        return self._expiries[seconds]

    # What the bridge does.

    def wake(self) -> None:
        """End the wait of the bridge."""
        self._news.set()

    def fail(self, error: Exception) -> None:
        """Take an error that nobody expects; the bridge ends with it."""
        self._error = self._error or error
        self._news.set()

    async def wait(self, limit: float, room: int = 0) -> None:
        """Wait for the answer or the loss of the connection, for `wake`, for so much room, or so many seconds."""
        self._wanted_room = room
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(limit):
                await self._news.wait()
        self._news.clear()
        if self._error is not None:
            raise self._error

    async def accepted(self) -> None:
        """Wait until the broker takes the connection; BrokerAway says why it does not."""
        end = self._loop.time() + ANSWER_LIMIT
        while self._answer is None and self.lost is None:
            if self._loop.time() >= end:
                raise BrokerAway(reasons.of_silence(f"no answer within {ANSWER_LIMIT:.0f} s"))
            await self.wait(end - self._loop.time())
        if self._answer is None:
            raise BrokerAway(reasons.of_silence(self._errors.text))
        if self._answer.is_failure:
            raise BrokerAway(f"refused: {reasons.of_code(self._answer.value, self._answer.getName())}")

    async def leave(self) -> None:
        """Wait until all is sent, then disconnect in order."""
        while self._on_their_way and self.lost is None:
            await self.wait(LEAVE_LIMIT, room=self.capacity)
        self._client.disconnect()
        while self.lost is None:
            self.flush()
            await self.wait(LEAVE_LIMIT)

    def abort(self) -> None:
        """Let go of the socket; where nobody has disconnected in order, the broker sends the will."""
        self._detach()
        for name in CALLBACKS:
            setattr(self._client, name, None)
        close(self._client)


def close(client: Any) -> None:
    """Close a client's socket, if there is one, without a word to the broker."""
    sock = client.socket()
    if sock is not None:
        sock.close()


def _do_nothing(_client: Any, _data: Any, _sock: Any) -> None:
    """Take note of nothing."""
