"""Masters for the control benchmark: each gives a drive command and frequency and reads five values, in cycles.

Run as `python -m bench.control_masters NAME PORT BAUD`. The process opens the port and prints "ready"; then for each
line that it reads from standard input, a number of seconds, it prints one of JSON: the seconds that each good cycle
took, how many cycles failed, and the time that all took. It ends when standard input closes.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from typing import Any

import uvloop

from bench import one_drive
from bench.one_drive import MODEL, NUMBER, VALUES
from gateway.protocol.pdu import Exchange, Exchanged, ReadBlock, Request, Words, WriteRam
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.timing import LineTiming

RUN = 0xC400  # FA00: command and frequency by communication, run forward (E6581657 4.5)
FREQUENCIES = range(3000, 4000)  # FA01 in 0.01 Hz: each cycle has another one
TIMEOUT = 0.2  # seconds
COMMAND = MODEL.registers["command"].address
FREQUENCY = MODEL.registers["frequency_command"].address
BLOCK_READ = MODEL.blocks.indirect_read_address
BLOCK_WRITE = MODEL.blocks.indirect_write_address

Cycle = Callable[[int], Awaitable[int]]
"""Give the drive a frequency; return how many values were read. Failure is an exception of the master's own."""


def exchange(frequency: int) -> tuple[Request, ...]:
    """Return the one request that writes and reads."""
    return (Exchange(NUMBER, BLOCK_READ, len(VALUES), BLOCK_WRITE, (RUN, frequency)),)


def three_requests(frequency: int) -> tuple[Request, ...]:
    """Return a write of the frequency, one of the command, and a block read."""
    return (
        WriteRam(NUMBER, FREQUENCY, frequency),
        WriteRam(NUMBER, COMMAND, RUN),
        ReadBlock(NUMBER, BLOCK_READ, len(VALUES)),
    )


@dataclass(frozen=True, slots=True)
class Master:
    """A way to do a cycle: what goes over the line, and who sends it."""

    protocol: str
    requests: Callable[[int], tuple[Request, ...]]
    opened: Callable[[Master, str, int], AbstractAsyncContextManager[Cycle]]
    has_gap: bool = False  # asynchronous pymodbus: sleeps 3.5 characters after each answer


@asynccontextmanager
async def gateway(master: Master, port: str, baud: int) -> AsyncIterator[Cycle]:
    """Exchange as the gateway does."""
    codec = PROTOCOLS[master.protocol]
    async with one_drive.exchanging(port, baud) as exchanger:

        async def cycle(frequency: int) -> int:
            read = 0
            for request in master.requests(frequency):
                reply = (await exchanger.exchange(codec, request, MODEL.times.processing)).reply
                if isinstance(reply, Words | Exchanged):
                    read += len(reply.words)
            return read

        yield cycle


@asynccontextmanager
async def pymodbus_sync(master: Master, port: str, baud: int) -> AsyncIterator[Cycle]:
    """Exchange by pymodbus' synchronous serial client, whose own waiting for answers makes gaps long enough."""
    from pymodbus.client import ModbusSerialClient

    client: Any = ModbusSerialClient(port, baudrate=baud, parity="N", stopbits=2, timeout=TIMEOUT, retries=0)
    client.connect()

    async def cycle(frequency: int) -> int:
        client.connect()  # where a failure closed the port
        client.write_register(FREQUENCY, frequency, device_id=NUMBER)
        client.write_register(COMMAND, RUN, device_id=NUMBER)
        return len(client.read_holding_registers(BLOCK_READ, count=len(VALUES), device_id=NUMBER).registers)

    yield cycle
    client.close()


@asynccontextmanager
async def pymodbus_async(master: Master, port: str, baud: int) -> AsyncIterator[Cycle]:
    """Exchange by pymodbus' asynchronous serial client."""
    from pymodbus.client import AsyncModbusSerialClient

    client: Any = AsyncModbusSerialClient(port, baudrate=baud, parity="N", stopbits=2, timeout=TIMEOUT, retries=0)
    await client.connect()
    gap = LineTiming(baud).gap if master.has_gap else 0.0

    async def cycle(frequency: int) -> int:
        if not client.connected:
            await client.connect()
        await client.write_register(FREQUENCY, frequency, device_id=NUMBER)
        await asyncio.sleep(gap)
        await client.write_register(COMMAND, RUN, device_id=NUMBER)
        await asyncio.sleep(gap)
        read = await client.read_holding_registers(BLOCK_READ, count=len(VALUES), device_id=NUMBER)
        await asyncio.sleep(gap)
        return len(read.registers)

    yield cycle
    client.close()


MASTERS = {
    "gateway, 17H": Master("modbus-rtu", exchange, gateway),
    "gateway, X/Y": Master("toshiba-binary", exchange, gateway),
    "gateway, 06+06+03": Master("modbus-rtu", three_requests, gateway),
    "pymodbus sync": Master("modbus-rtu", three_requests, pymodbus_sync),
    "pymodbus async": Master("modbus-rtu", three_requests, pymodbus_async),
    "pymodbus async, gap": Master("modbus-rtu", three_requests, pymodbus_async, has_gap=True),
}


async def run(cycle: Cycle, frequencies: Iterator[int], seconds: float) -> dict[str, Any]:
    """Do cycles for some seconds."""
    times: list[float] = []
    failed = 0
    begun = now = time.monotonic()
    while now - begun < seconds:
        started = now
        try:
            is_good = await cycle(next(frequencies)) == len(VALUES)
        except Exception:  # each master has errors of its own
            is_good = False
        now = time.monotonic()
        if is_good:
            times.append(now - started)
        else:
            failed += 1
    return {"times": times, "failed": failed, "elapsed": now - begun}


async def serve(name: str, port: str, baud: int) -> None:
    """Do what standard input asks for."""
    master = MASTERS[name]
    frequencies = itertools.cycle(FREQUENCIES)
    async with master.opened(master, port, baud) as cycle:
        print("ready", flush=True)
        for line in sys.stdin:
            print(json.dumps(await run(cycle, frequencies, float(line))), flush=True)


if __name__ == "__main__":
    uvloop.run(serve(sys.argv[1], sys.argv[2], int(sys.argv[3])))
