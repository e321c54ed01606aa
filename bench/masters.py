"""Masters for the line benchmark: each polls five words of every drive as fast as it can, until it is ended."""

from __future__ import annotations

import asyncio
import itertools
import os
import select
import sys
import termios
import time
import tty

from gateway.protocol.checksum import crc16

BLOCK = 0x1875
WORDS = 5
ANSWER = 5 + 2 * WORDS  # characters
GAP_CHARACTERS = 3.5
BITS = 11
TIMEOUT = 0.2  # seconds
SINGLES = {"trip_code": 0xFC90, "cumulative_operation_time": 0xFE14}
RATES = {BLOCK: 0.25, SINGLES["trip_code"]: 2.0, SINGLES["cumulative_operation_time"]: 5.0}  # seconds
IDLE = 0.001  # seconds


def bare_loop(port: str, baud: int, drives: int) -> None:
    """Write, read 15 bytes, wait for the exact gap, again: what the pty and the scheduler leave to anybody."""
    fd = os.open(port, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd, termios.TCSANOW)
    gap = GAP_CHARACTERS * BITS / baud
    frames = []
    for number in range(1, drives + 1):
        body = bytes((number, 3)) + BLOCK.to_bytes(2, "big") + WORDS.to_bytes(2, "big")
        frames.append(body + crc16(body))
    for frame in itertools.cycle(frames):
        os.write(fd, frame)
        answer = b""
        while len(answer) < ANSWER and select.select([fd], [], [], TIMEOUT)[0]:
            answer += os.read(fd, 64)
        end = time.monotonic() + gap
        while (left := end - time.monotonic()) > 0:
            select.select([], [], [], left)


def pymodbus_sync(port: str, baud: int, drives: int) -> None:
    """Poll by pymodbus' synchronous serial client."""
    from pymodbus.client import ModbusSerialClient

    client = ModbusSerialClient(port, baudrate=baud, parity="N", stopbits=2, timeout=TIMEOUT, retries=0)
    client.connect()
    for number in itertools.cycle(range(1, drives + 1)):
        try:
            client.read_holding_registers(BLOCK, count=WORDS, device_id=number)
        except Exception:  # a lost frame is the peer's own affair; the line counts
            client.connect()


def pymodbus_async(port: str, baud: int, drives: int) -> None:
    """Poll by pymodbus' asynchronous serial client."""
    from pymodbus.client import AsyncModbusSerialClient

    async def poll() -> None:
        client = AsyncModbusSerialClient(port, baudrate=baud, parity="N", stopbits=2, timeout=TIMEOUT, retries=0)
        await client.connect()
        for number in itertools.cycle(range(1, drives + 1)):
            try:
                await client.read_holding_registers(BLOCK, count=WORDS, device_id=number)
            except Exception:  # as above
                if not client.connected:
                    await client.connect()

    asyncio.run(poll())


def minimalmodbus(port: str, baud: int, drives: int) -> None:
    """Poll by minimalmodbus."""
    import minimalmodbus as library

    instruments = []
    for number in range(1, drives + 1):
        instrument = library.Instrument(port, number)
        instrument.serial.baudrate = baud
        instrument.serial.timeout = TIMEOUT
        instruments.append(instrument)
    for instrument in itertools.cycle(instruments):
        try:
            instrument.read_registers(BLOCK, WORDS)
        except (OSError, ValueError):
            continue  # a lost frame; the line counts


def _at_rates(port: str, baud: int, drives: int, *, in_batches: bool) -> None:
    """Poll every drive at `RATES` by pymodbus' synchronous client: what is most overdue first, or rate by rate."""
    from pymodbus.client import ModbusSerialClient

    client = ModbusSerialClient(port, baudrate=baud, parity="N", stopbits=2, timeout=TIMEOUT, retries=0)
    client.connect()
    start = time.monotonic()
    due = {(number, address): start for address in RATES for number in range(1, drives + 1)}
    while True:
        now = time.monotonic()
        ready = [key for key in due if due[key] <= now]  # by rate, the fastest first
        if not ready:
            time.sleep(IDLE)
            continue
        key = ready[0] if in_batches else min(ready, key=due.__getitem__)
        number, address = key
        due[key] += RATES[address]
        try:
            client.read_holding_registers(address, count=WORDS if address == BLOCK else 1, device_id=number)
        except Exception:  # as above
            client.connect()


def due_first(port: str, baud: int, drives: int) -> None:
    """Poll what is most overdue."""
    _at_rates(port, baud, drives, in_batches=False)


def in_batches(port: str, baud: int, drives: int) -> None:
    """Poll whatever is due, the fastest rate of all drives first."""
    _at_rates(port, baud, drives, in_batches=True)


MASTERS = {
    "bare loop": bare_loop,
    "pymodbus sync": pymodbus_sync,
    "pymodbus async": pymodbus_async,
    "minimalmodbus": minimalmodbus,
    "pymodbus, due first": due_first,
    "pymodbus, in batches": in_batches,
}

TIMED = ("pymodbus, due first", "pymodbus, in batches")  # these poll at rates; all others as fast as they can

if __name__ == "__main__":
    MASTERS[sys.argv[1]](sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
