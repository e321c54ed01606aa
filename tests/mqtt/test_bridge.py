"""The bridge against a real Mosquitto."""

from __future__ import annotations

import asyncio
import json
import logging
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import uvloop

from gateway.image import LinkState
from gateway.mqtt import client
from gateway.mqtt import connection as connection_module
from gateway.mqtt import uplink as uplink_module
from gateway.mqtt.payload import StateWriter
from gateway.mqtt.publisher import Publisher
from tests.mosquitto import LIMIT, Mosquitto, Subscriber
from tests.mqtt import drives
from tests.mqtt.rig import FREQUENCY, GATEWAY, ROOT, STATUS, Cable, Impostor, Log, Running, running

pytestmark = pytest.mark.e2e
both_versions = pytest.mark.parametrize("version", ["5", "3.1.1"])


def state_of(made: Running) -> str:
    """Return the state as it must come to be on the broker."""
    return StateWriter(made.pump).write(made.clock.now())


@pytest.fixture
def broker() -> Iterator[Mosquitto]:
    """Run a broker that takes everybody."""
    with Mosquitto() as made:
        yield made


@both_versions
async def test_a_newcomer_finds_birth_availability_values_and_state(broker: Mosquitto, version: str) -> None:
    """Everything is retained."""
    async with Subscriber(broker.port) as first, running(broker.port, version=version) as made:
        await first.until_payload(STATUS, "online")
        made.read(output_frequency=6000, torque=0xFFFB, status=0b101, trip_code=1)
        await first.until(lambda: '"output_frequency":60.00' in first.newest()[f"{ROOT}/state"])
        async with Subscriber(broker.port) as second:
            await second.until(lambda: second.newest().keys() >= {STATUS, f"{ROOT}/state", f"{ROOT}/torque"})
            newest = second.newest()
            assert all(message.is_retained for message in second.messages)
    assert newest[STATUS] == "online"
    assert newest[f"{ROOT}/availability"] == "online"
    assert newest[FREQUENCY] == "60.00"
    assert newest[f"{FREQUENCY}/quality"] == "good"
    assert newest[f"{ROOT}/torque"] == "-0.05"
    assert newest[f"{ROOT}/status"] == "5"
    assert newest[f"{ROOT}/status_text"] == "running, tripped"
    assert newest[f"{ROOT}/trip_code_text"] == "OC1: overcurrent during acceleration"
    state = json.loads(newest[f"{ROOT}/state"])
    assert state["output_frequency"] == 60
    assert state["time"].endswith("Z")


@both_versions
@pytest.mark.parametrize("qos", [0, 1, 2])
async def test_every_quality_of_service_brings_every_value_in_order(
    broker: Mosquitto, version: str, qos: int
) -> None:
    """A hundred changes, and a queue that is empty afterwards."""
    async with Subscriber(broker.port) as heard, running(broker.port, version=version, qos=qos) as made:
        await heard.until_payload(STATUS, "online")
        for word in range(1, 101):
            made.read(output_frequency=word)
        await heard.until_payload(FREQUENCY, "1.00")
        numbers = [message for message in heard.messages if message.topic == FREQUENCY and message.payload]
        assert [message.payload for message in numbers] == [f"{word / 100:.2f}" for word in range(1, 101)]
        assert {message.qos for message in numbers} == {qos}
        await heard.until_payload(f"{ROOT}/state", state_of(made))
        assert made.stats.dropped == 0
        await made.stop()
    assert made.stats.waiting == 0


@both_versions
@pytest.mark.hazard("H19")
async def test_a_stale_value_is_cleared_at_the_broker(broker: Mosquitto, version: str) -> None:
    """A newcomer gets the word "stale" and no number."""
    async with Subscriber(broker.port) as heard, running(broker.port, version=version) as made:
        made.read(output_frequency=6000)
        await heard.until_payload(f"{FREQUENCY}/quality", "good")
        made.clock.skip(drives.LONG + 1.0)
        made.image.sweep(made.clock.now())
        await heard.until_payload(f"{FREQUENCY}/quality", "stale")
        await heard.until_payload(FREQUENCY, "")
        async with Subscriber(broker.port) as newcomer:
            await newcomer.until(lambda: f"{FREQUENCY}/quality" in newcomer.newest())
            await newcomer.until(lambda: STATUS in newcomer.newest())
            assert newcomer.newest()[f"{FREQUENCY}/quality"] == "stale"
            assert FREQUENCY not in newcomer.newest()
            assert json.loads(newcomer.newest()[f"{ROOT}/state"])["output_frequency"] is None


