"""What the simulation's broker double does is what Mosquitto does: the same tests run against both, 3.1.1 and 5."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any, cast

import pytest

from tests.mosquitto import LIMIT, Mosquitto
from tests.simulation import packets
from tests.simulation.broker import Broker, Message
from tests.simulation.packet_codec import Decoder, encode
from tests.simulation.packets import V5, V311, Filter, Packet, Publish

pytestmark = pytest.mark.e2e
VERSIONS = {"3.1.1": V311, "5": V5}


class Client:
    """A client that speaks packets; what it does not expect fails the test."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, version: int) -> None:
        self.version = version
        self._reader = reader
        self._writer = writer
        self._decoder = Decoder(version)
        self._arrived: list[Packet] = []

    def send(self, *sent: Packet) -> None:
        """Send packets."""
        self._writer.write(b"".join(encode(packet, self.version) for packet in sent))

    def send_bytes(self, data: bytes) -> None:
        """Send anything."""
        self._writer.write(data)

    async def next(self) -> Packet | None:
        """Return the next packet; None where the broker has closed the connection."""
        async with asyncio.timeout(LIMIT):
            while not self._arrived:
                data = await self._reader.read(4096)
                if not data:
                    return None
                self._arrived += self._decoder.feed(data)
        return self._arrived.pop(0)

    async def connect(self, client_id: str, **more: Any) -> packets.Connack:
        """Send CONNECT and return the answer."""
        self.send(packets.Connect(client_id, self.version, **more))
        answer = await self.next()
        assert isinstance(answer, packets.Connack)
        return answer

    async def subscribe(self, *wishes: Filter) -> None:
        """Subscribe, and see it granted."""
        self.send(packets.Subscribe(1, wishes))
        assert await self.next() == packets.Suback(1, tuple(wish.qos for wish in wishes))

    async def message(self) -> Publish:
        """Return the next packet, which has to be a message; one of QoS 1 is acknowledged."""
        packet = await self.next()
        assert isinstance(packet, Publish), packet
        if packet.qos:
            self.send(packets.Puback(packet.packet_id))
        return packet

    async def all_was_said(self) -> None:
        """Fail where anything comes before the answer to a ping."""
        self.send(packets.Pingreq())
        assert await self.next() == packets.Pingresp()

    async def closed(self, code: int = 0) -> None:
        """Wait until the broker has closed; in MQTT 5 it may say why."""
        packet = await self._last()
        if packet is not None and self.version == V5:
            assert isinstance(packet, packets.Disconnect)
            assert packet.code == code
            packet = await self._last()
        assert packet is None

    async def _last(self) -> Packet | None:
        with contextlib.suppress(ConnectionError):
            return await self.next()
        return None

    def break_off(self) -> None:
        """Part without a word."""
        self._writer.transport.abort()

    async def end(self) -> None:
        """Break off, and see it done."""
        self.break_off()
        with contextlib.suppress(OSError):
            await self._writer.wait_closed()


class Bed:
    """A broker on a loopback port."""

    def __init__(self, port: int, version: int) -> None:
        self.version = version
        self._port = port
        self._clients: list[Client] = []

    async def open(self) -> Client:
        """Open a connection."""
        client = Client(*await asyncio.open_connection("127.0.0.1", self._port), self.version)
        self._clients.append(client)
        return client

    async def client(self, client_id: str, **more: Any) -> Client:
        """Connect a client that is welcome."""
        client = await self.open()
        assert (await client.connect(client_id, **more)).code == 0
        return client

    def lasting(self) -> dict[str, Any]:
        """Return what a client says that wants its session to last."""
        more: dict[str, Any] = {"properties": {"session_expiry": 60}} if self.version == V5 else {}
        return {"is_clean": False, **more}

    async def end(self) -> None:
        """Break every connection off."""
        for client in self._clients:
            await client.end()


class Served(asyncio.Protocol):
    """One client of the double over TCP: its bytes, and the way back."""

    def __init__(self, broker: Broker) -> None:
        self._broker = broker
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Hand the connection to the broker."""
        self._transport = cast("asyncio.Transport", transport)
        self._peer = self._broker.accept(self)

    def data_received(self, data: bytes) -> None:
        """Hand on what the client sends."""
        self._peer.feed(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell the broker."""
        self._peer.lost()

    def send(self, data: bytes, message: Message | None) -> None:
        """Send bytes."""
        self._transport.write(data)

    def close(self) -> None:
        """Close behind them."""
        self._transport.close()


