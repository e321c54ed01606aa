"""The store in processes of its own: killed, starved of disk, kept out of its folder."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.store.state_file import look
from tests.soak import FACTOR
from tests.store.rig import reserved, running, until

ROOT = Path(__file__).parents[2]
NOBODY = 65534


@contextmanager
def writer(path: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run a process that reserves writes without end; it is killed at the end."""
    command = [sys.executable, "-m", "tests.store.writer", str(path), *arguments]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT, bufsize=1
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def lines(process: subprocess.Popen[str]) -> Iterator[tuple[str, int, str]]:
    """Yield what a writer says of each write: whether it was permitted, the count, why not."""
    assert process.stdout is not None
    for line in process.stdout:
        if not line.endswith("\n"):
            return  # it was killed in the middle of a word
        verdict, count, *why = line.split(maxsplit=2)
        yield verdict, int(count), "".join(why)


@pytest.mark.e2e
@pytest.mark.hazard("H08")
@pytest.mark.hazard("H12")
def test_a_process_that_is_killed_has_counted_every_write_that_it_permitted(tmp_path: Path) -> None:
    """SIGKILL at any moment, again and again: perhaps one too many was counted, never one too few."""
    path = tmp_path / "state.sqlite"
    chance = random.Random(8)
    permitted = 0
    for _ in range(6 * FACTOR):
        with writer(path) as process:
            after = chance.randrange(1, 60)
            for number, (verdict, count, why) in enumerate(lines(process), 1):
                assert (verdict, why) == ("permitted", "")
                assert count > permitted
                permitted = count
                if number == after:
                    process.send_signal(signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
        counted_ = look(path).wear["pump", 0x10].writes
        assert permitted <= counted_ <= permitted + 1


@pytest.mark.e2e
@pytest.mark.hazard("H35")
def test_on_a_full_disk_nothing_is_permitted_and_nothing_lost(tmp_path: Path) -> None:
    """Writes are refused with the reason; as soon as there is room again they are permitted, and the counts go on."""
    path = tmp_path / "state.sqlite"
    with writer(path, "120000") as process:
        told = lines(process)
        permitted, why = 0, ""
        while not why:
            verdict, count, why = next(told)
            permitted = count if verdict == "permitted" else permitted
        assert permitted > 1
        assert f"{path}: the disk" in why
        assert look(path).wear["pump", 0x10].writes >= permitted
        assert process.stdin is not None
        process.stdin.write("there is room\n")
        again = next(count for verdict, count, _ in told if verdict == "permitted")
        assert again > permitted
        assert look(path).wear["pump", 0x10].writes >= again


@contextmanager
def unprivileged() -> Iterator[Path]:
    """Be nobody, to whom a folder is read-only; root may write anywhere."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        is_root = os.geteuid() == 0
        if is_root:
            os.seteuid(NOBODY)
        else:
            folder.chmod(0o555)
        try:
            yield folder
        finally:
            if is_root:
                os.seteuid(0)
            folder.chmod(0o755)


@pytest.mark.hazard("H35")
async def test_in_a_folder_that_is_read_only_nothing_is_permitted() -> None:
    """It is said so; the counts of the process go on."""
    with unprivileged() as folder:
        async with running(folder / "state.sqlite") as store:
            await until(lambda: "Permission denied" in store.problem)
            assert await reserved(store) == store.problem
            store.note("pump", 0x10)
            assert store.count("pump", 0x10) == 1
        assert not list(folder.iterdir())
