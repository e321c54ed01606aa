"""One connection to the broker, driven by the event loop: what is sent, what is on its way, how it ends.

paho's own client is handed in, made elsewhere.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from gateway.errors import GatewayError
from gateway.metrics import MqttStats
from gateway.mqtt import reasons
from gateway.mqtt.publisher import FOR_EVER
from gateway.mqtt.reception import Ears, Reception

log = logging.getLogger("gateway.mqtt")

ANSWER_LIMIT = 10.0  # seconds from CONNECT to CONNACK
LEAVE_LIMIT = 2.0  # seconds from the last words to the end
LARGEST_OVERHEAD = 32  # bytes of a PUBLISH beside topic and payload
NO_RECEIVE_MAXIMUM = 65_535  # messages of QoS 1 and 2 under way (MQTT 5 3.2.2.3.3)
PACKET_IDS = 60_000  # messages of QoS 1 and 2 that can be told apart, with a margin
RESERVE = 256  # messages beyond the queue that may tell what became of commands: values must not keep that back
READ_AT_ONCE = 8  # messages that are read at a stretch: well below a millisecond, so that no line waits for a flood
LARGEST_PACKET = 64 * 1024  # bytes that the broker may send in one packet
TOO_LARGE = "the broker sent a packet of %d bytes; no command needs more than %d"
CALLBACKS = (
    "on_connect",
    "on_disconnect",
    "on_publish",
    "on_message",
    "on_subscribe",
    "on_socket_close",
    "on_socket_register_write",
)
TCP_CORK = getattr(socket, "TCP_CORK", None)  # Linux
LOSSES = {  # what paho's names for the end of a connection mean
    "Unspecified error": "closed by the broker; if that repeats, another client may have the same client id",
    "Keep alive timeout": "the broker has not answered within the keep-alive",
}


class Terms(Protocol):
    """What a section of the configuration says of a connection: its table, how much may wait, and how it is sent."""

    @property
    def table(self) -> str:
        """Return the name of the section."""
        ...

    @property
    def queue(self) -> int:
        """Return how many messages may wait for the broker."""
        ...

    @property
    def qos(self) -> int:
        """Return the quality of service."""
        ...


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

    `expiry` makes the properties of a message that the broker may forget after so many seconds, and `correlation`
    those of an answer; both make None where the protocol has no such thing. `reason` goes with the last DISCONNECT.
    """

    client: Any
    errors: LastError
    expiry: Callable[[int], Any]
    correlation: Callable[[bytes], Any]
    reason: Any = None


