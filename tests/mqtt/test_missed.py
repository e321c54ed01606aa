"""Store and forward with a real broker: what it misses is kept, and comes behind what is live, as history."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from gateway.backlog import BacklogStats
from gateway.image import LinkState
from gateway.store.backlog import FiledBacklog
from gateway.store.backlog_schema import Limits
from tests.mosquitto import LIMIT, Mosquitto, Subscriber
from tests.mqtt.rig import FREQUENCY, ROOT, Cable, Running
from tests.store.backlogs import QUICK

pytestmark = pytest.mark.e2e
HISTORY = f"{ROOT}/history/output_frequency"
EVENT = f"{ROOT}/history/event"
LIMITS = Limits(4 * 1024**2, 1e9)  # the rig's readings are of a fixed day
FIRST = 3000  # hundredths of a hertz


class Kept(Running):
    """A bridge with a backlog in a folder."""

    def __init__(self, port: int, folder: Path, **settings: object) -> None:
        self.backlog = FiledBacklog(folder / "backlog.sqlite", LIMITS, BacklogStats(), QUICK)
        super().__init__(port, None, None, **settings)

    def made_backlog(self) -> FiledBacklog:
        """Return the backlog."""
        return self.backlog

    @property
    def is_unsure(self) -> bool:
        """Say whether anything was sent that the broker is not known to have."""
        assert self.bridge._missed is not None
        return self.bridge._missed.is_unsure

    async def read_on(self, first: int, count: int) -> list[str]:
        """Read frequencies one after another; return them as they are published."""
        for word in range(first, first + count):
            self.read(output_frequency=word)
            await asyncio.sleep(0)
        return [f"{word / 100:.2f}" for word in range(first, first + count)]

    async def until(self, holds: Any) -> None:
        """Wait until something holds."""
        async with asyncio.timeout(LIMIT):
            while not holds():
                await asyncio.sleep(0.002)


@contextlib.asynccontextmanager
async def kept(port: int, folder: Path, **settings: object) -> AsyncIterator[Kept]:
    """Run a bridge with a backlog to the broker on a port."""
    made = Kept(port, folder, **settings)
    made.backlog.start()
    made.start()
    try:
        yield made
    finally:
        await made.stop()
        await made.backlog.close()


def values(payloads: list[str]) -> list[str]:
    """Return the numbers of history messages, as they are written."""
    return [json.loads(payload, parse_float=str)["value"] for payload in payloads]


@pytest.mark.parametrize("version", ["5", "3.1.1"])
@pytest.mark.parametrize("qos", [0, 1])
async def test_what_a_broker_misses_comes_as_history(tmp_path: Path, qos: int, version: str) -> None:
    """All of it, in order, marked, not retained, at QoS 1; nothing of it at the topics of the present."""
    with Mosquitto() as broker:
        async with Cable(broker.port) as cable, kept(cable.port, tmp_path, qos=qos, version=version) as running:
            await running.until(lambda: running.stats.is_connected)
            broker.kill()
            await running.until(lambda: not running.stats.is_connected)
            cable.cut()
            missed = await running.read_on(FIRST, 30)
            broker.start()
            async with Subscriber(broker.port, f"{ROOT}/#") as subscriber:
                await cable.plug()
                await subscriber.until(lambda: len(subscriber.on(HISTORY)) == 30)
                await running.until(lambda: running.backlog.stats.waiting == 0)
    assert values(subscriber.on(HISTORY)) == missed
    history = [message for message in subscriber.messages if message.topic == HISTORY]
    assert {(message.is_retained, message.qos) for message in history} == {(False, 1)}
    told = [json.loads(message.payload) for message in history]
    assert all(each["historical"] is True and each["quality"] == "good" for each in told)
    assert [each["time"] for each in told] == sorted(each["time"] for each in told)
    assert len({each["id"] for each in told}) == 30
    assert set(subscriber.on(FREQUENCY)) <= {missed[-1]}, "of the past only the newest is the present"
    assert running.backlog.stats.sent == running.backlog.stats.stored == 30


async def test_live_values_go_first(tmp_path: Path) -> None:
    """After a connect all that is live, then what was missed; a live value overtakes the rest of it."""
    async with with_a_cable(tmp_path, store={"rate": 40.0}) as (running, cable, subscriber):
        cable.cut()
        await running.until(lambda: not running.stats.is_connected)
        await running.read_on(FIRST, 20)
        await running.until(lambda: running.backlog.stats.stored >= 20)
        await cable.plug()
        await subscriber.until(lambda: bool(subscriber.on(HISTORY)))
        assert subscriber.newest()["tosvert/hall-3/status"] == "online"
        before = len(subscriber.on(HISTORY))
        running.read(output_frequency=4500)
        await subscriber.until_payload(FREQUENCY, "45.00")
        assert len(subscriber.on(HISTORY)) <= before + 2
        await subscriber.until(lambda: len(subscriber.on(HISTORY)) == 20)
    topics = [message.topic for message in subscriber.messages]
    first = topics.index(HISTORY)
    assert topics.index(FREQUENCY) < first
    assert topics.index(f"{ROOT}/state") < first
    assert topics.index(f"{ROOT}/availability") < first


@contextlib.asynccontextmanager
async def with_a_cable(folder: Path, **settings: object) -> AsyncIterator[tuple[Kept, Cable, Subscriber]]:
    """Run a bridge with a backlog through a cable, connected, and a subscriber that has none."""
    with Mosquitto() as broker:
        async with (
            Cable(broker.port) as cable,
            Subscriber(broker.port, "tosvert/#") as subscriber,
            kept(cable.port, folder, **settings) as running,
        ):
            await running.until(lambda: running.stats.is_connected)
            yield running, cable, subscriber


@pytest.mark.parametrize("qos", [0, 1])
async def test_what_a_dying_connection_swallows_is_not_lost(tmp_path: Path, qos: int) -> None:
    """Written to the socket, never read by the broker: it is kept when the connection is lost, at QoS 0 as well."""
    with Mosquitto() as broker:
        async with (
            Cable(broker.port) as cable,
            Subscriber(broker.port, "tosvert/#") as subscriber,
            kept(cable.port, tmp_path, qos=qos, keep_alive="1s") as running,
        ):
            await running.until(lambda: running.stats.is_connected)
            await running.read_on(FIRST, 1)
            await subscriber.until_payload(FREQUENCY, "30.00")
            await running.until(lambda: not running.is_unsure)
            broker.freeze()
            swallowed = await running.read_on(FIRST + 1, 5)
            running.pump.set_link(LinkState.OFFLINE, "unplugged")
            await running.until(lambda: not running.stats.is_connected)
            cable.cut()
            broker.kill()
            broker.start()
            async with Subscriber(broker.port, "tosvert/#") as again:
                await cable.plug()
                await again.until(lambda: bool(again.on(EVENT)) and len(again.on(HISTORY)) == 6)
    assert values(again.on(HISTORY)) == [*swallowed, None]
    assert json.loads(again.on(HISTORY)[-1])["quality"] == "offline"
    (event,) = map(json.loads, again.on(EVENT))
    assert (event["event"], event["reason"], event["historical"]) == ("link_lost", "unplugged", True)
    assert running.stats.untold == 0


async def test_what_the_broker_has_is_not_told_again(tmp_path: Path) -> None:
    """Neither after a loss of the connection nor after an end in order."""
    async with with_a_cable(tmp_path) as (running, cable, subscriber):
        told = await running.read_on(FIRST, 10)
        await subscriber.until_payload(FREQUENCY, told[-1])
        await running.until(lambda: not running.is_unsure)
        cable.cut()
        await running.until(lambda: not running.stats.is_connected)
        await cable.plug()
        await running.until(lambda: running.stats.is_connected)
        told += await running.read_on(FIRST + 10, 10)
        await running.stop()
        await subscriber.until_payload("tosvert/hall-3/status", "offline")
        assert running.backlog.stats.stored == running.backlog.stats.waiting == 0
    assert not subscriber.on(HISTORY)
    assert [value for value in dict.fromkeys(subscriber.on(FREQUENCY)) if value] == told
    assert not list(tmp_path.iterdir())


async def test_it_goes_on_where_the_process_before_was_stopped(tmp_path: Path) -> None:
    """What one process has kept the next one sends; states follow `publish`."""
    with Mosquitto() as broker:
        broker.stop()
        async with kept(broker.port, tmp_path) as running:
            missed = await running.read_on(FIRST, 5)
        broker.start()
        async with (
            Subscriber(broker.port, f"{ROOT}/#") as subscriber,
            kept(broker.port, tmp_path, publish=["state"]) as running,
        ):
            await subscriber.until(lambda: len(subscriber.on(f"{ROOT}/history/state")) == 5)
    states = [json.loads(text, parse_float=str) for text in subscriber.on(f"{ROOT}/history/state")]
    assert [state["output_frequency"] for state in states] == missed
    assert all(state["historical"] for state in states)
    assert not subscriber.on(HISTORY)


async def test_a_broker_too_slow_for_all_of_it_gets_the_rest_as_history(tmp_path: Path) -> None:
    """What found no room in the queue while the broker hung comes later."""
    with Mosquitto() as broker:
        async with (
            Subscriber(broker.port, "tosvert/#") as subscriber,
            kept(broker.port, tmp_path, qos=1, queue=100, publish=["values"]) as running,
        ):
            await running.until(lambda: running.stats.is_connected)
            broker.freeze()
            sent = await running.read_on(FIRST, 300)
            broker.thaw()
            await subscriber.until(
                lambda: sent[-1] in subscriber.on(FREQUENCY) and sent[-1] in values(subscriber.on(HISTORY))
            )
    live, history = subscriber.on(FREQUENCY), values(subscriber.on(HISTORY))
    assert history == sorted(history)
    assert {*live, *history} >= set(sent)
    assert 100 < len(history) < 300
