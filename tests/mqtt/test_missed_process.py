"""The gateway killed by SIGKILL while it stores and while it sends what was stored: none of that is lost."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import signal
import subprocess
import sys
import urllib.request
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig
from tests.mosquitto import Mosquitto, Subscriber, free_port
from tests.mqtt.rig import Cable
from tests.processes import LIMIT
from tests.soak import FACTOR

pytestmark = pytest.mark.e2e

STATE = "tosvert/hall-3/pump-1/state"
FILE = """
[gateway]
name = "hall-3"
[mqtt]
url = "mqtt://127.0.0.1:{broker}"
publish = ["state"]
longest_silence = "0s"
reconnect_after = "20ms"
reconnect_at_most = "50ms"
store = {{ rate = 25.0 }}
[web]
listen = "127.0.0.1:{web}"
[[line]]
name = "a"
port = "{port}"
[[line.drive]]
name = "pump-1"
number = 1
model = "vf-nc3"
poll = [{{ values = ["output_frequency"], every = "30ms", max_age = "5s" }}]
"""


class Gateway:
    """The gateway as a process that is killed and started again, and what it counts."""

    def __init__(self, config: Path, web: int) -> None:
        self._command = [sys.executable, "-m", "gateway", "run", str(config)]
        self._web = web
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it."""
        self._process = subprocess.Popen(self._command, stderr=subprocess.DEVNULL)

    def kill(self) -> None:
        """End it without a word."""
        assert self._process is not None
        self._process.send_signal(signal.SIGKILL)
        assert self._process.wait(LIMIT) == -signal.SIGKILL

    def stop(self) -> None:
        """End it in order."""
        assert self._process is not None
        self._process.terminate()
        assert self._process.wait(LIMIT) == 0

    def end(self) -> None:
        """End it where a test has left it running."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait(LIMIT)

    def _read(self, name: str) -> int:
        with contextlib.suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{self._web}/metrics") as page:
            found = re.search(rf"^tosvert_mqtt_backlog_{name} ([\d.e+]+)$", page.read().decode(), re.MULTILINE)
            return int(float(found[1])) if found else -1
        return -1

    async def until(self, name: str, least: int, most: int = 10**9) -> int:
        """Wait until a counter is in between; return it."""
        async with asyncio.timeout(LIMIT):
            while not least <= (count := await asyncio.to_thread(self._read, name)) <= most:
                await asyncio.sleep(0.02)
        return count


@contextlib.asynccontextmanager
async def staged(folder: Path) -> AsyncIterator[tuple[Gateway, Cable, Subscriber]]:
    """Have a line, a broker with a subscriber, and a cable between it and a gateway that is not started."""
    web = free_port()
    line = SimulatedLine(SimulatedLineConfig.model_validate({"drive": [{"number": 1, "model": "vf-nc3"}]}))
    with line, Mosquitto() as broker:
        async with Cable(broker.port) as cable, Subscriber(broker.port, "tosvert/#") as subscriber:
            config = folder / "gateway.toml"
            config.write_text(FILE.format(broker=cable.port, web=web, port=line.port))
            gateway = Gateway(config, web)
            try:
                yield gateway, cable, subscriber
            finally:
                gateway.end()


def numbers(subscriber: Subscriber) -> list[int]:
    """Return the numbers of the history so far, states and perhaps events, by their ids."""
    return [int(each.partition("-")[2]) for each in ids(subscriber)]


def ids(subscriber: Subscriber) -> list[str]:
    """Return the ids of the history so far."""
    history = [message.payload for message in subscriber.messages if "/history/" in message.topic]
    return [json.loads(payload)["id"] for payload in history]


async def test_killed_in_every_phase_it_loses_nothing_that_was_stored(tmp_path: Path) -> None:
    """All of it arrives as history, in order; what is live never goes back, and is never there twice."""
    async with staged(tmp_path) as (gateway, cable, subscriber):
        cable.cut()
        gateway.start()
        first = await gateway.until("kept_total", 30)
        gateway.kill()  # while it stores
        gateway.start()
        stored = first + await gateway.until("kept_total", first)
        gateway.kill()  # while it stores beside what was there
        left = stored
        for _ in range(FACTOR):
            await cable.plug()
            gateway.start()
            left = await gateway.until("waiting", 1, left - 5)
            gateway.kill()  # while it sends, with some of it on its way
            cable.cut()
        await cable.plug()
        gateway.start()
        await subscriber.until(lambda: max(numbers(subscriber)) >= stored)
        await gateway.until("waiting", 0, 0)
        gateway.stop()
    assert set(numbers(subscriber)) >= set(range(1, stored + 1)), "nothing is lost that was stored"
    first_time = list(dict.fromkeys(numbers(subscriber)))
    assert first_time == sorted(first_time), "in order, whatever comes again"
    assert numbers(subscriber).count(1) == 1, "what was acknowledged and let go does not come again"
    times = [json.loads(text)["time"] for text in subscriber.on(STATE)]
    read = [time for time in times if time is not None]
    assert read == sorted(read), "what is live never goes back"
    assert len({each.partition("-")[0] for each in ids(subscriber)}) == 1
    assert not any("historical" in text for text in subscriber.on(STATE))
