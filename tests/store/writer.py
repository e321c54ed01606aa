"""A process that reserves writes without end, and prints each count when it is permitted: to be killed, or starved.

`python -m tests.store.writer FILE [BYTES]`: with BYTES, no file of it may become longer, as on a disk that is full,
until a line is read from its standard input.
"""

from __future__ import annotations

import asyncio
import resource
import sys
import threading
from pathlib import Path

from gateway.clock import SystemClock
from gateway.store.store import Store
from tests.store.rig import QUICK, reserved, until


async def write(path: Path) -> None:
    """Print "permitted COUNT" or "refused COUNT WHY", a line for each write."""
    store = Store(path, 1000, SystemClock(), QUICK)
    store.start()
    await until(lambda: not store.problem)
    while True:
        problem = await reserved(store)
        print("refused" if problem else "permitted", store.count("pump", 0x10), problem, flush=True)  # noqa: T201
        await asyncio.sleep(0.001 if problem else 0)


def starve(size: int) -> None:
    """Let no file become longer until a line is read."""
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))

    def feed() -> None:
        sys.stdin.readline()
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))

    threading.Thread(target=feed, daemon=True).start()


if __name__ == "__main__":
    if len(sys.argv) > 2:
        starve(int(sys.argv[2]))
    asyncio.run(write(Path(sys.argv[1])))
