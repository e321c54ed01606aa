"""A process that keeps, sends and lets go readings, killed at one statement after another.

`python -m tests.store.crasher FOLDER`: for each statement that reaches SQLite, from the file's creation on, a child
goes so far and kills itself there. Prints a line of JSON for each: what the child had been told, and what is left.
"""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from gateway.store import backlog_file
from gateway.store.backlog_file import BacklogFile
from gateway.store.backlog_schema import PAGE, Limits
from tests.store.backlogs import reading

LIMITS = Limits(100 * PAGE, 3600.0, is_synced=False)
BATCHES, TOGETHER = 6, 40
BODY = 1500  # bytes: all batches together are more than the file may hold
MS = 1000
ALIKE, EVERY = 20, 30  # of statements that begin alike, such as those of a batch, not each is an end

real_connect = sqlite3.connect


def count_down(left: int) -> Callable[..., sqlite3.Connection]:
    """Return a `connect` whose connections kill the process when so many statements have been executed."""
    last, alike = "", 0

    def tick(statement: str) -> None:
        nonlocal left, last, alike
        alike = alike + 1 if statement[:ALIKE] == last else 0
        last = statement[:ALIKE]
        left -= not alike % EVERY
        if left <= 0:
            os.kill(os.getpid(), signal.SIGKILL)

    def connect(*arguments: Any, **options: Any) -> sqlite3.Connection:
        connection: sqlite3.Connection = real_connect(*arguments, **options)
        connection.set_trace_callback(tick)
        return connection

    return connect


def work(path: Path, told: int) -> None:
    """Store, drain, drop and shrink; write what is acknowledged to the descriptor `told`, a line each."""

    def tell(what: str, numbers: list[int]) -> None:
        os.write(told, (json.dumps([what, numbers]) + "\n").encode())

    file = BacklogFile.open(path, LIMITS)
    for batch in range(BATCHES):
        names = [batch * TOGETHER + place for place in range(TOGETHER)]
        done = file.append([reading(name, ms=MS, body=f"{name}:".ljust(BODY)) for name in names])
        tell("stored", names[len(names) - done.stored :])
        if batch % 2:
            first = file.take(0, TOGETHER // 2)[0]
            names = [name_of(kept.reading.body) for kept in first]
            tell("sent", names)
            file.let_go([kept.number for kept in first])
            tell("gone", names)
    tell("sent", [name_of(kept.reading.body) for kept in file.take(0, 10_000)[0]])
    file.drop_older(MS + 1)
    tell("emptied", [])
    while file.shrink():
        pass
    file.close()
    tell("end", [])


def name_of(body: str) -> int:
    """Return the number that a reading was made with."""
    return int(body.partition(":")[0])


def left(path: Path) -> list[int]:
    """Return what the file holds when the next process opens it."""
    file = BacklogFile.open(path, LIMITS)
    found, damaged = file.take(0, 100_000)
    assert not damaged
    assert len(found) == file.rows
    assert path.stat().st_size <= LIMITS.max_bytes
    file.append([reading(-1, body="-1:")])  # it can be written to
    file.close()
    return [name_of(kept.reading.body) for kept in found]


def killed_at(statement: int, folder: Path) -> tuple[list[Any], list[int], bool]:
    """Let a child go so far; return what it had been told, what is left, and whether it was killed at all."""
    folder.mkdir()
    path = folder / "backlog.sqlite"
    mine, its = os.pipe()
    child = os.fork()
    if not child:
        sqlite3.connect = count_down(statement)  # type: ignore[assignment]
        assert backlog_file.sqlite3.connect is sqlite3.connect  # type: ignore[attr-defined]
        work(path, its)
        os._exit(0)
    os.close(its)
    with os.fdopen(mine) as lines:
        told = [json.loads(line) for line in lines if line.endswith("\n")]
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status) and os.WEXITSTATUS(status):
        raise SystemExit(f"the child failed at {statement}")
    return told, left(path), os.WIFSIGNALED(status)


def main(folder: Path) -> None:
    """Kill at each statement, until one gets through."""
    statement, is_killed = 0, True
    while is_killed:
        statement += 1
        told, found, is_killed = killed_at(statement, folder / str(statement))
        print(json.dumps({"statement": statement, "told": told, "left": found, "killed": is_killed}))  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
