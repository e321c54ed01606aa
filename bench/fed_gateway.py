"""A gateway on a real line, in whose event loop a second image is fed with values that change, for another broker.

So the way of a value from the image to the broker is the gateway's own, and what it takes of the loop the line feels;
no set of lines could bring so many values. `python -m bench.fed_gateway LINE.toml FED.toml`: the first is run as a
gateway, of the second only drives and `[mqtt]` are used. Each line of standard input, values a second, sets the pace,
and is answered by what was fed since the last one and what the bridge has counted.
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import uvloop

from gateway import site
from gateway.app import App
from gateway.clock import SystemClock
from gateway.image import DriveImage, Image, LinkState
from gateway.metrics import MqttStats
from gateway.mqtt.bridge import Bridge

STEP = 0.002  # seconds between two turns of the feeder
WORDS = 30_000  # a value counts up to that, by one each time, and begins anew


class Feeder:
    """Drives that are never silent: each answer brings another word for every one of their values."""

    def __init__(self, path: Path) -> None:
        configured = site.load(path)
        self.clock = SystemClock()
        self.image = Image(configured.drives)
        self.stats = MqttStats()
        (section,) = configured.config.brokers
        name = configured.config.gateway.name
        self.bridge = Bridge(section, name, self.image, self.stats, self.clock)
        self.rate = 0.0
        self.fed = 0
        self._turns = self._endless()
        for each in self.image.drives:
            each.set_link(LinkState.ONLINE)

    def _endless(self) -> Iterator[tuple[DriveImage, int]]:
        word = 0
        while True:
            word = word % WORDS + 1
            for each in self.image.drives:
                yield each, word

    async def run(self) -> None:
        """Feed at the pace that is set, what falls behind is caught up.

        The loop has its turn after each answer: on lines each comes by itself, so that no line waits for two.
        """
        owed, before = 0.0, self.clock.now()
        while True:
            await asyncio.sleep(STEP)
            now = self.clock.now()
            owed, before = min(owed + (now - before) * self.rate, self.rate), now  # 0 as soon as the pace is
            while owed >= 1 and self.rate:
                owed -= self._answer()
                await asyncio.sleep(0)

    def _answer(self) -> int:
        image, word = next(self._turns)
        answer = [(point.register.address, word) for point in image.points.values()]
        image.apply(answer, self.clock.now(), self.clock.wall())
        self.fed += len(answer)
        return len(answer)

    async def obey(self, app: App) -> None:
        """Take paces from the standard input, until it ends."""
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        while line := await reader.readline():
            told = {"fed": self.fed, **asdict(self.stats)}
            self.rate = float(line)
            print(json.dumps(told, default=str), flush=True)
        app.end()


async def main(line: Path, fed: Path) -> None:
    """Run both."""
    app, feeder = App(site.load(line)), Feeder(fed)
    tasks = [asyncio.create_task(work) for work in (feeder.bridge.run(), feeder.run(), feeder.obey(app))]
    try:
        await app.run()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


if __name__ == "__main__":
    uvloop.run(main(Path(sys.argv[1]), Path(sys.argv[2])))
