"""A server on a free port over the image of the rig, and what a process has of descriptors and memory."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

from gateway.config import MapSection, ModbusTcpSection
from gateway.control.command import Source
from gateway.image import Image
from gateway.metrics import LineStats, Stats
from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.requests import Malformed, parse
from gateway.modbus_tcp.server import ModbusTcpServer
from gateway.modbus_tcp.session import Reply
from tests.modbus_tcp.rig import StandingClock, fresh_image

MAPPED = [
    MapSection(point="pump-1.output_frequency", address=0, type="float32"),
    MapSection(point="pump-1.torque", address=2, type="int32", scale=1000, word_order="little"),
]


class Served(ModbusTcpServer):
    """A server on a free port over the image of the rig, by a clock that stands."""

    def __init__(self, image: Image | None = None, port: int = 0) -> None:
        self.clock = StandingClock()
        self.stats = Stats(0.0, {"a": LineStats()})
        section = ModbusTcpSection(listen=f"127.0.0.1:{port}", map=MAPPED)
        super().__init__(section, image or fresh_image(), self.stats, self.clock)

    def obey(self, *units: int) -> None:
        """Let every write to these units be carried out."""
        self._reception.free_writers.update((unit, Obeying()) for unit in units)


@contextlib.asynccontextmanager
async def serving() -> AsyncIterator[Served]:
    """Run a server."""
    server = Served()
    await server.start()
    try:
        yield server
    finally:
        await server.stop()


@dataclass
class Obeying:
    """Takes every write and says at once that it is done; 17H reads words that count from 1."""

    def write(self, pdu: bytes, _source: Source, reply: Reply) -> float:
        """Answer as the standard has it."""
        try:
            request = parse(pdu)
        except Malformed:
            reply(ExceptionCode.ILLEGAL_DATA_VALUE)
            return 0.0
        count = request.read[1] if request.read else 0
        reply(request.answer(b"".join(word.to_bytes(2, "big") for word in range(1, count + 1))))
        return 0.0


def descriptors() -> int:
    """Count what this process has open."""
    return len(list(Path("/proc/self/fd").iterdir()))


def resident() -> int:
    """Return the bytes of memory that this process holds: the second field of proc_pid_statm(5)."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def left_behind() -> tuple[int, int]:
    """Return descriptors and tasks, for comparison."""
    return descriptors(), len(asyncio.all_tasks())
