"""Commands by a real Mosquitto, 3.1.1 and 5, and by a played broker that does what none should."""

from __future__ import annotations

import asyncio
import contextlib
import json
import ssl
import time
from collections.abc import AsyncIterator, Callable, Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any, cast

import pytest
import uvloop

from gateway.clock import Clock
from gateway.control.command import Verb
from gateway.control.door import Door
from gateway.image import Image
from gateway.mqtt import outgoing, socket_loop
from gateway.mqtt import uplink as uplink_module
from tests.mosquitto import LIMIT, Mosquitto, Subscriber, program
from tests.mqtt.certificates import Authority
from tests.mqtt.doors import DIRECT, LEASED, KeptDoor, small_site
from tests.mqtt.played import PlayedBroker
from tests.mqtt.rig import GATEWAY, STATUS, Cable, Log, Running, running

pytestmark = pytest.mark.e2e
both_versions = pytest.mark.parametrize("version", ["5", "3.1.1"])
ROOT = f"tosvert/{GATEWAY}"
COMMAND, RESULT = f"{ROOT}/{LEASED}/command", f"{ROOT}/{LEASED}/result"
SPOKEN = {"5": "mqttv5", "3.1.1": "mqttv311"}


class Commanded(Running):
    """A bridge to a door that keeps what comes to it."""

    door: KeptDoor


@contextlib.asynccontextmanager
async def commanded(port: int, *, is_prompt: bool = True, **settings: object) -> AsyncIterator[Commanded]:
    """Run a bridge with the door of the small site, and wait until it is subscribed."""
    doors: list[KeptDoor] = []

    def door(clock: Clock) -> Door:
        doors.append(KeptDoor.small(clock))
        doors[0].is_prompt = is_prompt
        return doors[0]

    async with running(port, Image(small_site().drives), door, **settings) as made:
        found = cast("Commanded", made)
        found.door = doors[0]
        yield found


async def publish(port: int, topic: str, payload: object = "", *options: str, lines: str | None = None) -> None:
    """Publish by mosquitto_pub, and wait until that has ended."""
    text = payload if isinstance(payload, str) else json.dumps(payload)
    message = ["-l"] if lines is not None else (["-m", text] if text else ["-n"])
    process = await asyncio.create_subprocess_exec(
        program("mosquitto_pub"), "-h", "127.0.0.1", "-p", str(port), "-t", topic, *message, *options,
        stdin=asyncio.subprocess.PIPE,
    )  # fmt: skip
    async with asyncio.timeout(LIMIT):
        await process.communicate(None if lines is None else lines.encode())
    assert process.returncode == 0


async def be_subscribed(broker: Mosquitto, made: Commanded) -> None:
    """Wait until a message comes through to the door."""
    for number in range(1000):
        await publish(broker.port, f"{ROOT}/{LEASED}/heartbeat", f"through {number}")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.1):
                await made.door.until(lambda: bool(made.door.beats))
                return
    raise AssertionError("no message came through")


@pytest.fixture
def broker() -> Iterator[Mosquitto]:
    """Run a broker that takes everybody."""
    with Mosquitto() as made:
        yield made


@both_versions
async def test_a_command_comes_through_and_its_result_goes_back(broker: Mosquitto, version: str) -> None:
    """On the drive's topic, never retained."""
    async with Subscriber(broker.port) as heard, commanded(broker.port, version=version) as made:
        await be_subscribed(broker, made)
        await publish(broker.port, COMMAND, {"command": "run", "frequency": "30", "id": "42"}, "-q", "1")
        await heard.until(lambda: bool(heard.on(RESULT)))
        (command,) = made.door.submitted
        assert (command.verb, command.value, command.id) == (Verb.RUN, Decimal(30), "42")
        assert json.loads(heard.on(RESULT)[0])["id"] == "42"
        async with Subscriber(broker.port) as newcomer:
            await newcomer.until(lambda: newcomer.newest().get(STATUS) == "online")
            assert RESULT not in newcomer.newest()