@contextlib.asynccontextmanager
async def double() -> AsyncIterator[int]:
    """Serve the double on a port; its time is the loop's."""
    loop = asyncio.get_running_loop()
    broker = Broker(loop.time)

    async def keep_time() -> None:
        while True:
            broker.tick()
            await asyncio.sleep(0.05)

    server = await loop.create_server(lambda: Served(broker), "127.0.0.1", 0)
    clock = asyncio.create_task(keep_time())
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        clock.cancel()
        server.close()


@pytest.fixture(scope="module")
def mosquitto() -> Any:
    """Run one Mosquitto for all tests; each uses topics and client ids of its own."""
    with Mosquitto() as broker:
        yield broker


@pytest.fixture(params=["double", "mosquitto"])
async def bed(request: pytest.FixtureRequest, version: str, mosquitto: Mosquitto) -> AsyncIterator[Bed]:
    """Return a broker that speaks that version."""
    async with contextlib.AsyncExitStack() as stack:
        port = await stack.enter_async_context(double()) if request.param == "double" else mosquitto.port
        made = Bed(port, VERSIONS[version])
        stack.push_async_callback(made.end)
        yield made


@pytest.fixture(params=list(VERSIONS))
def version(request: pytest.FixtureRequest) -> str:
    """Return a version of the protocol."""
    return str(request.param)


@pytest.fixture
def name(request: pytest.FixtureRequest) -> str:
    """Return a first topic level, and a prefix of client ids, that no other test has."""
    return str(request.node.name).translate({ord(sign): "-" for sign in "[]./+#"})


async def test_a_message_reaches_who_wants_it(bed: Bed, name: str) -> None:
    """Both wildcards; nothing else arrives; retain is not set on what was sent just now."""
    plus, hash_, other = [await bed.client(f"{name}-{i}") for i in range(3)]
    await plus.subscribe(Filter(f"{name}/+/command", 1))
    await hash_.subscribe(Filter(f"{name}/a/#", 0))
    await other.subscribe(Filter(f"{name}/b", 1))
    sender = await bed.client(f"{name}-sender")
    sender.send(Publish(f"{name}/a/command", b"run", 0, is_retained=True))
    for client in (plus, hash_):
        got = await client.message()
        assert (got.topic, got.payload, got.qos, got.is_retained) == (f"{name}/a/command", b"run", 0, False)
    await other.all_was_said()


async def test_a_message_of_qos_1_is_acknowledged_and_passed_on_at_most_so(bed: Bed, name: str) -> None:
    """To QoS 1 as such, to QoS 0 without a number."""
    one, zero = await bed.client(f"{name}-1"), await bed.client(f"{name}-0")
    await one.subscribe(Filter(name, 1))
    await zero.subscribe(Filter(name, 0))
    sender = await bed.client(f"{name}-sender")
    sender.send(Publish(name, b"run", 1, packet_id=77))
    answer = await sender.next()
    assert isinstance(answer, packets.Puback)
    assert answer.packet_id == 77
    got = await one.message()
    assert (got.qos, got.is_duplicate) == (1, False)
    assert got.packet_id > 0
    assert (await zero.message()).qos == 0


@pytest.mark.hazard("H01")
async def test_a_retained_message_comes_with_its_flag(bed: Bed, name: str) -> None:
    """At each subscription; an empty one ends that."""
    sender = await bed.client(f"{name}-sender")
    sender.send(Publish(name, b"run", 1, is_retained=True, packet_id=1))
    await sender.next()
    client = await bed.client(f"{name}-late")
    await client.subscribe(Filter(name, 1))
    got = await client.message()
    assert (got.payload, got.is_retained, got.qos) == (b"run", True, 1)
    await client.subscribe(Filter(name, 1))
    assert (await client.message()).is_retained
    sender.send(Publish(name, b"", 1, is_retained=True, packet_id=2))
    await sender.next()
    await client.message()
    await client.subscribe(Filter(name, 1))
    await client.all_was_said()


