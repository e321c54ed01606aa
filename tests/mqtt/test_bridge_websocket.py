"""MQTT over WebSocket against a real Mosquitto: values, commands, TLS, a broker that freezes or is none."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import uvloop

from gateway.control.command import Verb
from gateway.mqtt import socket_loop
from tests.mosquitto import Mosquitto, Subscriber, free_port
from tests.mqtt.certificates import Authority
from tests.mqtt.rig import FREQUENCY, STATUS, Impostor, Log, running
from tests.mqtt.test_bridge import state_of
from tests.mqtt.test_bridge_access import tls_lines
from tests.mqtt.test_bridge_commands import COMMAND, RESULT, ROOT, be_subscribed, commanded, publish

pytestmark = pytest.mark.e2e
NOT_FOUND = b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n"


class WebBroker(Mosquitto):
    """A broker with a listener for WebSockets on `web_port`, besides the plain one."""

    def __init__(self, *more: str) -> None:
        self.web_port = free_port()
        super().__init__("allow_anonymous true", f"listener {self.web_port} 127.0.0.1", "protocol websockets", *more)

    @property
    def url(self) -> str:
        """Return where the gateway finds it."""
        return f"ws://127.0.0.1:{self.web_port}/mqtt"


@pytest.fixture
def broker() -> Iterator[WebBroker]:
    """Run one."""
    with WebBroker() as made:
        yield made


@pytest.mark.parametrize("version", ["5", "3.1.1"])
@pytest.mark.parametrize("qos", [0, 1])
async def test_values_and_commands_come_through(broker: WebBroker, version: str, qos: int) -> None:
    """As they do without; the end is said in order."""
    async with Subscriber(broker.port) as heard:
        async with commanded(0, url=broker.url, version=version, qos=qos) as made:
            await heard.until_payload(STATUS, "online")
            await be_subscribed(broker, made)
            await publish(broker.port, COMMAND, "stop", "-q", "1")
            await heard.until(lambda: bool(heard.on(RESULT)))
            assert [command.verb for command in made.door.submitted] == [Verb.STOP]
        await heard.until_payload(STATUS, "offline")


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("qos", [0, 1])
async def test_a_frozen_broker_costs_no_packet_of_the_stream(broker: WebBroker, qos: int) -> None:
    """A bounded queue; after the thaw the newest of everything is there, on the same connection."""
    async with Subscriber(broker.port) as heard, running(0, url=broker.url, queue=200, qos=qos) as made:
        await heard.until_payload(STATUS, "online")
        broker.freeze()
        word = 0
        while made.stats.dropped < 500:
            word = (word + 1) % 0x8000
            made.read(output_frequency=word, torque=word, status=word & 7)
            assert made.stats.waiting <= 200
            await asyncio.sleep(0)
        broker.thaw()
        await heard.until_payload(f"{ROOT}/pump-1/state", state_of(made))
        await heard.until_payload(FREQUENCY, made.pump.show("output_frequency", word))
        assert made.stats.connects == 1


@pytest.mark.hazard("H24")
async def test_a_flood_over_a_websocket_is_heard_whole(broker: WebBroker) -> None:
    """More than are read at a stretch: the socket is silent about what the WebSocket holds already."""
    many = 20 * socket_loop.READ_AT_ONCE
    async with commanded(0, url=broker.url) as made:
        await be_subscribed(broker, made)
        heard = made.stats.heard
        lines = "".join(f"beat {number}\n" for number in range(many))
        await publish(broker.port, f"{ROOT}/pump-1/heartbeat", "", "-q", "1", lines=lines)
        await made.door.until(lambda: made.stats.heard >= heard + many)


async def test_it_comes_back_after_a_restart_of_the_broker(broker: WebBroker) -> None:
    """With everything as it is by then."""
    async with running(0, url=broker.url) as made:
        async with Subscriber(broker.port) as before:
            await before.until_payload(STATUS, "online")
        broker.kill()
        made.read(output_frequency=1234)
        broker.start()
        async with Subscriber(broker.port) as after:
            await after.until_payload(STATUS, "online")
            await after.until_payload(FREQUENCY, "12.34")


@pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")  # paho lets go of it so
async def test_tls_and_websocket_together(tmp_path: Path) -> None:
    """wss://, verified as ever; nobody's certificate is taken."""
    authority, stranger = Authority(tmp_path), Authority(tmp_path, "stranger")
    lines = tls_lines(authority, "broker", "IP:127.0.0.1", is_client_asked=False)
    with WebBroker(*(line for line in lines if not line.startswith("allow"))) as broker:
        url = broker.url.replace("ws:", "wss:")
        async with Subscriber(broker.port) as heard:
            async with running(0, url=url, tls={"ca": str(authority.certificate)}) as made:
                await heard.until_payload(STATUS, "online")
                for word in range(1, 51):
                    made.read(output_frequency=word, torque=word)
                await heard.until_payload(FREQUENCY, "0.50")
            await heard.until_payload(STATUS, "offline")
            with Log() as log:
                async with running(0, url=url, tls={"ca": str(stranger.certificate)}):
                    await log.until_said("mqtt.tls.ca must hold the authority")


async def test_what_is_no_websocket_is_explained(broker: WebBroker) -> None:
    """The plain listener, a web server, and a WebSocket's listener that is spoken to plainly."""
    with Log() as log:
        async with running(0, url=f"ws://127.0.0.1:{broker.port}"):
            await log.until_said("the port of mqtt.url the broker's listener for WebSockets")
        async with Impostor(NOT_FOUND) as other, running(0, url=f"ws://127.0.0.1:{other.port}/other?x=1"):
            await log.until_said("HTTP 404 Not Found; the path in mqtt.url is not the broker's")
        assert other.heard[0].startswith(b"GET /other?x=1 HTTP/1.1\r\nHost: 127.0.0.1:")


@pytest.mark.parametrize("factory", [asyncio.new_event_loop, uvloop.new_event_loop])
def test_both_event_loops_carry_a_websocket(factory: Callable[[], asyncio.AbstractEventLoop]) -> None:
    """Publishing, and the end."""

    async def play(broker: WebBroker) -> None:
        async with Subscriber(broker.port) as heard:
            async with running(0, url=broker.url) as made:
                made.read(output_frequency=1000)
                await heard.until_payload(FREQUENCY, "10.00")
            await heard.until_payload(STATUS, "offline")

    with WebBroker() as broker, contextlib.closing(factory()) as loop:
        loop.run_until_complete(play(broker))
