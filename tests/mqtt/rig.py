"""What the tests of the bridge share: a running bridge, a cable to cut, and a log to wait for."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import ssl
import threading
from collections.abc import AsyncIterator, Callable

from gateway.backlog import Backlog
from gateway.clock import Clock, SystemClock
from gateway.config import MqttSection
from gateway.control.door import Door
from gateway.image import DriveImage, Image
from gateway.metrics import MqttStats
from gateway.mqtt.bridge import Bridge
from tests.mosquitto import LIMIT
from tests.mqtt import drives

GATEWAY = "hall-3"
STATUS = "tosvert/hall-3/status"
ROOT = "tosvert/hall-3/pump-1"
FREQUENCY = f"{ROOT}/output_frequency"
SOON = {"reconnect_after": "20ms", "reconnect_at_most": "50ms"}


def section(**settings: object) -> MqttSection:
    """Return the settings of a bridge; to a broker that is not asked for, unless they name one."""
    return MqttSection.model_validate({"url": "mqtt://127.0.0.1", **SOON, **settings})


class SkippingClock(SystemClock):
    """The machine's clock, which can be put forward."""

    def __init__(self) -> None:
        self._skipped = 0.0

    def skip(self, seconds: float) -> None:
        """Let time have passed."""
        self._skipped += seconds

    def now(self) -> float:
        """Return monotonic seconds, and what was skipped."""
        return super().now() + self._skipped

    def wall(self) -> float:
        """Return UTC seconds, and what was skipped."""
        return super().wall() + self._skipped


class Running:
    """A bridge at work, and the drives that it tells of."""

    def __init__(
        self,
        port: int,
        image: Image | None = None,
        door: Callable[[Clock], Door] | None = None,
        **settings: object,
    ) -> None:
        self.image = image or drives.image(drives.drive(max_age=drives.LONG))
        self.stats = MqttStats()
        self.clock = SkippingClock()
        made = section(**{"url": f"mqtt://127.0.0.1:{port}", **settings})
        behind = None if door is None else door(self.clock)
        backlog = self.made_backlog()
        self.bridge = Bridge(made, GATEWAY, self.image, self.stats, self.clock, door=behind, backlog=backlog)
        self.task: asyncio.Task[None] | None = None

    def made_backlog(self) -> Backlog | None:
        """Return what keeps what the broker misses; nothing does here."""
        return None

    @property
    def pump(self) -> DriveImage:
        """Return the first drive."""
        return self.image.drives[0]

    def read(self, **words: int) -> None:
        """Read values now."""
        drives.read(self.pump, self.clock.now(), **words)

    def start(self) -> None:
        """Let the bridge run."""
        self.task = asyncio.create_task(self.bridge.run())

    async def stop(self) -> None:
        """Cancel the bridge and wait for its end; an error of its own is raised."""
        assert self.task is not None
        self.task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self.task


@contextlib.asynccontextmanager
async def running(
    port: int, image: Image | None = None, door: Callable[[Clock], Door] | None = None, **settings: object
) -> AsyncIterator[Running]:
    """Run a bridge to the broker on a port."""
    made = Running(port, image, door, **settings)
    made.start()
    try:
        yield made
    finally:
        if made.task is not None and not made.task.done():
            await made.stop()
        for thread in threading.enumerate():
            if thread.name == "mqtt-connect":  # one that was still connecting
                await asyncio.to_thread(thread.join)


class Cable:
    """A TCP relay to the broker that can be cut: both ends see their connection break off, without a word."""

    def __init__(self, broker_port: int) -> None:
        self.port = 0
        self._broker_port = broker_port
        self._server: asyncio.Server | None = None
        self._ends: set[asyncio.StreamWriter] = set()

    async def __aenter__(self) -> Cable:
        await self.plug()
        return self

    async def __aexit__(self, *_: object) -> None:
        self.cut()

    async def plug(self) -> None:
        """Let connections through, on the same port as before."""
        self._server = await asyncio.start_server(self._relay, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    def cut(self) -> None:
        """Break every connection, and take no new one."""
        if self._server is not None:
            self._server.close()
        for writer in self._ends:
            writer.transport.abort()
        self._ends.clear()

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        to_reader, to_writer = await asyncio.open_connection("127.0.0.1", self._broker_port)
        self._ends |= {writer, to_writer}
        await asyncio.gather(_copy(reader, to_writer), _copy(to_reader, writer))


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
    writer.close()


class Impostor:
    """A listener that gives every client the same answer to whatever it says; None: it hangs up at once."""

    def __init__(self, answer: bytes | None, context: ssl.SSLContext | None = None) -> None:
        self.port = 0
        self.met = asyncio.Event()
        self.heard: list[bytes] = []
        self._answer = answer
        self._context = context
        self._writers: list[asyncio.StreamWriter] = []

    async def __aenter__(self) -> Impostor:
        self._server = await asyncio.start_server(self._meet, "127.0.0.1", 0, ssl=self._context)
        self.port = self._server.sockets[0].getsockname()[1]
        return self

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.hang_up()

    def hang_up(self) -> None:
        """Break every connection."""
        for writer in self._writers:
            writer.transport.abort()

    async def _meet(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        self.met.set()
        with contextlib.suppress(OSError):
            self.heard.append(await reader.read(1024))
            if self._answer is None:
                writer.close()
            else:
                writer.write(self._answer)


class Log(logging.Handler):
    """The bridge's log, in which a test can wait for a line."""

    def __init__(self, name: str = "gateway.mqtt") -> None:
        super().__init__(logging.DEBUG)
        self._name = name
        self.records: list[logging.LogRecord] = []
        self._changed = asyncio.Event()

    def __enter__(self) -> Log:
        self._logger = logging.getLogger(self._name)
        self._level = self._logger.level
        self._logger.setLevel(logging.DEBUG)
        self._logger.addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._logger.removeHandler(self)
        self._logger.setLevel(self._level)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record."""
        self.records.append(record)
        self._changed.set()

    def lines(self, level: int = logging.DEBUG) -> list[str]:
        """Return the lines of at least that level."""
        return [record.getMessage() for record in self.records if record.levelno >= level]

    async def until(self, condition: Callable[[list[str]], bool]) -> None:
        """Wait until the lines so far fulfil a condition."""
        try:
            async with asyncio.timeout(LIMIT):
                while not condition(self.lines()):
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            raise AssertionError("waited in vain; the log:\n" + "\n".join(self.lines())) from None

    async def until_said(self, words: str) -> None:
        """Wait until a line has these words in it."""
        await self.until(lambda lines: any(words in line for line in lines))