@both_versions
async def test_everybody_can_see_who_may_command(broker: Mosquitto, version: str) -> None:
    """Retained, from the start on, and at every change; taken away when the gateway ends."""
    topic = f"{ROOT}/{LEASED}/control"
    site_door: Callable[[Clock], Door] = lambda clock: Door.of(small_site(), clock)  # noqa: E731
    async with Subscriber(broker.port) as heard:
        async with running(broker.port, Image(small_site().drives), site_door, version=version):
            await heard.until_payload(STATUS, "online")
            before = json.loads(heard.newest()[topic])
            assert before == {
                "mode": "leased", "standing": "disarmed", "reason": "the gateway has started", "owner": None
            }  # fmt: skip
            assert json.loads(heard.newest()[f"{ROOT}/fan-1/control"])["mode"] == "off"
            while not heard.on(RESULT):
                await publish(broker.port, COMMAND, {"command": "take", "source": "hmi"}, "-V", SPOKEN[version])
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(0.1):
                        await heard.until(lambda: bool(heard.on(RESULT)))
            await heard.until(lambda: json.loads(heard.newest()[topic])["owner"] == "mqtt hmi")
            async with Subscriber(broker.port, topic) as newcomer:
                await newcomer.until(lambda: bool(newcomer.messages))
                assert newcomer.messages[0].is_retained
        await heard.until_payload(topic, "")


@pytest.mark.hazard("H01")
async def test_retained_commands_are_not_even_asked_for(broker: Mosquitto) -> None:
    """MQTT 5, at the first connection and at the next."""
    await publish(broker.port, COMMAND, "run", "-r")
    await publish(broker.port, f"{ROOT}/{LEASED}/set/frequency", "30", "-r")
    async with Cable(broker.port) as cable, commanded(cable.port) as made:
        await be_subscribed(broker, made)
        cable.cut()
        made.door.beats.clear()
        await cable.plug()
        await be_subscribed(broker, made)
        assert made.stats.connects == 2
        assert not made.door.submitted
        assert not made.stats.refused


@pytest.mark.hazard("H01")
async def test_retained_commands_are_refused_and_reported(broker: Mosquitto) -> None:
    """MQTT 3.1.1 sends them at every connection."""
    await publish(broker.port, COMMAND, {"command": "run", "id": "7"}, "-r")
    async with (
        Subscriber(broker.port) as heard,
        Cable(broker.port) as cable,
        commanded(cable.port, version="3.1.1") as made,
    ):
        await heard.until(lambda: len(heard.on(RESULT)) == 1)
        cable.cut()
        await cable.plug()
        await heard.until(lambda: len(heard.on(RESULT)) == 2)
        told = [json.loads(text) for text in heard.on(RESULT)]
        assert [(said["status"], said["reason"], said["id"]) for said in told] == [("refused", "retained", "7")] * 2
        assert not made.door.submitted
        assert made.stats.refused == {"retained": 2}


@both_versions
@pytest.mark.hazard("H02")
async def test_what_is_published_while_the_gateway_is_away_is_never_carried_out(
    broker: Mosquitto, version: str
) -> None:
    """Not of QoS 1, and not after a broken connection."""
    async with Cable(broker.port) as cable, commanded(cable.port, version=version) as made:
        await be_subscribed(broker, made)
        cable.cut()
        await publish(broker.port, COMMAND, "run", "-q", "1")
        made.door.beats.clear()
        await cable.plug()
        await be_subscribed(broker, made)
        assert made.stats.connects == 2
        assert not made.door.submitted


@both_versions
@pytest.mark.hazard("H02")
async def test_a_session_that_another_left_behind_brings_no_old_commands(broker: Mosquitto, version: str) -> None:
    """Its client id was that of the gateway, it subscribed to the commands, and the broker kept them for it."""
    lasting = ["-x", "3600"] if version == "5" else []
    options = ["-V", SPOKEN[version], "-i", f"tosvert-{GATEWAY}", "-c", *lasting]
    async with Subscriber(broker.port, f"{ROOT}/+/command", options):
        pass
    await publish(broker.port, COMMAND, "run", "-q", "1")
    async with commanded(broker.port, version=version) as made:
        await be_subscribed(broker, made)
        assert not made.door.submitted


@both_versions
@pytest.mark.hazard("H02")
async def test_a_session_that_is_taken_over_brings_nothing_late(broker: Mosquitto, version: str) -> None:
    """The broker throws the gateway out for another client of its name; it comes back, and begins anew."""
    async with commanded(
        broker.port, version=version, reconnect_after="300ms", reconnect_at_most="300ms"
    ) as made:
        await be_subscribed(broker, made)
        with Log() as log:
            async with Subscriber(broker.port, "#", ["-V", SPOKEN[version], "-i", f"tosvert-{GATEWAY}"]):
                await publish(broker.port, COMMAND, "run", "-q", "1")
                await log.until_said("connection lost")
        made.door.beats.clear()
        await be_subscribed(broker, made)
        assert not made.door.submitted


