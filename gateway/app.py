"""Builds everything from the site, runs it as one task group, and ends it in order."""

from __future__ import annotations

import asyncio
import gc
import logging
import signal
from collections.abc import Callable, Coroutine
from typing import Any

from gateway import __version__, systemd
from gateway.broker_certificates import Watches
from gateway.bus.line import Opener
from gateway.bus.serial_line import open_line
from gateway.bus.worker import LineWorker
from gateway.clock import Clock, SystemClock
from gateway.config import BrokerSection, MqttSection, SparkplugSection
from gateway.control.command import Result
from gateway.control.door import Door, LineBell
from gateway.control.ledger import Ledger
from gateway.errors import CoreTaskEnded, GatewayError
from gateway.image import Image, LinkState
from gateway.metrics import DriveStats, LineStats, MqttStats, Stats
from gateway.modbus_tcp.server import ModbusTcpServer
from gateway.mqtt.bridge import Bridge
from gateway.site import Site
from gateway.sparkplug.edge import EdgeNode
from gateway.store.backlog import FiledBacklog
from gateway.store.store import Store
from gateway.trace.tracing import Tracing
from gateway.web.server import WebServer

log = logging.getLogger("gateway")

SWEEP_EVERY = 0.1  # seconds between two looks for values that turned stale
LEAVE_WITHIN = 4.0  # seconds for drives to be seen to stop when the gateway ends
LEAVE_STEP = 0.02
RATES_EVERY = 1.0  # seconds over which load and exchanges per second are counted