async def test_a_lost_drive_is_unavailable(broker: Mosquitto) -> None:
    """And its values are offline."""
    async with Subscriber(broker.port) as heard, running(broker.port) as made:
        made.read(output_frequency=6000)
        await heard.until_payload(FREQUENCY, "60.00")
        made.pump.set_link(LinkState.OFFLINE, "silent")
        await heard.until_payload(f"{ROOT}/availability", "offline")
        await heard.until_payload(FREQUENCY, "")
        await heard.until_payload(f"{FREQUENCY}/quality", "offline")


@both_versions
async def test_a_connection_that_breaks_off_leaves_the_will_and_comes_back(broker: Mosquitto, version: str) -> None:
    """Offline by the broker's word; then everything as it is by then, the birth last."""
    async with (
        Subscriber(broker.port) as heard,
        Cable(broker.port) as cable,
        running(cable.port, version=version) as made,
    ):
        made.read(output_frequency=1000)
        await heard.until_payload(STATUS, "online")
        cable.cut()
        await heard.until_payload(STATUS, "offline")
        made.read(output_frequency=2000)
        heard.messages.clear()
        await cable.plug()
        await heard.until_payload(STATUS, "online")
        assert heard.on(FREQUENCY) == ["20.00"]
        assert heard.messages[-1].topic == STATUS
        assert made.stats.connects == 2


@both_versions
async def test_a_restarted_broker_is_told_everything_again(broker: Mosquitto, version: str) -> None:
    """It kept nothing; it gets the state of now."""
    async with running(broker.port, version=version) as made:
        async with Subscriber(broker.port) as before:
            made.read(output_frequency=1000)
            await before.until_payload(FREQUENCY, "10.00")
        broker.stop()
        made.read(output_frequency=2000)
        broker.start()
        async with Subscriber(broker.port) as after:
            await after.until_payload(STATUS, "online")
            assert after.newest()[FREQUENCY] == "20.00"
            assert after.newest()[f"{ROOT}/availability"] == "online"
        assert made.stats.connects == 2


async def test_a_broker_that_is_away_at_start_is_no_error(broker: Mosquitto) -> None:
    """It is told once, and asked again until it is there; nothing is kept meanwhile."""
    broker.stop()
    with Log() as log:
        async with running(broker.port) as made:
            await log.until(lambda lines: len(lines) >= 4)
            made.read(output_frequency=6000)
            assert len(log.lines(logging.WARNING)) == 1
            assert "Connection refused; nothing listens there" in log.lines()[0]
            assert (made.stats.published, made.stats.waiting, made.stats.dropped) == (0, 0, 0)
            broker.start()
            async with Subscriber(broker.port) as heard:
                await heard.until_payload(STATUS, "online")
                assert heard.newest()[FREQUENCY] == "60.00"


