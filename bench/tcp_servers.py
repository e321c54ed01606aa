"""The MODBUS-TCP servers that bench/tcp_load.py compares: run as `python -m bench.tcp_servers NAME`, one a process.

The process prints its port and serves until its standard input closes. Those in C do the same (*.c).
"""

from __future__ import annotations

import asyncio
import socket
import sys
from collections.abc import Callable, Coroutine
from typing import Any

import uvloop
from pymodbus import pymodbus_apply_logging_config
from pymodbus.server import ModbusTcpServer as PymodbusServer
from pymodbus.simulator import DataType, SimData, SimDevice

from gateway.clock import SystemClock
from gateway.config import ModbusTcpSection
from gateway.drives.model import Model
from gateway.drives.register import Kind, Register
from gateway.image import Image, LinkState
from gateway.metrics import LineStats, Stats
from gateway.modbus_tcp import gateway_unit
from gateway.modbus_tcp.server import ModbusTcpServer
from gateway.site import Drive, Point

START = 0xFD00
REGISTERS = 100
DRIVES = 8
CONNECTIONS = 200
ANSWER_EVERY = 0.01  # seconds, as a busy line at 38400 baud brings them
WORDS_PER_ANSWER = 5
MAX_AGE = 3.0
FIXED = {count: bytes([0, 0, 0, 2 * count + 3, 1, 3, 2 * count]) + bytes(2 * count) for count in (5, REGISTERS)}


def drive(unit: int) -> Drive:
    """Make a drive with 100 consecutive registers, the first ones with the names of the compact map."""
    names = [*gateway_unit.VALUES, *(f"value_{i}" for i in range(REGISTERS - len(gateway_unit.VALUES)))]
    registers = {name: Register(name, START + i, Kind.MONITOR, "bench") for i, name in enumerate(names)}
    points = {name: Point(register, MAX_AGE) for name, register in registers.items()}
    model = Model("bench", "a drive of the benchmark", "bench", registers)
    return Drive(
        name=f"drive-{unit}",
        line="a",
        number=unit,
        unit=unit,
        model=model,
        protocol="modbus-rtu",
        wait_time=0.0,
        groups=(),
        points=points,
        derived=(),
        deadband={},
    )


async def keep_fresh(image: Image, clock: SystemClock) -> None:
    """Bring answers as a busy line would, drive after drive, five words each."""
    for i in range(sys.maxsize):
        target = image.drives[i % DRIVES]
        first = START + i // DRIVES * WORDS_PER_ANSWER % REGISTERS
        words = [(first + k, (i + k) & 0x7FFF) for k in range(WORDS_PER_ANSWER)]
        target.apply(words, clock.now(), clock.wall())
        await asyncio.sleep(ANSWER_EVERY)


async def serve_gateway() -> int:
    """Start this gateway's server over an image that stays fresh."""
    clock = SystemClock()
    image = Image(drive(unit) for unit in range(1, DRIVES + 1))
    for target in image.drives:
        target.set_link(LinkState.ONLINE)
        target.apply([(START + i, i) for i in range(REGISTERS)], clock.now(), clock.wall())
    stats = Stats(clock.wall(), {"a": LineStats(is_up=True)})
    section = ModbusTcpSection(listen="127.0.0.1:0", connections=CONNECTIONS)
    server = ModbusTcpServer(section, image, stats, clock)
    await server.start()
    BACKGROUND.append(asyncio.create_task(keep_fresh(image, clock)))
    return server.port


async def serve_pymodbus() -> int:
    """Start pymodbus' own server with the same registers."""
    pymodbus_apply_logging_config("CRITICAL")  # a client that hangs up is no news here
    data = SimData(START, values=list(range(REGISTERS)), datatype=DataType.REGISTERS)
    server = PymodbusServer(SimDevice(1, simdata=[data]), address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    listener: Any = server.transport
    return int(listener.sockets[0].getsockname()[1])


class FixedAnswer(asyncio.Protocol):
    """Answers each segment with fixed bytes behind its transaction id and looks at nothing else: the loop's limit."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection."""
        self.write: Callable[[bytes], None] = transport.write  # type: ignore[attr-defined]

    def data_received(self, data: bytes) -> None:
        """Answer."""
        self.write(data[:2] + FIXED[data[11]])


async def serve_pymodbustcp() -> int:
    """Start pyModbusTCP's server, which has a thread for each connection."""
    from pyModbusTCP.server import DataBank, ModbusServer

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    bank = DataBank()
    bank.set_holding_registers(START, list(range(REGISTERS)))
    server = ModbusServer("127.0.0.1", port, no_block=True, data_bank=bank)
    server.start()
    BACKGROUND.append(server)
    return port


async def serve_fixed_answer() -> int:
    """Start the bare protocol."""
    server = await asyncio.get_running_loop().create_server(FixedAnswer, "127.0.0.1", 0)
    BACKGROUND.append(server)
    return int(server.sockets[0].getsockname()[1])


BACKGROUND: list[object] = []
SERVERS: dict[str, Callable[[], Coroutine[None, None, int]]] = {
    "gateway": serve_gateway,
    "pymodbus": serve_pymodbus,
    "pyModbusTCP": serve_pymodbustcp,
    "bare uvloop": serve_fixed_answer,
}


async def main(name: str) -> None:
    """Serve until standard input closes."""
    print(await SERVERS[name](), flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)


if __name__ == "__main__":
    uvloop.run(main(sys.argv[1]))
