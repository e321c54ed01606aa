"""Drives that may be commanded: a site whose door only listens, and a simulated line behind a whole server."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway import site
from gateway.bus.worker import LineWorker
from gateway.config import ModbusTcpSection
from gateway.control.command import Answer, Command, Reason, Result, Source, Status, Verb
from gateway.control.door import Door, LineBell
from gateway.control.state import DriveState
from gateway.image import Image, LinkState
from gateway.metrics import LineStats, Stats
from gateway.modbus_tcp.connection import Connection, source_of
from gateway.modbus_tcp.gateway_unit import UNIT
from gateway.modbus_tcp.mirror_map import LINES_AT, MIRROR_AT, ORDERS, PER_DRIVE, Place
from gateway.modbus_tcp.server import ModbusTcpServer
from gateway.sim.journal import Entry, Way
from tests import virtual
from tests.bus.rig import SELECTED, Bench, bench
from tests.modbus_tcp.rig import NOW, StandingClock, Wire, answers, read, request

CONTROL: dict[str, Any] = {
    "control": "leased",
    "sources": ["mqtt", "modbus-tcp"],
    "communication_timeout": "1.5s",
    "timeout_action": "stop",
    "frequency": {"min": 0.0, "max": 60.0},
}
CODES = {order.word: code for code, order in ORDERS.items()}


def mirror(place: Place, index: int = 0) -> int:
    """Return the address of a register of the mirror."""
    return MIRROR_AT + PER_DRIVE * index + place


@dataclass(slots=True)
class ListeningDoor(Door):
    """A door that keeps what it is asked for; see `Listening.end`."""

    asked: list[tuple[Command, Answer]] = field(default_factory=list)
    line_stops: list[tuple[str, Verb, Source, Answer]] = field(default_factory=list)
    beats: list[tuple[str, Source, object]] = field(default_factory=list)

    def submit(self, command: Command, answer: Answer) -> None:
        """Keep a command."""
        self.asked.append((command, answer))

    def stop_line(self, line: str, verb: Verb, source: Source, answer: Answer, number: str = "") -> None:
        """Keep a stop of a line."""
        self.line_stops.append((line, verb, source, answer))

    def beat(self, drive: str, source: Source, beat: object) -> None:
        """Keep a heartbeat."""
        self.beats.append((drive, source, beat))

    def state(self, drive: str) -> DriveState:
        """Return what control knows of a drive."""
        return self.controls[drive].state


SITES: dict[str, site.Site] = {}  # those built before: the catalogue is read once


def site_of(drives: Sequence[dict[str, Any]], lines: int = 1) -> site.Site:
    """Return a site: drives d1, d2 ... of one model, evenly on so many lines."""
    key = repr((drives, lines))
    if key not in SITES:
        SITES[key] = _build(drives, lines)
    return SITES[key]


def _build(drives: Sequence[dict[str, Any]], lines: int) -> site.Site:
    every = [{"name": f"d{i}", "number": i, "model": "vf-nc3", **CONTROL, **more} for i, more in enumerate(drives, 1)]
    share = -(-len(every) // lines)
    table = {
        "gateway": {"name": "t"},
        "line": [
            {"name": "abc"[i], "port": f"/dev/tty{i}", "drive": every[i * share : (i + 1) * share]}
            for i in range(lines)
        ],
    }
    return site.build(table, "test", Path())


class Listening:
    """A whole server in front of a door that only listens."""

    def __init__(self, *drives: dict[str, Any], lines: int = 1) -> None:
        self.clock = StandingClock()
        self.site = site_of(drives or [{}], lines)
        door = ListeningDoor.of(self.site, self.clock)
        assert isinstance(door, ListeningDoor)
        self.door = door
        self.image = Image(self.site.drives)
        for image in self.image.drives:
            image.set_link(LinkState.ONLINE)
        self.stats = Stats(0.0, {"a": LineStats(is_up=True)})
        self.server = ModbusTcpServer(ModbusTcpSection(), self.image, self.stats, self.clock, door=self.door)

    async def end(self, status: Status = Status.DONE, reason: Reason = Reason.NONE) -> Command:
        """End the oldest command that was asked for, and let its answer be sent."""
        command, answer = self.door.asked.pop(0)
        answer(Result(command, status, reason))
        await asyncio.sleep(0)
        return command

    def connect(self, peer: str = "10.0.0.7") -> Master:
        """Open a connection."""
        return Master(self.server._connection(), peer)


class Master(Wire):
    """A client: requests go in, answers are waited for."""

    def __init__(self, connection: Connection, peer: str = "10.0.0.7") -> None:
        super().__init__(peer)
        self.connection = connection
        self.asked = 0
        self._came = asyncio.Event()
        connection.connection_made(self)

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Take an answer."""
        super().write(data)
        self._came.set()

    def send(self, unit: int, pdu: bytes) -> int:
        """Send a request; return its transaction id."""
        self.asked += 1
        self.connection.data_received(request(self.asked, unit, pdu))
        return self.asked

    def told(self, transaction: int) -> bytes | None:
        """Return the PDU that answers a request, if it is there."""
        return next((pdu for number, _, pdu in answers(self.sent) if number == transaction), None)

    async def ask(self, unit: int, pdu: bytes) -> bytes:
        """Send a request and wait for the PDU of its answer."""
        transaction = self.send(unit, pdu)
        while (pdu_told := self.told(transaction)) is None:
            self._came.clear()
            await self._came.wait()
        return pdu_told

    async def write_one(self, unit: int, address: int, word: int) -> int:
        """Write one register by 06H; return 0, or the exception code."""
        return code_of(await self.ask(unit, struct.pack(">BHH", 6, address, word)))

    async def write_words(self, unit: int, address: int, *words: int) -> int:
        """Write registers by 10H; return 0, or the exception code."""
        return code_of(await self.ask(unit, several(address, *words)))

    async def read_words(self, unit: int, start: int, count: int) -> list[int]:
        """Read registers; AssertionError where they cannot be read."""
        told = await self.ask(unit, struct.pack(">BHH", 3, start, count))
        assert told[0] == 3, told.hex()
        return list(struct.unpack(f">{count}H", told[2:]))

    async def order(self, word: str, index: int = 0) -> int:
        """Write one command to the mirror, alone."""
        return await self.write_one(UNIT, mirror(Place.COMMAND, index), CODES[word])

    async def cycle(
        self, word: str, heartbeat: int, frequency: int = 0, number: int = 0, sequence: int = 0, index: int = 0
    ) -> int:
        """Write the five registers of a drive, as a PLC does in each cycle; `word` "" is no command."""
        words = (CODES[word] if word else 0, heartbeat, frequency, number, sequence)
        return await self.write_words(UNIT, mirror(Place.COMMAND, index), *words)

    async def shown(self, place: Place, index: int = 0) -> int:
        """Read one register of the mirror."""
        return (await self.read_words(UNIT, mirror(place, index), 1))[0]