@both_versions
async def test_the_end_is_said_and_the_connection_closed_in_order(broker: Mosquitto, version: str) -> None:
    """Offline for gateway and drives, no number left; the broker has no will to send."""
    async with Subscriber(broker.port) as heard:
        async with running(broker.port, version=version) as made:
            made.read(output_frequency=6000)
            await heard.until_payload(STATUS, "online")
        await heard.until(lambda: '"output_frequency":null' in heard.newest()[f"{ROOT}/state"])
        assert heard.newest()[FREQUENCY] == ""
        await heard.until_payload(STATUS, "offline")
        assert heard.on(STATUS).count("offline") == 1
        assert heard.newest()[f"{ROOT}/availability"] == "offline"
        assert heard.newest()[f"{FREQUENCY}/quality"] == "offline"
    assert not made.stats.is_connected
    broker.stop()  # so that all of its log is there
    assert any(line.endswith(f"Client tosvert-{GATEWAY} disconnected.") for line in broker.log)


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("qos", [0, 1])
async def test_a_frozen_broker_fills_a_bounded_queue_and_then_learns_the_truth(
    broker: Mosquitto, monkeypatch: pytest.MonkeyPatch, qos: int
) -> None:
    """What found no room is counted; after the thaw the newest of it is there, without waiting for a look round."""
    monkeypatch.setattr(uplink_module, "TEND_EVERY", 1e6)
    async with Subscriber(broker.port) as heard, running(broker.port, queue=200, qos=qos) as made:
        await heard.until_payload(STATUS, "online")
        broker.freeze()
        word = 0
        while made.stats.dropped < 500:
            word = (word + 1) % 0x8000
            made.read(output_frequency=word, torque=word, status=word & 7)
            assert made.stats.waiting <= 200
            await asyncio.sleep(0)
        broker.thaw()
        await heard.until_payload(f"{ROOT}/state", state_of(made))
        await heard.until_payload(FREQUENCY, made.pump.show("output_frequency", word))
        await heard.until_payload(f"{ROOT}/torque", made.pump.show("torque", word))
        assert made.stats.connects == 1


async def test_a_bridge_without_room_rests(broker: Mosquitto, monkeypatch: pytest.MonkeyPatch) -> None:
    """It does not ask again and again whether the frozen broker has thawed."""
    asked: list[None] = []
    settle = Publisher.settle

    def counted(*arguments: Any) -> None:
        asked.append(None)
        settle(*arguments)

    async with Subscriber(broker.port) as heard, running(broker.port, queue=200) as made:
        await heard.until_payload(STATUS, "online")
        broker.freeze()
        while not made.stats.dropped:
            made.read(output_frequency=made.stats.published % 0x8000)
        monkeypatch.setattr(Publisher, "settle", counted)
        for _ in range(100):
            await asyncio.sleep(0)
        assert not asked
        broker.thaw()
        await heard.until(lambda: bool(asked))


