"""The bridge to the broker: connects, says what is new at once, and says everything anew after each connect."""

from __future__ import annotations

import asyncio
import logging
import random
import socket
import ssl
from collections.abc import Callable, Sequence
from typing import Any, cast
from urllib.parse import urlsplit

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from gateway.clock import Clock
from gateway.config import MqttSection, Secret
from gateway.errors import BadConfig
from gateway.image import DriveImage, Image, Sample
from gateway.metrics import MqttStats
from gateway.mqtt import payload, topics
from gateway.mqtt.report import Report

log = logging.getLogger("gateway.mqtt")

CONNECT_TIMEOUT = 5.0  # seconds for TCP and TLS
ANSWER_TIMEOUT = 10.0  # seconds for the broker to accept
GOODBYE_TIMEOUT = 2.0  # seconds to say goodbye in
MISC_EVERY = 1.0  # seconds between two looks at the keep-alive
LARGEST_PACKET = 64 * 1024  # bytes that the broker may send in one packet (MQTT 5)
RECEIVE_MAXIMUM = 20  # messages that the broker may have under way (MQTT 5)
STABLE_AFTER = 10.0  # seconds connected, after which the back-off begins anew

REMEDIES = {
    "Bad user name or password": "look at mqtt.user and mqtt.password",
    "Not authorized": "the broker's access list must let this user publish under mqtt.base",
    "Unsupported protocol version": 'set mqtt.version = "3.1.1"',
    "Client identifier not valid": "set mqtt.client_id",
}


class _Outlet:
    """One drive on its way to the broker: its topics and what is news."""

    def __init__(self, image: DriveImage, section: MqttSection, gateway: str) -> None:
        self.image = image
        self.topics = topics.of_drive(section.base, gateway, image)
        self.state = payload.StateWriter(image)
        self._section = section
        self.report = Report(image, section.deadband, section.longest_silence)
        self.late: set[str] = set()  # values that could not be sent when they were news


    def forget(self) -> None:
        """Forget what was published: everything is news again."""
        self.report = Report(self.image, self._section.deadband, self._section.longest_silence)
        self.late.clear()