def stop_of(drive: str) -> Command:
    """Return a stop of a drive."""
    return Command(drive, Verb.STOP, source_of(("10.0.0.7",)), 0.0, 1.0)


def several(address: int, *words: int) -> bytes:
    """Make the PDU of 10H."""
    return struct.pack(f">BHHB{len(words)}H", 16, address, len(words), 2 * len(words), *words)


def exchange(start: int, count: int, address: int, *words: int) -> bytes:
    """Make the PDU of 17H."""
    return struct.pack(f">BHHHHB{len(words)}H", 23, start, count, address, len(words), 2 * len(words), *words)


def code_of(pdu: bytes) -> int:
    """Return 0 for a good answer, else the exception code."""
    return pdu[1] if pdu[0] & 0x80 else 0


@dataclass
class Plant:
    """A simulated line of controlled drives, and the server in front of them."""

    bench: Bench
    door: Door
    server: ModbusTcpServer
    written: list[tuple[int, int, int]] = field(default_factory=list)  # number, address, word of each 06H on the line
    results: list[Result] = field(default_factory=list)
    events: list[tuple[str, str, str]] = field(default_factory=list)

    def connect(self, peer: str = "10.0.0.7") -> Master:
        """Open a connection."""
        return Master(self.server._connection(), peer)

    def is_running(self, index: int = 0) -> bool:
        """Say whether a drive has its run command."""
        return self.bench.wire.drives[index].inverter.operation.is_running

    def hear(self, entry: Entry) -> None:
        """Note a frame on the line that writes one register."""
        if entry.way is Way.REQUEST and entry.data[1] == 6:
            self.written.append(struct.unpack_from(">BxHH", entry.data))

    @property
    def hertz(self) -> float:
        """Return how fast the first motor turns."""
        return self.bench.drive.inverter.condition.motor.frequency

    def word(self, name: str) -> int:
        """Return what the first drive holds."""
        return self.bench.drive.inverter.memory.word(name)


def play(
    script: Callable[[Plant], Awaitable[None]], drives: int = 1, control: dict[str, Any] | None = None, **sim: Any
) -> None:
    """Run a script in virtual time against VF-nC3 drives of numbers 1, 2 ... that have been found."""

    async def main() -> None:
        clock = virtual.VirtualClock()
        simulated = [{"number": i, "model": "vf-nc3", "block_read": SELECTED, **sim} for i in range(1, drives + 1)]
        made = bench(simulated, drive={**CONTROL, **(control or {})})
        door = Door.of(made.configured, clock)
        line = made.configured.lines[0]
        worker = LineWorker(
            line, made.image.by_name, made.line_stats, made.drive_stats, clock, made.open, door.controls
        )
        door.connect(LineBell("a", tuple(drive.name for drive in line.drives), worker.ring, worker.announce))
        stats = Stats(clock.wall(), {"a": made.line_stats})
        server = ModbusTcpServer(ModbusTcpSection(), made.image, stats, clock, door=door)
        plant = Plant(made, door, server)
        made.wire.journal.listen(plant.hear)
        door.on_result(plant.results.append)
        door.on_event(lambda *event: plant.events.append(event))
        task = asyncio.create_task(worker.run())
        try:
            await asyncio.sleep(3.0)
            await script(plant)
            assert not task.done()
            assert made.wire.statistics.gap_violations == 0
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    virtual.run(main())


__all__ = ["LINES_AT", "NOW", "UNIT", "Listening", "Master", "Place", "Plant", "mirror", "play", "read"]
