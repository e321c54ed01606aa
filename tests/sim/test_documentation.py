from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from gateway.sim.control import REQUEST
from gateway.sim.doings import FaultSection
from gateway.sim.drive_section import SimulatedDriveSection
from gateway.sim.faults import Kind
from gateway.sim.runner import opened
from gateway.sim.settings import SimulatedLineConfig, build, from_options, load

ROOT = Path(__file__).parents[2]
REQUESTS = REQUEST.json_schema()["discriminator"]["mapping"]
PAGE = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    """Return the page's code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def test_the_file_on_the_page_is_right(tmp_path: Path) -> None:
    """It loads, its drives can be built, and it shows every key but two of the line."""
    (tmp_path / "line.toml").write_text(blocks("toml")[0])
    config = load(tmp_path / "line.toml")
    assert len(build(config).drives) == 2
    used = config.model_fields_set | {"catalogue"}
    assert used == set(SimulatedLineConfig.model_fields)
    assert config.drive[0].model_fields_set == set(SimulatedDriveSection.model_fields)


@pytest.mark.e2e
@pytest.mark.parametrize("program", blocks("python"))
def test_the_programs_on_the_page_run(program: str) -> None:
    """Each Python block is a whole program."""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout


def test_the_page_names_every_fault_and_every_request() -> None:
    """Nothing that can be asked for is left out, and no key of a fault."""
    words = set(re.findall(r"`([a-z_]+)`", PAGE))
    assert {kind.value for kind in Kind} <= words
    assert set(REQUESTS) <= words
    assert set(FaultSection.model_fields) <= words


def test_the_page_names_every_count() -> None:
    """All keys of the statistics are explained."""
    with opened(from_options(["1:vf-nc3"]), None) as line:
        counted = line.control.do({"do": "stats"})["result"]
    assert set(counted) <= set(re.findall(r"`([a-z_0-9]+)`", PAGE))