class Connection:
    """One connection by a paho client that is thrown away with it, so that nothing of an old one is sent late.

    paho calls back from inside its own functions while it holds a lock that it needs for writing: callbacks
    only take notes here. An exception in one of them is raised by the next `wait`.
    """

    def __init__(self, made: Made, section: Terms, stats: MqttStats) -> None:
        self.lost: str | None = None
        self.receive_maximum = NO_RECEIVE_MAXIMUM
        self.capacity = min(section.queue, PACKET_IDS) if section.qos else section.queue
        self._client = made.client
        self._errors = made.errors
        self._make_expiry = made.expiry
        self._correlate = made.correlation
        self._last_reason = made.reason
        self._answer: Any = None
        self._stats = stats
        self._qos = section.qos
        self._table = section.table
        self._expiries: dict[int, Any] = {FOR_EVER: None}
        self._on_their_way: deque[Any] = deque()
        self._told: deque[Any] = deque()  # those of them that tell what became of commands
        self._events: deque[Any] = deque()  # those that the broker has to acknowledge, whatever `qos` is
        self._unwritten = 0
        self._is_flushing_soon = False
        self._largest: int | None = None
        self._was_refused = False
        self._reception = Reception(made.client, stats, section.table)
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
        if self._qos:
            client.on_publish = self._on_publish
        sock = client.socket()
        if sock is None:
            raise BrokerAway(reasons.of_silence(self._errors.text, self._table))
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
            self.lost = reasons.of_code(code.value, code.getName(), self._table)
        else:
            self.lost = self._errors.text or LOSSES.get(code.getName(), code.getName())
        self._news.set()

    def _on_publish(self, _client: Any, _data: Any, _mid: int, code: Any, _properties: Any) -> None:
        if code.is_failure and not self._was_refused:
            self._was_refused = True
            log.warning("the broker refuses messages: %s", reasons.of_code(code.value, code.getName(), self._table))

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
        if self._fd < 0:
            return  # it was lost since this was asked for
        try:
            self._read()
            self._reception.hand_over()
            self.flush()
        except Exception as error:
            self.fail(error)

    def _read(self) -> None:
        """Read some messages; what is left makes the socket readable again, but for what TLS has read already."""
        for _ in range(READ_AT_ONCE):
            before = self._reception.count
            self._client.loop_read()
            self._refuse_large_packet()
            if self.lost is not None:
                return
            if self._reception.count == before and not self._has_pending():
                return
        if self._has_pending():
            self._loop.call_soon(self._readable)

    def _refuse_large_packet(self) -> None:
        """End the connection before paho collects a packet of up to 256 MiB: MQTT 3.1.1 cannot forbid them."""
        size = self._client._in_packet["remaining_length"]
        if size > LARGEST_PACKET and self.lost is None:
            self.lost = TOO_LARGE % (size, LARGEST_PACKET)
            self._detach()
            self._news.set()

    def listen(self, subscriptions: Sequence[tuple[str, Any]], ears: Ears) -> None:
        """Subscribe, and hand every message that comes to `ears`."""
        self._reception.listen(subscriptions, ears)
        self.flush()

    def _has_pending(self) -> bool:
        """Say whether TLS holds bytes that it has read already, of which the socket tells nothing."""
        sock = self._client.socket()
        return isinstance(sock, ssl.SSLSocket) and sock.pending() > 0

    def _writable(self) -> None:
        self._is_flushing_soon = False
        if self._fd < 0:
            return
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
            self._told.clear()
        for sent in (waiting, self._told, self._events):
            while sent and sent[0].is_published():
                sent.popleft()
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
        if self._is_too_large(topic, text):
            self._stats.dropped += 1
        else:
            self._publish(topic, text, retain, self._expiry(expiry))

    def carry(self, topic: str, payload: bytes) -> bool:
        """Hand bytes to paho, not to be retained; `flush` writes them. False where they are too large."""
        if self._is_too_large(topic, payload):
            return False
        self._publish(topic, payload, retain=False, properties=None)
        return True

    def _is_too_large(self, topic: str, text: str | bytes) -> bool:
        if self._largest is None:
            return False
        size = len(text if isinstance(text, bytes) else text.encode())
        if len(topic) + size + LARGEST_OVERHEAD <= self._largest:
            return False
        log.warning("%s: larger than the %d bytes that the broker takes", topic, self._largest)
        return True

    def _publish(
        self, topic: str, text: str | bytes, retain: bool, properties: Any, qos: int | None = None
    ) -> None:
        quality = self._qos if qos is None else qos
        self._on_their_way.append(self._client.publish(topic, text, quality, retain, properties))
        self._unwritten += 1
        self._stats.published += 1

    # What the listener does.

    def say(self, topic: str, text: str, *, expiry: int, is_event: bool = False) -> bool:
        """Hand what happened to paho, and write it; False where too much is on its way."""
        if not is_event:
            return self._tell(topic, text, self._expiry(expiry))
        if len(self._events) >= RESERVE or not self._tell(topic, text, self._expiry(expiry), max(1, self._qos)):
            return False
        self._events.append(self._on_their_way[-1])
        return True

    def reply(self, topic: str, text: str, correlation: bytes) -> bool:
        """Hand an answer to paho, and write it; False where too much is on its way."""
        return self._tell(topic, text, self._correlate(correlation))

    def _tell(self, topic: str, text: str, properties: Any, qos: int | None = None) -> bool:
        if self.room <= -RESERVE or self.lost is not None or self._is_too_large(topic, text):
            return False
        self._publish(topic, text, retain=False, properties=properties, qos=qos)
        self._told.append(self._on_their_way[-1])
        if not self._is_flushing_soon:
            self._is_flushing_soon = True
            self._loop.call_soon(self._writable)
        return True

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
                raise BrokerAway(reasons.of_silence(f"no answer within {ANSWER_LIMIT:.0f} s", self._table))
            await self.wait(end - self._loop.time())
        if self._answer is None:
            raise BrokerAway(reasons.of_silence(self._errors.text, self._table))
        if self._answer.is_failure:
            why = reasons.of_code(self._answer.value, self._answer.getName(), self._table)
            raise BrokerAway(f"refused: {why}")

    async def leave(self) -> None:
        """Wait until all is sent, then disconnect in order."""
        while self._on_their_way and self.lost is None:
            await self.wait(LEAVE_LIMIT, room=self.capacity)
        self._client.disconnect(self._last_reason)
        while self.lost is None:
            self.flush()
            await self.wait(LEAVE_LIMIT)

    def abort(self) -> None:
        """Let go of the socket; where nobody has disconnected in order, the broker sends the will."""
        self._detach()
        self._stats.untold += len(self._told)
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