class App:
    """One gateway. Parts that touch the world can be replaced: the clock, how a line is opened, and the ledger.

    `load` reads the configuration anew at SIGHUP; `successor` is then the site to go on with after `run`.
    `tracing` is told of every frame.
    """

    def __init__(
        self,
        site: Site,
        clock: Clock | None = None,
        opener: Opener = open_line,
        ledger: Ledger | None = None,
        load: Callable[[], Site] | None = None,
        tracing: Tracing | None = None,
    ) -> None:
        self.site = site
        self.successor: Site | None = None
        self.has_started = False  # all its ports were to be had
        self.clock = clock or SystemClock()
        self.store = Store.of(site, self.clock) if ledger is None else None
        self._load = load
        self._tracing = tracing
        self._loading: asyncio.Task[None] | None = None
        self._is_ending = False
        self.image = Image(site.drives)
        self.stats = Stats(started=self.clock.wall())
        self.stats.lines = {line.name: LineStats() for line in site.lines}
        self.stats.drives = {drive.name: DriveStats() for drive in site.drives}
        config = site.config
        self.door = Door.of(site, self.clock, ledger or self.store)
        self.workers = [
            LineWorker(
                line,
                self.image.by_name,
                self.stats.lines[line.name],
                self.stats.drives,
                self.clock,
                opener,
                self.door.controls,
                self.door.ledger.note,
                tracing.tap(line.name) if tracing is not None else None,
            )
            for line in site.lines
        ]
        for name, control in self.door.controls.items():
            self.stats.drives[name].standing = control.standing.value
        self.door.on_event(self._count_event)
        self.door.on_result(self._count_result)
        if tracing is not None:
            tracing.watch(self.image)
            self.door.on_event(tracing.on_event)
        for line, worker in zip(site.lines, self.workers, strict=True):
            self.door.connect(LineBell(line.name, tuple(d.name for d in line.drives), worker.ring, worker.announce))
        self._keeps_backlogs = ledger is None  # who brings a ledger keeps what is kept
        self.backlogs: list[FiledBacklog] = []
        self.stats.brokers = {section.origin: MqttStats() for section in config.brokers}
        self.bridges = [self._bridge(section) for section in config.brokers]
        self.edge_node = self._edge_node(config.sparkplug) if config.sparkplug else None
        self.modbus_tcp = (
            ModbusTcpServer(config.modbus_tcp, self.image, self.stats, self.clock, door=self.door)
            if config.modbus_tcp
            else None
        )
        self.web = (
            WebServer(config.web, self.image, self.stats, site, self.clock, self.door.ledger) if config.web else None
        )
        self._certificates = Watches(config, self.stats, self.clock)
        self._stop = asyncio.Event()

    def _bridge(self, section: MqttSection) -> Bridge:
        stats, name = self.stats.brokers[section.origin], self.site.config.gateway.name
        backlog = self._backlog(section, stats)
        return Bridge(section, name, self.image, stats, self.clock, door=self.door, backlog=backlog)

    def _edge_node(self, section: SparkplugSection) -> EdgeNode:
        stats, name = self.stats.sparkplug, self.site.config.gateway.name
        backlog = self._backlog(section, stats)
        return EdgeNode(
            section, name, self.image, stats, self.clock, door=self.door, keeper=self.store, backlog=backlog
        )

    def _backlog(self, section: BrokerSection, stats: MqttStats) -> FiledBacklog | None:
        """Make what keeps readings for a broker while it is away; each has its own, as each is away alone."""
        if not (section.store.enabled and self._keeps_backlogs):
            return None
        made = FiledBacklog.of(self.site, section, stats.missed)
        self.backlogs.append(made)
        return made

    def _count_event(self, drive: str, event: str, _reason: str) -> None:
        self.stats.drives[drive].events[event] += 1
        self.stats.drives[drive].standing = self.door.controls[drive].standing.value

    def _count_result(self, result: Result) -> None:
        drive = self.stats.drives.get(result.command.drive)
        if drive is not None:
            drive.commands[result.status.value, result.reason.value] += 1

    def stop(self) -> None:
        """Ask the running gateway to end in order."""
        self._stop.set()

    def end(self) -> None:
        """End for good: no reload that is under way takes over (SIGTERM, SIGINT)."""
        self._is_ending, self.successor = True, None
        self.stop()

    def reload(self) -> None:
        """Read the configuration anew: a right one takes over whole, a wrong one changes nothing (SAFETY.md H34)."""
        if self._load is not None and (self._loading is None or self._loading.done()):
            self._loading = asyncio.create_task(self._take_over(self._load))

    async def _take_over(self, load: Callable[[], Site]) -> None:
        if self.modbus_tcp is not None:
            self.modbus_tcp.renew()  # certificates may have changed though the configuration has not
        try:
            successor = await asyncio.to_thread(load)
        except GatewayError as error:
            log.error("not reloaded, the gateway goes on as it was: %s", error)
            return
        if self._is_ending:
            return
        if successor == self.site:
            log.info("not reloaded: nothing has changed")
            return
        log.info("reloading: every drive is disarmed, `on_exit` is done, and all begins anew")
        self.successor = successor
        self.stop()

    async def run(self) -> None:
        """Run until `stop`, SIGTERM or SIGINT; GatewayError says what keeps it from starting or made it end."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.end)
        if self._load is not None:
            loop.add_signal_handler(signal.SIGHUP, self.reload)
        servers = [server for server in (self.modbus_tcp, self.web) if server is not None]
        started = []
        if self.store is not None:
            self.store.start()
        for backlog in self.backlogs:
            backlog.start()
        if self._tracing is not None:
            loop.add_signal_handler(signal.SIGUSR1, self._tracing.write_now)
            await self._tracing.start()
        try:
            for server in servers:
                await server.start()
                started.append(server)
            self.has_started = True
            await self._run_tasks()
        finally:
            systemd.notify("STOPPING=1")
            try:
                for server in reversed(started):
                    await server.stop()
            finally:
                if self._tracing is not None:
                    await self._tracing.stop()
                for backlog in self.backlogs:
                    await backlog.close()
                if self.store is not None:
                    await self.store.close()

    async def _run_tasks(self) -> None:
        """Run the core tasks together; the first that ends, ends them all: lines first, so that MQTT can say so."""
        lines = [
            _start(f"line {line.name}", worker.run())
            for line, worker in zip(self.site.lines, self.workers, strict=True)
        ]
        others = [_start("housekeeping", self._keep_house())]
        for bridge in self.bridges:
            others.append(_start(f"mqtt {bridge.name}".strip(), bridge.run()))
        if self._tracing is not None:
            others.append(_start("trace", self._tracing.run()))
        if self.edge_node is not None:
            others.append(_start("sparkplug", self.edge_node.run()))
        stop = asyncio.create_task(self._stop.wait())
        gc.collect()
        gc.freeze()  # what lives for ever is not searched again while a line waits
        systemd.notify("READY=1")
        log.info("tosvert-gateway %s: %d lines, %d drives", __version__, len(self.site.lines), len(self.site.drives))
        try:
            done, _ = await asyncio.wait([*lines, *others, stop], return_when=asyncio.FIRST_COMPLETED)
            if stop in done or not all(line.done() for line in lines):
                await self._leave()  # also where a part has failed: what the lines can still stop, they do
        finally:
            for tasks in (lines, [*others, stop]):
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
        for task in done - {stop}:
            await task
        log.info("ended in order")

    async def _leave(self) -> None:
        """Stop what `on_exit` wants stopped, and see that it does, before any port is closed (SAFETY.md H13).

        A trial of an exchange comes to its end too: its words are not left behind in a drive.
        """
        self.door.leave()
        until = self.clock.now() + LEAVE_WITHIN
        while not self._is_settled and self.clock.now() < until:  # noqa: ASYNC110 - the lines settle it
            await asyncio.sleep(LEAVE_STEP)
        if not self.door.is_settled:
            log.warning("not every drive was seen to stop; their own communication time-outs have to act")

    @property
    def _is_settled(self) -> bool:
        return self.door.is_settled and all(worker.is_settled for worker in self.workers)

    async def _keep_house(self) -> None:
        """Find what turned stale, count rates, tell the service manager that the loop is alive."""
        watchdog = systemd.watchdog_interval()
        next_rates = next_pat = self.clock.now()
        before = dict.fromkeys(self.stats.lines, (0, 0.0))
        while True:
            now = self.clock.now()
            self.door.pulse()
            self.image.sweep(now)
            self._certificates.pulse()
            if now >= next_rates:
                before = self._count_rates(before, now - next_rates + RATES_EVERY)
                next_rates = now + RATES_EVERY
            if watchdog is not None and now >= next_pat:
                systemd.notify(f"WATCHDOG=1\nSTATUS={self.status()}")
                next_pat = now + watchdog / 3
            await asyncio.sleep(SWEEP_EVERY)

    def _count_rates(self, before: dict[str, tuple[int, float]], elapsed: float) -> dict[str, tuple[int, float]]:
        for name, line in self.stats.lines.items():
            exchanges, busy = before[name]
            line.rate = (line.exchanges - exchanges) / elapsed
            line.load = min(1.0, (line.busy - busy) / elapsed)
        return {name: (line.exchanges, line.busy) for name, line in self.stats.lines.items()}

    def status(self) -> str:
        """Say in one line how things stand."""
        online = sum(image.link is LinkState.ONLINE for image in self.image.drives)
        up = sum(line.is_up for line in self.stats.lines.values())
        return f"{up} of {len(self.stats.lines)} lines up, {online} of {len(self.image.drives)} drives online"


def _start(name: str, work: Coroutine[Any, Any, None]) -> asyncio.Task[Any]:
    """Start a core task: when it ends by itself, that is an error."""

    async def for_ever() -> None:
        await work
        raise CoreTaskEnded(f"task {name!r} has ended, which it never should")

    return asyncio.create_task(for_ever(), name=name)