class Bridge:
    """One broker. Messages go out in the call that brings the news; while the socket is full, the latest wins.

    Nothing is queued for an absent broker: after each connect the whole state is published.
    """

    def __init__(self, section: MqttSection, gateway: str, image: Image, stats: MqttStats, clock: Clock) -> None:
        self._section = section
        self._stats = stats
        self._clock = clock
        self._status = topics.status(section.base, gateway)
        self._outlets = {drive.drive.name: _Outlet(drive, section, gateway) for drive in image.drives}
        self._has_values = "values" in section.publish
        self._has_state = "state" in section.publish
        self._client_id = section.client_id or f"{section.base.replace('/', '-')}-{gateway}"
        self._tls = _tls_context(section) if section.url.startswith("mqtts:") else None
        self._user = section.user.reveal() if isinstance(section.user, Secret) else section.user
        self._password = section.password.reveal() if section.password else None
        self._client = self._make_client()
        self._socket: socket.socket | ssl.SSLSocket | None = None
        self._is_writing = False
        self._answer: asyncio.Future[ReasonCode] | None = None
        self._lost: asyncio.Future[str] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        image.subscribe(self._on_image)

    def _make_client(self) -> paho.Client:
        """Make a paho client for one connection: a used one would send again what an old one left."""
        section = self._section
        version = MQTTProtocolVersion.MQTTv5 if section.version == "5" else MQTTProtocolVersion.MQTTv311
        client = paho.Client(
            CallbackAPIVersion.VERSION2,
            self._client_id,
            clean_session=None if section.version == "5" else True,
            protocol=version,
            reconnect_on_failure=False,
        )
        client.connect_timeout = CONNECT_TIMEOUT
        client.max_queued_messages_set(section.queue)
        client.will_set(self._status, payload.OFFLINE, qos=max(1, section.qos), retain=True)
        if self._user is not None:
            client.username_pw_set(self._user, self._password)
        if self._tls is not None:
            client.tls_set_context(self._tls)
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_socket_close = lambda *_: self._detach()  # before the descriptor is gone
        return client

    # ---- connecting

    async def run(self) -> None:
        """Keep the broker told until cancelled; then say goodbye."""
        self._loop = asyncio.get_running_loop()
        wait = self._section.reconnect_after
        is_told = False
        try:
            while True:
                connected_at = self._clock.now()
                reason = await self._connect()
                if reason is None:
                    is_told = False
                    reason = await self._stay_connected()
                    log.warning("MQTT: connection to %s lost: %s", self._section.url, reason)
                elif not is_told:
                    is_told = True
                    log.warning("MQTT: %s: %s; trying again, silently", self._section.url, reason)
                self._drop()
                if self._clock.now() - connected_at > STABLE_AFTER:
                    wait = self._section.reconnect_after
                await asyncio.sleep(wait * random.uniform(0.75, 1.25))  # noqa: S311  (not all gateways at once)
                wait = min(2 * wait, self._section.reconnect_at_most)
        finally:
            await self._say_goodbye()

    async def _connect(self) -> str | None:
        """Connect; return None, or why not. TCP and TLS block in paho: they run in a thread."""
        loop = asyncio.get_running_loop()
        url = urlsplit(self._section.url)
        port = url.port or (8883 if url.scheme == "mqtts" else 1883)
        options: dict[str, Any] = {}
        if self._section.version == "5":
            properties: Any = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.MaximumPacketSize = LARGEST_PACKET
            properties.ReceiveMaximum = RECEIVE_MAXIMUM
            options = {"clean_start": True, "properties": properties}
        self._answer, self._lost = loop.create_future(), loop.create_future()
        client = self._client = self._make_client()
        ends: list[asyncio.Future[Any]] = [self._answer, self._lost]
        try:
            await loop.run_in_executor(
                None, lambda: client.connect(url.hostname or "", port, int(self._section.keep_alive), **options)
            )
        except (OSError, ValueError) as error:
            return str(error)
        self._attach()
        await asyncio.wait(ends, timeout=ANSWER_TIMEOUT, return_when=asyncio.FIRST_COMPLETED)
        if not any(end.done() for end in ends):
            return "no answer to the connect; is it a broker?"
        if not self._answer.done():
            return f'closed by the broker; if it knows no MQTT 5, set mqtt.version = "3.1.1" ({self._lost.result()})'
        code = self._answer.result()
        if code.is_failure:
            name = code.getName()
            return f"refused: {name}; {REMEDIES.get(name, 'see the log of the broker')}"
        return None

    async def _stay_connected(self) -> str:
        """Publish the whole state, then serve the connection; return why it ended."""
        log.info("MQTT: connected to %s", self._section.url)
        self._stats.is_connected = True
        self._stats.connects += 1
        self._send(self._status, payload.ONLINE, retain=True, qos=max(1, self._section.qos))
        for outlet in self._outlets.values():
            outlet.forget()
            self._publish_drive(outlet)
        self._watch_writing()
        lost = self._lost
        if lost is None:
            raise AssertionError("connected without a connection")
        while True:
            await asyncio.wait([lost], timeout=MISC_EVERY)
            if lost.done():
                return lost.result()
            self._guarded(self._client.loop_misc)
            self._send_late()
            self._watch_writing()

    def _attach(self) -> None:
        self._socket = cast("socket.socket | ssl.SSLSocket | None", self._client.socket())
        if self._socket is not None and self._loop is not None:
            self._loop.add_reader(self._socket, self._readable)
            self._watch_writing()

    def _drop(self) -> None:
        """Let go of the socket, if there is one."""
        self._detach()
        self._client.disconnect()
        left = self._client.socket()
        if left is not None:
            left.close()

    # ---- paho's side; all in the event loop

    def _on_connect(self, _client: Any, _data: Any, _flags: Any, code: ReasonCode, _properties: Any) -> None:
        if self._answer is not None and not self._answer.done():
            self._answer.set_result(code)

    def _on_disconnect(self, _client: Any, _data: Any, _flags: Any, code: ReasonCode, _properties: Any) -> None:
        if self._lost is not None and not self._lost.done():
            self._lost.set_result(code.getName())

    def _detach(self) -> None:
        """Stop watching a socket that paho has closed or is closing."""
        if self._socket is not None and self._loop is not None:
            self._loop.remove_reader(self._socket)
            self._loop.remove_writer(self._socket)
        self._socket, self._is_writing = None, False
        self._stats.is_connected = False

    def _readable(self) -> None:
        self._guarded(self._client.loop_read)
        while isinstance(self._socket, ssl.SSLSocket) and self._socket.pending():
            self._guarded(self._client.loop_read)
        self._watch_writing()

    def _writable(self) -> None:
        self._guarded(self._client.loop_write)
        if not self._client.want_write():
            self._send_late()
        self._watch_writing()

    def _guarded(self, step: Callable[[], MQTTErrorCode]) -> None:
        """Run a step of paho; an error of ours in a callback ends the bridge, and so the process (H18)."""
        try:
            step()
        except Exception as error:
            if self._lost is None or self._lost.done():
                raise
            self._lost.set_exception(error)

    def _watch_writing(self) -> None:
        """Ask to be called when the socket takes more, as long as paho has more."""
        if self._socket is None or self._loop is None:
            return
        wants = self._client.want_write()
        if wants and not self._is_writing:
            self._loop.add_writer(self._socket, self._writable)
        elif not wants and self._is_writing:
            self._loop.remove_writer(self._socket)
        self._is_writing = wants

    # ---- what is published

    def _on_image(self, image: DriveImage, names: Sequence[str]) -> None:
        if not self._stats.is_connected:
            return
        outlet = self._outlets[image.drive.name]
        if names:
            self._publish_values(outlet, names)
        else:
            self._publish_drive(outlet)
        self._watch_writing()

    def _publish_drive(self, outlet: _Outlet) -> None:
        """Publish availability, and whatever of the values is news."""
        self._send(outlet.topics.availability, payload.presence(outlet.image.link.is_connected), retain=True)
        self._publish_values(outlet, outlet.image.names, is_forced=True)

    def _publish_values(self, outlet: _Outlet, names: Sequence[str], *, is_forced: bool = False) -> None:
        now = self._clock.now()
        image, report = outlet.image, outlet.report
        if self._client.want_write():  # the socket is full: the latest goes out when it takes more
            self._stats.dropped += len(names)
            outlet.late.update(names)
            self._stats.waiting = sum(len(other.late) for other in self._outlets.values())
            return
        has_news = is_forced
        for name in names:
            sample = image.sample(name, now)
            if report.is_due(name, sample, now):
                has_news = True
                if self._has_values and not self._publish_value(outlet, name, sample):
                    outlet.late.add(name)
                    continue
                report.note(name, sample, now)
        if has_news and self._has_state:
            self._send(outlet.topics.state, outlet.state.write(now))

    def _publish_value(self, outlet: _Outlet, name: str, sample: Sample) -> bool:
        """Publish a value's topics; False where paho took not all of them."""
        named = outlet.topics.values[name]
        is_sent = self._send(named.value, payload.value(outlet.image, name, sample))
        if named.text is not None:
            is_sent &= self._send(named.text, payload.text(outlet.image, name, sample))
        if outlet.report.has_turned(name, sample.quality):
            is_sent &= self._send(named.quality, sample.quality.word)
        return is_sent

    def _send_late(self) -> None:
        for outlet in self._outlets.values():
            if outlet.late:
                names, outlet.late = tuple(outlet.late), set()
                self._publish_values(outlet, names)
        self._stats.waiting = sum(len(outlet.late) for outlet in self._outlets.values())

    def _send(self, topic: str, text: str, *, retain: bool | None = None, qos: int | None = None) -> bool:
        """Hand a message to paho, which writes it to the socket at once; False where it has too many already."""
        result = self._client.publish(
            topic, text, self._section.qos if qos is None else qos, self._section.retain if retain is None else retain
        )
        is_taken = result.rc == MQTTErrorCode.MQTT_ERR_SUCCESS
        if is_taken:
            self._stats.published += 1
        else:
            self._stats.dropped += 1
        return is_taken

    async def _say_goodbye(self) -> None:
        """Say that the gateway is gone, and disconnect in order, in bounded time."""
        if self._stats.is_connected:
            self._send(self._status, payload.OFFLINE, retain=True, qos=max(1, self._section.qos))
            self._watch_writing()
            end = self._clock.now() + GOODBYE_TIMEOUT
            while self._client.want_write() and self._clock.now() < end:  # noqa: ASYNC110  (paho has no event for it)
                await asyncio.sleep(0.01)
        self._drop()


def _tls_context(section: MqttSection) -> ssl.SSLContext:
    try:
        context = ssl.create_default_context(cafile=section.tls.ca)
        if section.tls.certificate is not None:
            context.load_cert_chain(section.tls.certificate, section.tls.key)
    except (OSError, ssl.SSLError) as error:
        names = f"{section.tls.ca}, {section.tls.certificate}, {section.tls.key}"
        raise BadConfig(f"mqtt.tls: {error} (of {names})") from error
    return context
