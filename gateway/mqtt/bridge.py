"""The bridge to an MQTT broker: connects by paho on the event loop, and carries what the publisher sends."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import socket
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import Any, cast

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from gateway.clock import Clock
from gateway.config import MqttSection
from gateway.control.command import Command, Result
from gateway.control.door import Door
from gateway.errors import BadConfig
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.mqtt import access, commands, payload, reasons, topics
from gateway.mqtt.backoff import Backoff
from gateway.mqtt.connection import LEAVE_LIMIT, BrokerAway, Connection, Heard, LastError, Made, close
from gateway.mqtt.publisher import Publisher

log = logging.getLogger("gateway.mqtt")

CONNECT_LIMIT = 5.0  # seconds, for TCP and for the TLS handshake each
TEND_EVERY = 1.0  # seconds between looks at the keep-alive
GOOD_FOR = 1.0  # seconds of a command for a drive that nobody may command
EVENT_EXPIRY = 60  # seconds after which the broker may forget a result or an event
STEPS = 4  # owed values sent at a stretch: some 0.2 ms, so that a line's timing does not suffer
LARGEST_PACKET = 64 * 1024  # bytes that the broker may send us in one packet
RECEIVE_MAXIMUM = 20  # messages of QoS 1 and 2 that may be under way to us
IN_FLIGHT = 20  # messages of QoS 1 and 2 under way to the broker; Mosquitto takes no more as installed
SEND_BUFFER = 256 * 1024  # bytes; what the kernel holds for a broker that does not read, no queue can bound


class Bridge:
    """Publishes the image to one broker, from `run` until it is cancelled.

    While the broker is away nothing is kept for it: after each connect the whole image is published as it is then.
    """

    def __init__(
        self,
        section: MqttSection,
        gateway: str,
        image: Image,
        stats: MqttStats,
        clock: Clock,
        chance: random.Random | None = None,
        door: Door | None = None,
    ) -> None:
        access.read(section)  # what is missing or wrong now is better known before anything starts
        self._section = section
        self._gateway = gateway
        self._stats = stats
        self._clock = clock
        self._backoff = Backoff(section.reconnect_after, section.reconnect_at_most, chance or random.SystemRandom())
        self._publisher = Publisher(section, gateway, image, stats)
        self._connection: Connection | None = None
        self._in_flight = IN_FLIGHT
        self._told = ""
        self._root = f"{section.base}/{gateway}/"
        self._door = door if door is not None and door.controls else None
        image.subscribe(self._on_change)
        if self._door is not None:
            self._door.on_result(self._on_result)
            self._door.on_event(self._on_event)

    async def run(self) -> None:
        """Connect, publish and connect again until cancelled; whatever else ends it is an error of ours."""
        while True:
            began = self._clock.now()
            try:
                await self._connect_once()
            except BrokerAway as error:
                self._tell_away(str(error))
            if self._clock.now() - began > self._section.reconnect_at_most:
                self._backoff.reset()
            await asyncio.sleep(self._backoff.next())

    def _tell_away(self, reason: str) -> None:
        """Log why the broker is away, the same reason once only."""
        level = logging.DEBUG if reason == self._told else logging.WARNING
        self._told = reason
        log.log(level, "%s: %s; trying again", self._section.url, reason)

    async def _connect_once(self) -> None:
        """Serve one connection to its end, which BrokerAway tells."""
        made = await _in_thread(lambda: _connect(self._section, self._gateway, self._in_flight))
        connection = None
        try:
            connection = Connection(made, self._section, self._stats)
            await connection.accepted()
            self._respect(connection.receive_maximum)
            self._begin(connection)
            await self._serve(connection)
        except asyncio.CancelledError:
            if connection is not None and connection is self._connection:
                await self._leave(connection)
            raise
        finally:
            self._connection, self._stats.is_connected = None, False
            self._stats.waiting = 0
            if connection is None:
                close(made.client)
            else:
                connection.abort()

    def _respect(self, receive_maximum: int) -> None:
        """See that no more is under way than the broker takes; paho wants to know that before it connects."""
        if self._section.qos and receive_maximum < self._in_flight:
            self._in_flight = receive_maximum
            raise BrokerAway(f"the broker takes {receive_maximum} messages at a time: connecting again by that rule")

    def _begin(self, connection: Connection) -> None:
        log.info("connected to %s", self._section.url)
        self._told = ""
        self._stats.is_connected = True
        self._stats.connects += 1
        self._publisher.owe_everything()
        self._connection = connection
        if self._door is not None:
            connection.listen(_subscriptions(self._root, self._section.version), self._on_heard)

    # What controllers send.

    def _on_heard(self, heard: Heard) -> None:
        """Take one message: a command goes to the door, and so does a heartbeat."""
        door = self._door
        if door is None or not heard.topic.startswith(self._root):
            return
        message = commands.Message(
            tuple(heard.topic.removeprefix(self._root).split("/")), heard.payload, heard.is_retained, heard.expiry
        )
        control = door.controls.get(message.levels[0])
        good_for = control.settings.command_timeout if control is not None else GOOD_FOR
        read = commands.read(message, commands.Moment(self._clock.now(), self._clock.wall(), good_for))
        match read:
            case commands.Beat(drive, source, beat):
                door.beat(drive, source, beat)
            case Command():
                door.submit(read, lambda result: self._respond(heard, result))
            case Result():
                door.tell_result(read)
                self._respond(heard, read)

    def _respond(self, heard: Heard, result: Result) -> None:
        """Answer to the one who asked, where the message names a topic for it (MQTT 5)."""
        connection = self._connection
        if connection is None or not heard.response_topic:
            return
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        if heard.correlation:
            properties.CorrelationData = heard.correlation
        connection.reply(heard.response_topic, commands.result(result, self._clock.wall()), properties)
        connection.wake()

    def _on_result(self, result: Result) -> None:
        self._say(f"{result.command.drive}/{commands.RESULT}", commands.result(result, self._clock.wall()))

    def _on_event(self, drive: str, event: str, reason: str) -> None:
        self._say(f"{drive}/{commands.EVENT}", commands.event(event, reason, self._clock.wall()))

    def _say(self, topic: str, text: str) -> None:
        """Publish something that happened: never retained, and lost while the broker is away."""
        if self._connection is not None:
            self._connection.send(self._root + topic, text, retain=False, expiry=EVENT_EXPIRY)
            self._connection.flush()

    async def _serve(self, connection: Connection) -> None:
        """Send what is owed, a little at a time, and keep the connection alive until it is lost."""
        tend_at = self._clock.now() + TEND_EVERY
        enough = connection.capacity // 2
        while connection.lost is None:
            now = self._clock.now()
            if now >= tend_at:
                tend_at = now + TEND_EVERY
                connection.tend()
            if not self._publisher.is_owing:
                await connection.wait(TEND_EVERY)
            elif connection.room < enough:
                await connection.wait(TEND_EVERY, room=enough)
            else:
                self._publisher.settle(connection, now, STEPS)
                connection.flush()
                await asyncio.sleep(0)
        raise BrokerAway(f"connection lost: {connection.lost}")

    def _on_change(self, image: DriveImage, names: Sequence[str]) -> None:
        """Publish what is news, before the answer's call chain ends."""
        connection = self._connection
        if connection is None:
            return
        try:
            self._publisher.tell(connection, image, names, self._clock.now())
            connection.flush()
        except Exception as error:
            connection.fail(error)
        if self._publisher.is_owing:
            connection.wake()

    async def _leave(self, connection: Connection) -> None:
        """Say that the gateway goes, and disconnect; in bounded time, else the will says it."""
        self._connection = None
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LEAVE_LIMIT):
                self._publisher.leave(connection, self._clock.now())
                connection.flush()
                await connection.leave()