@both_versions
@pytest.mark.hazard("H02")
async def test_a_command_that_a_stalled_broker_held_back_is_refused_by_its_age(
    broker: Mosquitto, version: str
) -> None:
    """The connections stood, nothing was lost; only `issued` tells."""
    async with Subscriber(broker.port) as heard, commanded(broker.port, version=version) as made:
        await be_subscribed(broker, made)
        asked = {"command": "run", "id": "late", "issued": made.clock.wall()}
        broker.freeze()
        publishing = asyncio.create_task(publish(broker.port, COMMAND, asked, "-q", "1"))
        made.clock.skip(10.0)
        broker.thaw()
        await publishing
        await heard.until(lambda: bool(heard.on(RESULT)))
        result = json.loads(heard.on(RESULT)[0])
        assert (result["id"], result["status"], result["reason"]) == ("late", "refused", "expired")
        assert not made.door.submitted


@both_versions
async def test_a_restarted_broker_brings_commands_again(broker: Mosquitto, version: str) -> None:
    """The gateway subscribes anew."""
    async with commanded(broker.port, version=version) as made:
        await be_subscribed(broker, made)
        broker.stop()
        broker.start()
        made.door.beats.clear()
        await be_subscribed(broker, made)
        await publish(broker.port, COMMAND, "stop")
        await made.door.until(lambda: [command.verb for command in made.door.submitted] == [Verb.STOP])
        assert made.stats.connects == 2


async def test_an_answer_comes_on_the_topic_that_was_asked_for(broker: Mosquitto) -> None:
    """MQTT 5: with the correlation data."""
    async with (
        Subscriber(broker.port, "hmi/answers", ["-V", "mqttv5"]) as heard,
        commanded(broker.port) as made,
    ):
        await be_subscribed(broker, made)
        process = await asyncio.create_subprocess_exec(
            program("mosquitto_sub"), "-h", "127.0.0.1", "-p", str(broker.port), "-V", "mqttv5", "-t", "hmi/answers",
            "-C", "1", "-F", "%D %p", stdout=asyncio.subprocess.PIPE,
        )  # fmt: skip
        properties = ["-D", "publish", "response-topic", "hmi/answers", "-D", "publish", "correlation-data", "q17"]
        await publish(broker.port, COMMAND, {"command": "take", "id": "1"}, "-V", "mqttv5", *properties)
        await heard.until(lambda: bool(heard.messages))
        while process.returncode is None:
            await publish(broker.port, COMMAND, {"command": "take", "id": "2"}, "-V", "mqttv5", *properties)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(process.wait(), 0.1)
        assert process.stdout is not None
        correlation, _, text = (await process.stdout.read()).decode().partition(" ")
        assert correlation == "q17"
        assert json.loads(text)["command"] == "take"
        assert json.loads(heard.messages[0].payload)["id"] == "1"


@pytest.mark.hazard("H11")
async def test_the_brokers_expiry_ends_a_command_sooner(broker: Mosquitto) -> None:
    """MQTT 5: this drive's commands are good for 10 s, this message for 1 s."""
    async with commanded(broker.port, is_prompt=False) as made:
        await be_subscribed(broker, made)
        topic = f"{ROOT}/{DIRECT}/command"
        await publish(broker.port, topic, "arm", "-V", "mqttv5", "-D", "publish", "message-expiry-interval", "1")
        await made.door.until(lambda: bool(made.door.submitted))
        (command,) = made.door.submitted
        assert 0 < command.deadline - command.received <= 1.0


@both_versions
@pytest.mark.hazard("H24")
async def test_a_flood_is_bounded_and_a_stop_gets_through(broker: Mosquitto, version: str) -> None:
    """10,000 commands: few wait, the loop goes on serving, values are published meanwhile."""
    flood = "\n".join(json.dumps({"command": "run", "id": str(number)}) for number in range(10_000))
    async with commanded(broker.port, is_prompt=False, version=version) as made:
        await be_subscribed(broker, made)
        most = longest = 0.0

        async def serve() -> None:
            nonlocal most, longest
            while True:
                before = time.process_time()  # what the machine gives to others meanwhile does not count
                await asyncio.sleep(0)
                longest = max(longest, time.process_time() - before)
                assert made.bridge._listener is not None
                most = max(most, len(made.bridge._listener._intake._inbox))

        serving = asyncio.create_task(serve())
        await publish(broker.port, COMMAND, lines=flood)
        while not any(command.verb is Verb.STOP for command in made.door.submitted):
            await publish(broker.port, COMMAND, "stop", "-q", "1")  # which the broker may drop for a slow reader
        serving.cancel()
        assert most <= 16
        assert longest < 0.5
        assert made.stats.heard > 1_000
        assert len(made.door.submitted) + made.stats.refused["busy"] >= made.stats.heard - len(made.door.beats) - 16
        assert made.stats.untold > 0