@pytest.mark.hazard("H01")
@pytest.mark.parametrize("version", ["5"])
async def test_retained_messages_stay_away_where_nobody_asks_for_them(bed: Bed, name: str) -> None:
    """Retain handling 2: never; 1: at the first subscription only."""
    sender = await bed.client(f"{name}-sender")
    sender.send(Publish(name, b"run", 1, is_retained=True, packet_id=1))
    await sender.next()
    never = await bed.client(f"{name}-never")
    await never.subscribe(Filter(name, 1, retain_handling=2))
    await never.all_was_said()
    once = await bed.client(f"{name}-once")
    await once.subscribe(Filter(name, 1, retain_handling=1))
    await once.message()
    await once.subscribe(Filter(name, 1, retain_handling=1))
    await once.all_was_said()


@pytest.mark.parametrize("version", ["5"])
async def test_nobody_hears_himself_who_does_not_want_to(bed: Bed, name: str) -> None:
    """No local."""
    client = await bed.client(name)
    await client.subscribe(Filter(name, 1, is_no_local=True))
    client.send(Publish(name, b"1"))
    await client.all_was_said()


async def test_what_is_unsubscribed_comes_no_more(bed: Bed, name: str) -> None:
    """And in MQTT 5 it is said whether there was a subscription."""
    client, sender = await bed.client(name), await bed.client(f"{name}-sender")
    await client.subscribe(Filter(name, 1))
    client.send(packets.Unsubscribe(2, (name,)))
    answer = await client.next()
    assert isinstance(answer, packets.Unsuback)
    assert answer.packet_id == 2
    sender.send(Publish(name, b"run", 1, packet_id=1))
    await sender.next()
    await client.all_was_said()


async def test_a_client_that_breaks_off_leaves_its_will(bed: Bed, name: str) -> None:
    """One that disconnects takes it along."""
    watcher = await bed.client(f"{name}-watcher")
    await watcher.subscribe(Filter(f"{name}/#", 1))
    will = Publish(f"{name}/status", b"offline", 1, is_retained=True)
    polite = await bed.client(f"{name}-polite", will=will)
    polite.send(packets.Disconnect())
    await polite.closed()
    rude = await bed.client(f"{name}-rude", will=Publish(f"{name}/status", b"gone", 1, is_retained=True))
    rude.break_off()
    assert (await watcher.message()).payload == b"gone"
    late = await bed.client(f"{name}-late")
    await late.subscribe(Filter(f"{name}/status", 0))
    got = await late.message()
    assert (got.payload, got.is_retained) == (b"gone", True)


async def test_the_same_client_id_ends_the_older_connection(bed: Bed, name: str) -> None:
    """Session taken over; the will of the older one is done."""
    watcher = await bed.client(f"{name}-watcher")
    await watcher.subscribe(Filter(f"{name}/status", 1))
    first = await bed.client(name, will=Publish(f"{name}/status", b"gone", 1))
    second = await bed.client(name)
    await first.closed(0x8E)
    assert (await watcher.message()).payload == b"gone"
    await second.all_was_said()


@pytest.mark.hazard("H02")
async def test_nothing_is_kept_for_a_client_with_a_clean_session(bed: Bed, name: str) -> None:
    """Neither its subscriptions nor what came meanwhile."""
    client = await bed.client(name)
    await client.subscribe(Filter(name, 1))
    client.send(packets.Disconnect())
    await client.closed()
    sender = await bed.client(f"{name}-sender")
    sender.send(Publish(name, b"run", 1, packet_id=1))
    await sender.next()
    again = await bed.open()
    assert not (await again.connect(name)).is_session_present
    sender.send(Publish(name, b"run", 1, packet_id=2))
    await sender.next()
    await again.all_was_said()


@pytest.mark.hazard("H02")
async def test_messages_of_qos_1_are_queued_for_a_lasting_session(bed: Bed, name: str) -> None:
    """In their order, and as if they were fresh: why the gateway does not want such a session."""
    client = await bed.client(name, **bed.lasting())
    await client.subscribe(Filter(name, 1))
    client.break_off()
    sender = await bed.client(f"{name}-sender")
    for number, qos in ((1, 1), (2, 0), (3, 1)):
        sender.send(Publish(name, str(number).encode(), qos, packet_id=number if qos else 0))
    assert [await sender.next(), await sender.next()]
    again = await bed.open()
    assert (await again.connect(name, **bed.lasting())).is_session_present
    got = [await again.message(), await again.message()]
    assert [(message.payload, message.is_retained, message.is_duplicate) for message in got] == [
        (b"1", False, False),
        (b"3", False, False),
    ]
    await again.all_was_said()


