"""A process that keeps readings without end, and prints how many are stored for good: to be killed.

`python -m tests.store.keeper FILE STORED`: readings are numbered on from what the file holds; first it looks whether
all that an earlier process said it had stored is there. Every now and then some are let go, the oldest first.
"""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

from tests.store.backlogs import asked, reading, running
from tests.store.crasher import name_of
from tests.store.rig import until

WINDOW = 400  # readings that stay in the file


async def keep(path: Path, stored: int) -> None:
    """Print "stored NUMBER" for the newest that is stored, or "lost NUMBER" for one that is missing."""
    async with running(path) as backlog:
        if stored:
            await until(lambda: backlog.origin)
        found = [name_of(kept.reading.body) for kept in await asked(backlog, count=100_000)]
        if stored and (not found or found != list(range(found[0], found[-1] + 1)) or found[-1] < stored):
            print("lost", stored, flush=True)  # noqa: T201
        made = first = found[-1] if found else 0
        while True:
            for _ in range(20):
                made += 1
                backlog.put(reading(made, body=f"{made}:"))
            await until(lambda: backlog.stats.stored >= made - first)  # noqa: B023 - waited for at once
            print("stored", made, flush=True)  # noqa: T201
            kept = await asked(backlog, count=100_000)
            backlog.let_go([each.number for each in kept[:-WINDOW]])


if __name__ == "__main__":
    asyncio.run(keep(Path(sys.argv[1]), int(sys.argv[2])))