def _connect(section: MqttSection, gateway: str, in_flight: int) -> Made:
    """Connect TCP and TLS and send CONNECT, which blocks; BrokerAway says why not."""
    try:
        reach = access.read(section)  # anew for each connection: secrets and certificates may have been renewed
        client, errors = _make_client(section, gateway, reach)
        client.max_inflight_messages = in_flight
        options: dict[str, Any] = {}
        if section.version == "5":
            options = {"clean_start": True, "properties": _connect_properties()}
        client.connect(reach.host, reach.port, int(section.keep_alive), **options)
        _set_up(client.socket())
    except (OSError, ValueError, BadConfig) as error:
        traceback.clear_frames(error.__traceback__)  # lets go of a socket whose handshake failed; paho does not
        raise BrokerAway(reasons.of_error(str(error))) from error
    return Made(client, errors, _Expiry if section.version == "5" else _no_expiry)


def _make_client(section: MqttSection, gateway: str, reach: access.Access) -> tuple[Client, LastError]:
    is_5 = section.version == "5"
    client = Client(
        CallbackAPIVersion.VERSION2,
        client_id=section.client_id or f"{section.base.replace('/', '-')}-{gateway}",
        clean_session=None if is_5 else True,
        protocol=MQTTProtocolVersion.MQTTv5 if is_5 else MQTTProtocolVersion.MQTTv311,
        reconnect_on_failure=False,  # or paho would reconnect on its own, blocking, from within loop_read
    )
    client.connect_timeout = CONNECT_LIMIT
    client.will_set(topics.status(section.base, gateway), payload.OFFLINE, section.qos, retain=True)
    if reach.user is not None:
        client.username_pw_set(reach.user, reach.password)
    if reach.tls is not None:
        client.tls_set_context(reach.tls)
    errors = LastError()
    client.enable_logger(errors)
    return client, errors