@pytest.mark.hazard("H24")
async def test_the_end_is_bounded_while_the_broker_is_frozen(
    broker: Mosquitto, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The will says what the gateway cannot."""
    monkeypatch.setattr(uplink_module, "LEAVE_LIMIT", 0.05)
    async with Subscriber(broker.port) as heard:
        async with running(broker.port, queue=100) as made:
            await heard.until_payload(STATUS, "online")
            broker.freeze()
            while not made.stats.dropped:
                made.read(output_frequency=made.stats.published % 0x8000)
            async with asyncio.timeout(LIMIT):
                await made.stop()
        broker.thaw()
        await heard.until_payload(STATUS, "offline")


@pytest.mark.parametrize("factory", [asyncio.new_event_loop, uvloop.new_event_loop])
def test_both_event_loops_carry_it(factory: Callable[[], asyncio.AbstractEventLoop]) -> None:
    """Publishing, a restart of the broker, and the end."""

    async def play(broker: Mosquitto) -> None:
        async with running(broker.port, qos=1) as made:
            made.read(output_frequency=1000)
            async with Subscriber(broker.port) as before:
                await before.until_payload(FREQUENCY, "10.00")
            broker.kill()
            broker.start()
            async with Subscriber(broker.port) as after:
                await after.until_payload(STATUS, "online")
                made.read(output_frequency=2000)
                await after.until_payload(FREQUENCY, "20.00")
                await made.stop()
                await after.until_payload(STATUS, "offline")

    with Mosquitto() as broker, asyncio.Runner(loop_factory=factory) as runner:
        runner.run(play(broker))


@pytest.mark.hazard("H19")
async def test_numbers_carry_an_expiry_to_a_broker_that_knows_it(broker: Mosquitto) -> None:
    """MQTT 5: a gateway that is gone without a word leaves no number for ever."""
    image = drives.image(drives.drive(max_age=10.0))
    async with running(broker.port, image, longest_silence="20s") as made:
        async with Subscriber(broker.port) as heard:
            made.read(output_frequency=6000)
            await heard.until_payload(FREQUENCY, "60.00")
        process = await asyncio.create_subprocess_exec(
            "mosquitto_sub", "-h", "127.0.0.1", "-p", str(broker.port), "-V", "mqttv5", "-t", FREQUENCY,
            "-t", f"{ROOT}/state", "-C", "2", "-F", "%t %E", stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        output, _ = await process.communicate()
    left = dict(line.split(" ") for line in output.decode().splitlines())
    assert 55 <= int(left[FREQUENCY]) <= 60
    assert 55 <= int(left[f"{ROOT}/state"]) <= 60


@pytest.mark.hazard("H24")
async def test_every_connection_starts_clean_and_bounds_what_comes_in() -> None:
    """MQTT 5: clean start, nothing outlives the connection, 20 messages of at most 64 KiB under way; each time."""
    session_ends, few, small = bytes.fromhex("11 00000000"), bytes.fromhex("21 0014"), bytes.fromhex("27 00010000")
    async with Impostor(None) as broker, running(broker.port):
        with Log() as log:
            await log.until(lambda lines: len(lines) >= 2)
        for connect in broker.heard[:2]:
            assert connect[connect.index(b"MQTT") + 5] & 0x02
            assert all(part in connect for part in (session_ends, few, small))


async def test_every_session_of_mqtt_3_is_clean() -> None:
    """Clean session, each time."""
    async with Impostor(None) as broker, running(broker.port, version="3.1.1"):
        with Log() as log:
            await log.until(lambda lines: len(lines) >= 2)
        assert all(connect[connect.index(b"MQTT") + 5] & 0x02 for connect in broker.heard[:2])


def test_small_messages_go_at_once_and_few_wait_in_the_kernel() -> None:
    """A number does not wait for the acknowledgement of the last one; a queue that nobody can bound is short."""
    with socket.socket() as sock:
        client._set_up(sock)
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) <= 2 * client.SEND_BUFFER


@pytest.mark.hazard("H18")
async def test_an_error_while_publishing_ends_the_bridge_with_its_reason(
    broker: Mosquitto, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not the line's task that brought the answer, and not nobody's."""

    def fail(*_: object) -> None:
        raise RuntimeError("a bug")

    async with Subscriber(broker.port) as heard, running(broker.port) as made:
        await heard.until_payload(STATUS, "online")
        monkeypatch.setattr(Publisher, "tell", fail)
        made.read(output_frequency=1)
        assert made.task is not None
        with pytest.raises(RuntimeError, match="a bug"):
            await made.task
        assert not made.stats.is_connected


@pytest.mark.hazard("H18")
@pytest.mark.parametrize(("qos", "callback"), [(1, "acknowledge"), (2, "_on_publish")])
async def test_an_error_while_reading_ends_the_bridge_with_its_reason(
    broker: Mosquitto, monkeypatch: pytest.MonkeyPatch, qos: int, callback: str
) -> None:
    """It is raised from within the event loop's reader, and in a callback of paho."""

    def fail(*_: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(connection_module.Connection, callback, fail)
    async with running(broker.port, qos=qos) as made:
        assert made.task is not None
        with pytest.raises(RuntimeError, match="a bug"):
            await made.task


@pytest.mark.parametrize("qos", [1, 2])
async def test_a_broker_that_takes_few_at_a_time_gets_few(broker: Mosquitto, qos: int) -> None:
    """MQTT 5: its receive maximum counts, from the first message on; else it would disconnect (3.3.4)."""
    with Mosquitto("allow_anonymous true", "max_inflight_messages 3") as few, Log() as log:
        async with Subscriber(few.port) as heard, running(few.port, qos=qos) as made:
            await heard.until_payload(STATUS, "online")
            for word in range(1, 101):
                made.read(output_frequency=word)
            await heard.until_payload(FREQUENCY, "1.00")
            assert not log.lines(logging.WARNING)
            assert made.stats.connects == 1


async def test_a_broker_that_takes_qos_0_alone_hears_of_events(broker: Mosquitto) -> None:
    """MQTT 5: its maximum QoS counts; the connection stays."""
    with Mosquitto("allow_anonymous true", "max_qos 0") as plain, Log() as log:
        async with Subscriber(plain.port) as heard, running(plain.port) as made:
            await heard.until_payload(STATUS, "online")
            made.pump.set_link(LinkState.OFFLINE, "unplugged")
            await heard.until(lambda: f"{ROOT}/event" in heard.newest())
            assert not log.lines(logging.WARNING)
            assert made.stats.connects == 1


async def test_a_message_too_large_for_the_broker_is_left_out_and_said(broker: Mosquitto) -> None:
    """MQTT 5: the values still go."""
    with Mosquitto("allow_anonymous true", "max_packet_size 150") as small, Log() as log:
        async with Subscriber(small.port) as heard, running(small.port) as made:
            await heard.until_payload(STATUS, "online")
            made.read(output_frequency=6000)
            await heard.until_payload(FREQUENCY, "60.00")
            assert f"{ROOT}/state: larger than the 150 bytes" in "\n".join(log.lines(logging.WARNING))
            assert f"{ROOT}/state" not in heard.newest()
            assert made.stats.dropped >= 1
            assert made.stats.connects == 1


async def test_two_gateways_of_one_name_are_told(broker: Mosquitto) -> None:
    """The broker throws the first one out; what may be the reason is said."""
    with Log() as log:
        async with running(broker.port), running(broker.port):
            await log.until_said("another client may have the same client id")


async def test_the_reason_of_a_broker_that_says_one_is_told() -> None:
    """MQTT 5: DISCONNECT with a reason code."""
    accepts = bytes.fromhex("20 03 00 00 00")
    throws_out = bytes.fromhex("e0 02 8e 00")
    with Log() as log:
        async with Impostor(accepts + throws_out) as broker, running(broker.port):
            await log.until_said("Session taken over (reason code 8EH); another client has the same client id")


async def test_nobody_waits_for_a_broker_that_does_not_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A listener that is no broker: bounded, explained, tried again."""
    monkeypatch.setattr(connection_module, "ANSWER_LIMIT", 0.02)
    with Log() as log:
        async with Impostor(b"") as broker, running(broker.port):
            await log.until(lambda lines: len(lines) >= 2)
    assert "no answer within" in log.lines()[0]


@pytest.mark.parametrize(
    ("version", "answer", "words"),
    [
        ("5", None, "closed the connection before it answered; see the broker's log; if it knows no MQTT 5"),
        ("5", "20 02 00 01", 'Unsupported protocol version (reason code 84H); set mqtt.version = "3.1.1"'),
        ("5", "20 03 00 9b 00", "QoS not supported (reason code 9BH); set mqtt.qos lower; a broker has"),
        ("3.1.1", "20 02 00 02", "Client identifier not valid (reason code 85H); set mqtt.client_id"),
        ("3.1.1", "20 02 00 04", "Bad user name or password (reason code 86H); correct mqtt.user and mqtt.password"),
        ("3.1.1", "20 02 00 05", "Not authorized (reason code 87H)"),
        ("3.1.1", "20 02 00 01", "see the broker's log"),
        ("5", "f0 00", "see the broker's log"),
    ],
)
async def test_a_broker_that_refuses_is_explained_and_tried_again(
    version: str, answer: str | None, words: str
) -> None:
    """In words, with what to change."""
    said = None if answer is None else bytes.fromhex(answer)
    with Log() as log:
        async with Impostor(said) as broker, running(broker.port, version=version):
            await log.until(lambda lines: len(lines) >= 2)
    assert words in log.lines()[0]
    assert len(log.lines(logging.WARNING)) == 1


@pytest.mark.filterwarnings("ignore:unclosed <ssl.SSLSocket:ResourceWarning")
async def test_the_end_does_not_wait_for_a_connection_in_the_making() -> None:
    """A TLS handshake that nobody answers blocks a thread, not the end."""
    async with Impostor(b"") as broker, running(0, url=f"mqtts://127.0.0.1:{broker.port}") as made:
        await broker.met.wait()
        async with asyncio.timeout(LIMIT / 10):
            await made.stop()
        assert any(thread.name == "mqtt-connect" for thread in threading.enumerate())
        broker.hang_up()