@pytest.mark.hazard("H03")
async def test_what_was_not_acknowledged_comes_again(bed: Bed, name: str) -> None:
    """With the duplicate flag, under the same number."""
    client = await bed.client(name, **bed.lasting())
    await client.subscribe(Filter(name, 1))
    sender = await bed.client(f"{name}-sender")
    sender.send(Publish(name, b"run", 1, packet_id=1))
    first = await client.next()
    assert isinstance(first, Publish)
    assert not first.is_duplicate
    client.break_off()
    again = await bed.client(name, **bed.lasting())
    second = await again.message()
    assert (second.payload, second.is_duplicate, second.packet_id) == (b"run", True, first.packet_id)


@pytest.mark.parametrize("version", ["5"])
async def test_a_message_that_has_expired_is_not_delivered(bed: Bed, name: str) -> None:
    """One that has not says how long it still lasts."""
    client = await bed.client(name, **bed.lasting())
    await client.subscribe(Filter(name, 1))
    client.break_off()
    sender = await bed.client(f"{name}-sender")
    sender.send(Publish(name, b"old", 1, packet_id=1, properties={"message_expiry": 1}))
    sender.send(Publish(name, b"fresh", 1, packet_id=2, properties={"message_expiry": 100}))
    assert [await sender.next(), await sender.next()]
    await asyncio.sleep(3.2)  # the broker's own time: it counts whole seconds, and looks once in each
    again = await bed.client(name, **bed.lasting())
    got = await again.message()
    assert got.payload == b"fresh"
    assert 95 <= got.properties["message_expiry"] < 100
    await again.all_was_said()


@pytest.mark.parametrize("version", ["5"])
async def test_who_asks_says_where_to_answer(bed: Bed, name: str) -> None:
    """Response topic and correlation data pass unchanged."""
    client, sender = await bed.client(name), await bed.client(f"{name}-sender")
    await client.subscribe(Filter(name, 1))
    asked = {"response_topic": f"{name}/answer", "correlation": b"\x00\xff"}
    sender.send(Publish(name, b"run", 0, properties=asked))
    assert (await client.message()).properties == asked


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("version", ["5"])
async def test_no_more_is_under_way_than_the_client_takes(bed: Bed, name: str) -> None:
    """Receive maximum: the third message waits for an acknowledgement."""
    client = await bed.client(name, properties={"receive_maximum": 2})
    await client.subscribe(Filter(name, 1))
    sender = await bed.client(f"{name}-sender")
    for number in (1, 2, 3):
        sender.send(Publish(name, str(number).encode(), 1, packet_id=number))
        await sender.next()
    first, second = await client.next(), await client.next()
    assert isinstance(first, Publish)
    assert isinstance(second, Publish)
    await client.all_was_said()
    client.send(packets.Puback(first.packet_id))
    assert (await client.message()).payload == b"3"


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("version", ["5"])
async def test_no_packet_is_larger_than_the_client_takes(bed: Bed, name: str) -> None:
    """It is dropped, and the next one comes."""
    client = await bed.client(name, properties={"maximum_packet_size": 200})
    await client.subscribe(Filter(name, 0))
    sender = await bed.client(f"{name}-sender")
    sender.send(Publish(name, b"x" * 300), Publish(name, b"small"))
    assert (await client.message()).payload == b"small"


@pytest.mark.parametrize("version", ["3.1.1"])  # the rule is the same in 5, and Mosquitto takes its time
async def test_a_silent_client_is_given_up(bed: Bed, name: str) -> None:
    """One and a half times its keep-alive; then its will is done."""
    watcher = await bed.client(f"{name}-watcher")
    await watcher.subscribe(Filter(name, 1))
    silent = await bed.client(name, keep_alive=1, will=Publish(name, b"gone", 1))
    assert (await watcher.message()).payload == b"gone"
    await silent.closed(0x8D)


@pytest.mark.parametrize(
    "data",
    [
        b"\x30\x07\x00\x01a",  # no CONNECT first
        b"\x10\x03\x00\x04MQ",
        b"\xf0\x00",
    ],
)
async def test_what_is_no_mqtt_is_not_listened_to(bed: Bed, name: str, data: bytes) -> None:
    """The connection is closed."""
    client = await bed.open()
    client.send_bytes(data + b"\x00" * 8)
    await client.closed()
