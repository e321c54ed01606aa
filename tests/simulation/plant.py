"""One trial's plant: gateway, line, drives, broker, network and controllers in one world; and how it all can fail."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from random import Random

from gateway.app import App
from gateway.control.ledger import MemoryLedger
from gateway.mqtt.backoff import Backoff
from gateway.sim import settings
from gateway.sim.drive import SimulatedDrive
from gateway.sim.faults import Fault
from tests.simulation import patches
from tests.simulation.broker import Broker
from tests.simulation.controllers import Controller, MqttController, TcpController
from tests.simulation.door_rules import DoorRules
from tests.simulation.line_rules import LineRules
from tests.simulation.links import Network
from tests.simulation.loop import SimulatedClock, SimulatedLoop
from tests.simulation.oracle import Oracle
from tests.simulation.orders import Order
from tests.simulation.port import Port
from tests.simulation.setup import HUNDREDTHS, Setup
from tests.simulation.world import Nap, World

LOOK_EVERY = 0.25  # seconds between two looks at what is shown, and at what waits
BROKER_TICK = 0.5
ENDING = 0.5  # seconds for the gateway to end where it has nothing to stop
LEAST, MOST = 500, 6000  # setpoints in 0.01 Hz
STRIDE = 1009  # from one to the next; it meets all of them before it meets one again
STARTING = 4.0  # seconds for a gateway to get to know its drives; a running one is talked to meanwhile


class Process:
    """One run of the gateway: from its start to its end, however that comes."""

    def __init__(self, plant: Plant, chance: Random) -> None:
        self.app = App(plant.setup.site(), SimulatedClock(plant.world), plant.port.open, plant.ledger)
        for bridge, section in zip(self.app.bridges, self.app.site.config.brokers, strict=True):
            bridge._backoff = Backoff(section.reconnect_after, section.reconnect_at_most, chance)
        self.app.door.on_event(lambda drive, event, reason: plant.on_event(self, drive, event, reason))
        self.is_killed = False
        self.task = asyncio.create_task(self.app.run())
        self.task.add_done_callback(lambda _: plant.on_end(self))


class Plant:
    """Everything. What must not be is in `violations`."""

    def __init__(self, world: World, loop: SimulatedLoop, setup: Setup, seed: str) -> None:
        self.world = world
        self.loop = loop
        self.setup = setup
        self.chance = world.chance("scenario")
        self.violations: list[str] = []
        self.wire = settings.build(setup.line(seed), world.now)
        self.port = Port(world, loop, self.wire)
        self.broker = Broker(lambda: world.now, world.chance("broker"))
        self.network = Network(world, loop, self.broker)
        self.drives: dict[str, SimulatedDrive] = dict(zip(setup.names, self.wire.drives, strict=True))
        self.oracle = Oracle(world, setup, self.tell)
        self.line_rules = LineRules(world, setup, self.oracle, self.tell)
        self.door_rules = DoorRules(world, setup, self.drives, self.tell)
        for name, drive in self.drives.items():
            self.oracle.watch(name, drive)
            self.line_rules.know(name, drive)
        self.wire.journal.listen(self.door_rules.heard)
        self.port.listen(self._on_frame)
        world.before_nap = loop.pipes.serve
        self.port.on_change = self._on_line
        self.process: Process | None = None
        self.ledger = MemoryLedger()  # like a disk, it outlives the gateway's process
        self.controllers: list[Controller] = []
        self.strangers: list[SimulatedDrive] = []
        self._setpoints = self.chance.randrange(1000)
        self._struck = 0
        self._starts = 0

    def tell(self, what: str) -> None:
        """Take note of what must not be."""
        self.world.note("VIOLATION", what)
        self.violations.append(f"at {self.world.now:.3f}: {what}")

    # ---- how a trial runs

    @contextmanager
    def living(self) -> Iterator[None]:
        """Let it all live."""
        with patches.applied(self.world, self.network), self.door_rules.applied():
            self.world.after(LOOK_EVERY, self._look)
            self.world.after(BROKER_TICK, self._tick)
            yield

    def _look(self) -> None:
        self.oracle.look()
        if self.process is not None and not self.process.is_killed:
            self.door_rules.look(self.process.app)
        self.world.after(LOOK_EVERY, self._look)

    def _tick(self) -> None:
        self.broker.tick()
        self.world.after(BROKER_TICK, self._tick)

    async def last(self, seconds: float) -> None:
        """Let so many seconds pass."""
        await asyncio.sleep(seconds)

    async def end(self) -> None:
        """End the gateway in order, and see that nothing is owed to anybody."""
        process = self.process
        if process is not None:
            process.app.stop()
            await asyncio.wait([process.task])
            self.door_rules.ended()
        self.oracle.look()
        for drive in self.strangers:
            if drive.inverter.operation.is_running or drive.inverter.memory.eeprom_writes:
                self.tell(f"a stranger with the number {drive.number} was commanded")
        if self.wire.statistics.gap_violations > self.line_rules.unaware:
            self.tell(f"{self.wire.statistics.gap_violations} frames began before 3.5 characters of silence")
        self.port.sever()
        self.network.sever()

    # ---- what the parts tell

    def _on_frame(self, data: bytes) -> None:
        self.world.note("tx", data.hex())
        self.line_rules.frame(data)

    def _on_line(self) -> None:
        """Take note that something has happened on the line."""
        struck = sum(self.wire.faults.struck.values())
        if struck != self._struck:
            self._struck = struck
            self.oracle.disturb()
        self.oracle.look()

    def on_event(self, process: Process, drive: str, event: str, reason: str) -> None:
        """Take what the gateway tells of a drive."""
        if process is self.process and not process.is_killed:
            self.world.note("event", drive, event, reason)
            self.line_rules.event(drive, event)

    def on_end(self, process: Process) -> None:
        """Take note that a process has ended; nobody may have ended it but we."""
        if not process.is_killed and not process.task.cancelled() and process.task.exception() is not None:
            self.tell(f"the gateway has ended by itself: {process.task.exception()!r}")

    def heard(self, order: Order) -> None:
        """Take a command that is in the gateway's socket."""
        self.oracle.heard(order)
        self.line_rules.heard(order)

    # ---- controllers

    def mqtt(self, source: str) -> MqttController:
        """Add a controller that speaks MQTT."""
        made = MqttController(self.world, self.setup, source, self.heard, self.oracle.beat, self.broker)
        self.controllers.append(made)
        return made

    def tcp(self, address: str) -> TcpController:
        """Add a controller that speaks MODBUS-TCP."""
        made = TcpController(self.world, self.setup, address, self.heard, self.oracle.beat, self.network)
        self.controllers.append(made)
        return made

    def anybody(self, place: int = 0) -> Controller:
        """Add a controller of either kind."""
        return self.mqtt(f"scada-{place}") if self.chance.random() < 0.5 else self.tcp(f"10.0.0.{place + 1}")

    def hertz(self) -> Decimal:
        """Return a frequency that nobody has asked for lately, so that every command can be told by its value."""
        self._setpoints += 1
        return Decimal(LEAST + self._setpoints * STRIDE % (MOST - LEAST)) / HUNDREDTHS

    # ---- the gateway's process

    def start(self) -> None:
        """Start the gateway."""
        self.world.note("start")
        self.world.started = self.world.now
        self.line_rules.started()
        if self._starts:
            self.oracle.end_all()
            self.oracle.extend(STARTING + self.setup.lease)
            self.oracle.disturb()
        self._starts += 1
        self.process = Process(self, self.world.chance(f"process {self._starts}"))

    def kill(self) -> None:
        """End its process without a word (SIGKILL)."""
        process = self.process
        if process is None:
            return
        self.world.note("kill")
        process.is_killed = True
        self.port.sever()
        self.network.sever()
        self.loop.listeners.clear()
        process.task.cancel()
        self.door_rules.asked.clear()
        self.oracle.disturb()
        self.process = None

    def restart(self, seconds: float) -> None:
        """Kill it, and start it again so long afterwards."""
        if self.process is not None:
            self.kill()
            self.world.after(seconds, self.start)

    def terminate(self) -> None:
        """Ask it to end in order (SIGTERM): what runs is to be stopped, or left to its own time-out."""
        if self.process is not None:
            self.world.note("terminate")
            self.oracle.is_left = self.setup.on_exit == "hold"
            self.oracle.end_all(ENDING if self.oracle.is_left else 0.0)
            self.process.app.stop()

    def set_clock(self, seconds: float) -> None:
        """Put the machine's clock forward, or back."""
        self.world.note("clock", seconds)
        self.world.wall_offset += seconds

    def freeze(self, seconds: float) -> None:
        """Let it stand still for so long (SIGSTOP, SIGCONT)."""
        self.oracle.disturb()
        self.world.freeze(seconds)
        self.world.after(seconds, self.oracle.disturb)

    def nap(self, seconds: float) -> None:
        """Let it stand still in the midst of what it does: when it looks at the clock, some time from now."""
        self.oracle.disturb()
        self.world.naps.append(Nap(seconds, self.chance.randrange(1, 40), is_before=self.chance.random() < 0.5))
        self.world.after(seconds + 2.0, self.oracle.disturb)

    # ---- the line and its drives

    def fault(self, fault: Fault) -> None:
        """Let a fault of the line begin."""
        self.world.note("fault", fault.kind.value, fault.probability)
        self.wire.faults.add(fault)

    def unplug(self, seconds: float) -> None:
        """Pull the adapter out, and put it back later."""
        if not self.port.is_plugged:
            return
        self.oracle.disturb()
        self.port.unplug()
        self.line_rules.forgotten()

        def back() -> None:
            self.oracle.disturb()
            self.port.plug()

        self.world.after(seconds, back)

    def shake(self, name: str) -> None:
        """Take note that a drive loses what it was told."""
        self.oracle.disturb()
        self.door_rules.undone[name] = self.world.now
        self.line_rules.forgotten(name)

    def power_cycle(self, name: str, off: float) -> None:
        """Switch a drive off for so long, and on again."""
        self.world.note("power cycle", name, off)
        self.drives[name].inverter.reset(self.world.now, off=off)
        self.shake(name)
        self.oracle.look()

    def trip(self, name: str, code: int) -> None:
        """Trip a drive."""
        self.world.note("trip", name, code)
        self.drives[name].tick(self.world.now)
        self.drives[name].inverter.trip(code)
        self.oracle.disturb()
        self.door_rules.undone[name] = self.world.now
        self.oracle.look()

    def swap(self, name: str, away: float) -> None:
        """Switch a drive off for good, and put one of another model on the line in its place, running or not."""
        self.world.note("swap", name, away)
        place = self.setup.names.index(name)
        self.drives[name].inverter.switch_off(self.world.now)
        self.shake(name)

        def put() -> None:
            made = settings.build(self.setup.but(model="vf-mb1").line(name), self.world.now).drives[place]
            self.wire.drives[place] = made
            self.drives[name] = made
            self.oracle.watch(name, made)
            self.shake(name)
            self.strangers.append(made)

        self.world.after(away, put)
