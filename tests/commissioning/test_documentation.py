"""docs/commissioning.md shows a session: it is played, and what is printed must be what stands there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig, from_options

PAGE = Path(__file__).parents[2] / "docs" / "commissioning.md"
SHOWN_PORT = "/tmp/line"  # noqa: S108  (as the page has it)


def blocks() -> list[str]:
    """Return the transcripts of the page."""
    return re.findall(r"```console\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def simulated(link: Path) -> SimulatedLineConfig:
    """Return the line that the page begins with."""
    found = re.search(r"tosvert-gateway simulate (.*) --link", PAGE.read_text(encoding="utf-8"))
    assert found is not None
    drives = re.findall(r"--drive (\S+)", found[1])
    return from_options(drives).model_copy(update={"link": str(link)})


@pytest.mark.e2e
def test_the_session_is_true(tmp_path: Path) -> None:
    """Every command in turn, its output line by line."""
    port = tmp_path / "line"
    program = tmp_path / "tosvert-gateway"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m gateway "$@"\n')
    program.chmod(0o755)
    with SimulatedLine(simulated(port)):
        for block in blocks():
            for shown in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
                command, _, expected = shown.partition("\n")
                done = subprocess.run(
                    ["sh", "-c", command.replace(SHOWN_PORT, str(port))],
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    stdin=subprocess.DEVNULL,
                    text=True,
                    check=False,
                    cwd=tmp_path,
                    env={"PATH": f"{tmp_path}:/usr/bin:/bin", "PYTHONPATH": str(PAGE.parents[1])},
                )
                assert done.stdout.replace(str(port), SHOWN_PORT) == expected, command