def _subscriptions(root: str, version: str) -> Any:
    """Return what is subscribed; MQTT 5 can ask for no retained messages (SAFETY.md H01)."""
    filters = [f"{root}+/{commands.SET}/+", f"{root}+/{commands.COMMAND}", f"{root}+/{commands.HEARTBEAT}"]
    if version == "5":
        options = SubscribeOptions(qos=1, noLocal=True, retainHandling=SubscribeOptions.RETAIN_DO_NOT_SEND)
        return [(topic, options) for topic in filters]
    return [(topic, 1) for topic in filters]


def _connect_properties() -> Properties:
    """Make the properties of CONNECT: nothing outlives the connection, and what comes in is bounded."""
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


class _Expiry:
    """A message expiry as paho wants it, packed once: Properties would pack it anew for every message."""

    def __init__(self, seconds: int) -> None:
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        properties.MessageExpiryInterval = seconds
        self._packed = properties.pack()  # type: ignore[no-untyped-call]

    def pack(self) -> bytes:
        """Return the bytes on the wire."""
        return cast(bytes, self._packed)


def _no_expiry(_seconds: int) -> None:
    """Make no properties: MQTT 3.1.1 has none."""


async def _in_thread(connect: Callable[[], Made]) -> Made:
    """Connect in a thread of its own: the end of the daemon need not wait for it, as it would for an executor's."""
    loop = asyncio.get_running_loop()
    made: asyncio.Future[Made] = loop.create_future()

    def deliver(result: Made | None, error: BaseException | None) -> None:
        if made.cancelled():
            if result is not None:
                close(result.client)
        elif result is not None:
            made.set_result(result)
        elif error is not None:
            made.set_exception(error)

    def work() -> None:
        result, error = None, None
        try:
            result = connect()
        except BaseException as raised:  # whatever it is, it belongs to the one who waits
            error = raised
        try:
            loop.call_soon_threadsafe(deliver, result, error)
        except RuntimeError:  # the loop is closed: nobody waits any longer
            if result is not None:
                close(result.client)

    threading.Thread(target=work, name="mqtt-connect", daemon=True).start()
    try:
        return await made
    except asyncio.CancelledError:
        if made.done() and not made.cancelled() and made.exception() is None:
            close(made.result().client)  # it was there already when the bridge was told to end
        raise