@pytest.mark.hazard("H24")
@pytest.mark.parametrize("qos", [0, 1])
async def test_results_for_a_broker_that_does_not_read_are_bounded_and_counted(broker: Mosquitto, qos: int) -> None:
    """Values keep room for some of them, and none are kept for later."""
    async with Subscriber(broker.port) as heard, commanded(broker.port, queue=100, qos=qos) as made:
        await heard.until_payload(STATUS, "online")
        await be_subscribed(broker, made)
        broker.freeze()
        told = made.stats.untold
        for number in range(3_000):
            made.door._tell(LEASED, "armed", f"number {number} {'x' * 1000}")
            if number % 100 == 0:
                await asyncio.sleep(0)
        assert made.stats.untold - told > 1000
        assert made.stats.waiting <= 100 + outgoing.RESERVE
        broker.thaw()
        await heard.until(lambda: bool(heard.on(f"{ROOT}/{LEASED}/event")))


@pytest.mark.hazard("H24")
@both_versions
async def test_a_huge_message_is_not_collected(broker: Mosquitto, version: str) -> None:
    """MQTT 5: the broker keeps it. 3.1.1: the connection is ended for it, and begins anew."""
    with Log() as log:
        async with commanded(broker.port, version=version) as made:
            await be_subscribed(broker, made)
            process = await asyncio.create_subprocess_exec(
                program("mosquitto_pub"), "-h", "127.0.0.1", "-p", str(broker.port), "-t", COMMAND, "-s",
                stdin=asyncio.subprocess.PIPE,
            )  # fmt: skip
            await process.communicate(b"x" * 20_000_000)
            if version == "3.1.1":
                await log.until_said("the broker sent a packet of 2000")
            made.door.beats.clear()
            await be_subscribed(broker, made)
            assert made.stats.connects == (1 if version == "5" else 2)
            assert not made.door.submitted


@pytest.mark.parametrize("factory", [asyncio.new_event_loop, uvloop.new_event_loop])
def test_both_event_loops_carry_commands(factory: Callable[[], asyncio.AbstractEventLoop]) -> None:
    """From the broker to the door and back."""

    async def play(broker: Mosquitto) -> None:
        async with Subscriber(broker.port) as heard, commanded(broker.port, qos=1) as made:
            await be_subscribed(broker, made)
            await publish(broker.port, COMMAND, "stop")
            await heard.until(lambda: bool(heard.on(RESULT)))
            assert json.loads(heard.on(RESULT)[0])["status"] == "done"

    with Mosquitto() as broker, asyncio.Runner(loop_factory=factory) as runner:
        runner.run(play(broker))


async def end_of(made: Commanded, condition: Callable[[], bool]) -> None:
    """Wait until the played broker's messages have done what they do."""
    async with asyncio.timeout(LIMIT):
        while not condition():
            await asyncio.sleep(0.001)


@pytest.mark.hazard("H01")
@pytest.mark.hazard("H03")
async def test_a_broker_that_sends_what_was_not_asked_for_moves_nothing() -> None:
    """Retained messages, deliveries again, topics that are no text, other gateways' commands."""
    async with PlayedBroker() as broker, commanded(broker.port) as made:
        await broker.subscribed.wait()
        topic = COMMAND.encode()
        broker.publish(topic, b"run", retain=True)
        broker.publish(topic, b"run", dup=True)
        broker.publish(b"\xff\xfe/command", b"run")
        broker.publish(b"tosvert/hall-4/pump-1/command", b"run")
        broker.publish(topic, b"run", properties=b"\x02\x00\x00\x00\x00")
        broker.publish(topic, b"stop")
        await made.door.until(lambda: bool(made.door.submitted))
        assert [command.verb for command in made.door.submitted] == [Verb.STOP]
        assert made.stats.refused == {"retained": 1, "expired": 2}
        assert made.stats.ignored == 2


