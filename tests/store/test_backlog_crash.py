"""A backlog killed by SIGKILL at every statement, and at any moment: what was said to be stored is there."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from tests.soak import FACTOR
from tests.store.crasher import BATCHES, TOGETHER

ROOT = Path(__file__).parents[2]
PHASES = {"nothing", "stored", "sent", "gone", "emptied", "end"}


def run(module: str, *arguments: str) -> subprocess.Popen[str]:
    """Start a module of the tests."""
    command = [sys.executable, "-m", f"tests.store.{module}", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)


def judge(told: Iterable[tuple[str, list[int]]], left: list[int]) -> str:
    """Assert that what is left fits what was told; return what was told last."""
    stored: list[int] = []
    sent: set[int] = set()
    gone: set[int] = set()
    what = "nothing"
    for what, names in told:
        match what:
            case "stored":
                stored += names
            case "sent":
                sent |= set(names)
            case "gone":
                gone |= set(names)
            case "emptied":
                gone |= set(stored)
    assert left == sorted(set(left)), "in order, and nothing twice"
    assert not gone & set(left), "what was let go does not come back"
    owed = [name for name in stored if name not in sent]
    assert left or not stored or stored[-1] in sent
    newest = [name for name in owed if left and name >= left[0]]
    assert set(newest) <= set(left), "nothing is missing behind the oldest that is left"
    unasked = [name for name in left if name not in stored]
    assert len(unasked) <= TOGETHER, "at most the batch that was being written"
    return what


@pytest.mark.e2e
@pytest.mark.hazard("H35")
def test_killed_at_any_statement_it_has_what_it_said_it_had(tmp_path: Path) -> None:
    """While it makes its file, stores, drains, drops the oldest, and gives pages back."""
    with run("crasher", str(tmp_path)) as process:
        assert process.stdout is not None
        lines: list[dict[str, Any]] = [json.loads(line) for line in process.stdout]
    assert process.returncode == 0
    assert not lines[-1]["killed"]
    reached = {judge(line["told"], line["left"]) for line in lines}
    assert reached == PHASES
    assert {len(line["left"]) for line in lines} > {0, TOGETHER, 2 * TOGETHER - TOGETHER // 2}
    assert max(len(line["left"]) for line in lines) < BATCHES * TOGETHER - TOGETHER, "the oldest were dropped"


@pytest.mark.e2e
def test_killed_at_any_moment_it_has_what_it_said_it_had(tmp_path: Path) -> None:
    """The whole of it with its thread: SIGKILL at moments by chance, again and again, on the same file."""
    path, chance, seen = tmp_path / "backlog.sqlite", random.Random(6), 0
    for _ in range(5 * FACTOR):
        process = run("keeper", str(path), str(seen))
        assert process.stdout is not None
        with process:
            after = chance.randrange(1, 30)
            for number, line in enumerate(process.stdout, 1):
                if not line.endswith("\n"):
                    break
                word, count = line.split()
                if word == "lost":
                    pytest.fail(f"stored up to {seen}, and not there: {count}")
                seen = max(seen, int(count))
                if number == after:
                    process.send_signal(signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
    assert seen