async def test_all_commands_of_a_tls_record_are_heard(tmp_path: Path) -> None:
    """More than are read at a stretch: the socket is silent about what TLS holds already."""
    authority = Authority(tmp_path)
    certificate, key = authority.issue("broker", "IP:127.0.0.1")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(certificate, key)
    many = 5 * socket_loop.READ_AT_ONCE
    async with PlayedBroker(context=context) as broker:
        settings: dict[str, Any] = {
            "url": f"mqtts://127.0.0.1:{broker.port}",
            "tls": {"ca": str(authority.certificate)},
        }
        async with commanded(0, **settings) as made:
            await broker.subscribed.wait()
            broker.send(b"".join(broker.message(COMMAND.encode(), b"stop") for _ in range(many)))
            await made.door.until(lambda: len(made.door.submitted) == many)


@pytest.mark.hazard("H02")
async def test_what_comes_before_the_subscription_is_confirmed_moves_nothing() -> None:
    """A broker that hoards an old session's messages sends them at once."""
    async with PlayedBroker(is_silent=True) as broker, commanded(broker.port) as made:
        await broker.subscribed.wait()
        broker.publish(COMMAND.encode(), b'{"command": "run", "id": "1"}')
        broker.publish(COMMAND.encode(), b"stop")
        await made.door.until(lambda: bool(made.door.submitted))
        assert [command.verb for command in made.door.submitted] == [Verb.STOP]
        assert made.stats.refused == {"expired": 1}
        broker.confirm()
        broker.publish(COMMAND.encode(), b'{"command": "run", "id": "2"}')
        await made.door.until(lambda: len(made.door.submitted) == 2)


@pytest.mark.parametrize(("is_5", "code"), [(True, 0x87), (False, 0x80)])
async def test_a_broker_that_lets_nobody_command_is_told_of(is_5: bool, code: int) -> None:
    """Values are published as ever."""
    with Log() as log:
        async with (
            PlayedBroker(is_5=is_5, code=code) as broker,
            commanded(broker.port, version="5" if is_5 else "3.1.1"),
        ):
            await log.until_said(f"nothing is heard by {ROOT}/+/command")
            await log.until_said("let this user subscribe below mqtt.base")


@pytest.mark.hazard("H01")
@pytest.mark.parametrize(("is_5", "options"), [(True, 0x25), (False, 0x01)])
async def test_every_subscription_asks_for_no_retained_messages(is_5: bool, options: int) -> None:
    """MQTT 5: QoS 1, none of our own, retain handling 2; 3.1.1 knows QoS only."""
    wanted = b"".join(
        len(topic).to_bytes(2, "big") + topic + bytes([options])
        for topic in (f"{ROOT}/{each}".encode() for each in ("+/command", "+/set/+", "+/heartbeat", "line/+/command"))
    )
    async with PlayedBroker(is_5=is_5) as broker, commanded(broker.port, version="5" if is_5 else "3.1.1"):
        await broker.subscribed.wait()
        broker.subscribed.clear()
        broker.break_off()
        await broker.subscribed.wait()
        assert [body[-len(wanted) :] for body in broker.subscriptions] == [wanted, wanted]


async def test_nothing_is_subscribed_where_nothing_may_be_commanded() -> None:
    """A site that is read only listens to nobody."""
    async with PlayedBroker() as broker, running(broker.port) as made:
        await end_of(cast("Commanded", made), lambda: made.stats.is_connected)
        await end_of(cast("Commanded", made), lambda: made.stats.published > 5)
        assert not broker.subscriptions


@pytest.mark.hazard("H18")
async def test_an_error_while_commanding_ends_the_bridge_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is not lost in the event loop's reader."""

    def fail(*_: Any) -> None:
        raise RuntimeError("a bug")

    async with PlayedBroker() as broker, commanded(broker.port) as made:
        await broker.subscribed.wait()
        monkeypatch.setattr(KeptDoor, "submit", fail)
        broker.publish(COMMAND.encode(), b"stop")
        assert made.task is not None
        with pytest.raises(RuntimeError, match="a bug"):
            await made.task


async def test_results_under_way_when_the_connection_breaks_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are lost with it, and not sent by the next one."""
    monkeypatch.setattr(uplink_module, "LEAVE_LIMIT", 0.05)
    async with PlayedBroker() as broker, commanded(broker.port, qos=1) as made:
        await broker.subscribed.wait()
        broker.publish(COMMAND.encode(), b"take")
        await end_of(made, lambda: RESULT.encode() in broker.topics)
        broker.topics.clear()
        broker.subscribed.clear()
        broker.break_off()
        await broker.subscribed.wait()
        broker.publish(COMMAND.encode(), b"stop")
        await end_of(made, lambda: RESULT.encode() in broker.topics)
        assert broker.topics.count(RESULT.encode()) == 1
        assert made.stats.untold == 1
