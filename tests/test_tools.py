"""The checks of the lock files, and the set-up script that finds Debian packages."""

from __future__ import annotations

import os
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tools import licences, locks

ROOT = Path(__file__).parents[1]
PIN = "aiohttp==3.1.0 \\\n    --hash=sha256:{digest}\n    # via\n    #   -c requirements.lock\n    #   yarl\n"
LOCK = "# made\n#    by make\n" + PIN.format(digest="0" * 64) + "yarl==1.2 ; sys_platform != 'win32' \\\n"


def test_a_lock_file_is_read() -> None:
    """Name, version, marker, hashes, and what a pin is there for."""
    rest = f"    --hash=sha256:{'1' * 64}\n    # via tosvert-gateway (pyproject.toml)\n"
    (aiohttp, yarl), strange = locks.read(LOCK + rest)
    assert strange == []
    assert (aiohttp.name, aiohttp.version, aiohttp.marker, aiohttp.hashes) == ("aiohttp", "3.1.0", "", 1)
    assert aiohttp.via == ["-c requirements.lock", "yarl"]
    assert (yarl.marker, yarl.hashes, yarl.is_direct) == ("sys_platform != 'win32'", 1, True)
    assert not aiohttp.is_direct


@pytest.mark.parametrize(
    "line",
    ["--index-url somewhere", "--find-links .", "-e .", "yarl @ file:///yarl", "    # https://example.org", "yarl"],
)
def test_what_ties_a_lock_file_to_one_machine_is_found(line: str) -> None:
    """An index, a path, a URL, or a package without version and hash."""
    assert locks.read(f"{LOCK}{line}\n")[1] == [line]


def pin(name: str, version: str = "1.0", via: str = "tosvert-gateway (pyproject.toml)", hashes: int = 1) -> locks.Pin:
    """Return a pin."""
    return locks.Pin(name, version, "", hashes, [via])


@pytest.mark.parametrize(
    ("pins", "problem"),
    [
        ([], "x: a>=1 is missing"),
        ([pin("a", "0.9")], "x: a 0.9 is not a>=1"),
        ([pin("a"), pin("b")], "x: b is no longer asked for"),
        ([pin("a", hashes=0)], "x: a has no hash"),
    ],
)
def test_a_lock_file_that_does_not_match_is_told_why(pins: list[locks.Pin], problem: str) -> None:
    """Missing, too old, left over, without hash."""
    assert list(locks.problems("x", pins, [Requirement("a>=1")])) == [problem]


def test_a_lock_file_that_matches_has_no_problem() -> None:
    """What others need is not asked for, and belongs there."""
    assert not list(locks.problems("x", [pin("a"), pin("b", via="a")], [Requirement("A>=1")]))


def test_lock_files_that_disagree_are_found() -> None:
    """What is tested is what is installed."""
    made = {locks.RUNTIME: [pin("a", "1.0")], locks.BUILD: [pin("b")], locks.DEVELOPMENT: [pin("a", "1.1")]}
    assert list(locks.contradictions(made)) == [
        "requirements.lock: a 1.0, but 1.1 in requirements-dev.lock",
        "requirements-build.lock: b 1.0, but nothing in requirements-dev.lock",
    ]


def test_the_lock_files_of_the_project_hold_what_it_asks_for() -> None:
    """The same as `make check` finds."""
    assert locks.main() == 0


def test_what_a_package_needs_is_reached() -> None:
    """Needs of needs too."""
    pins = [pin("a"), pin("b", via="a"), pin("c", via="b"), pin("d", via="e"), pin("e")]
    assert licences.reached(pins, ["A"]) == {"a", "b", "c"}


def test_every_direct_dependency_has_its_purpose_on_the_page() -> None:
    """Nobody adds a package without saying what for."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    direct = {requirement.name for requirement in locks.wanted(project, locks.DEVELOPMENT)}
    assert direct == set(licences.PURPOSES)


def need_packages(path: Path, *pairs: str) -> subprocess.CompletedProcess[str]:
    """Run the set-up script with nothing but `path` to find programs in."""
    return subprocess.run(
        [ROOT / "tools" / "need-packages", "the test", *pairs],
        env={"PATH": str(path)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_nothing_is_installed_when_the_programs_are_there() -> None:
    """Silent, and no need of root."""
    done = need_packages(Path("/usr/bin"), "sh:dash", "env:coreutils")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_what_is_missing_is_named_where_it_cannot_be_installed(tmp_path: Path) -> None:
    """No apt-get: the message says what to install and what it is for."""
    for name in ("sh", "dirname", "id"):
        (tmp_path / name).symlink_to(f"/usr/bin/{name}")
    done = need_packages(tmp_path, "sh:dash", "no-such-program:some-package", "nor-this:other")
    assert done.returncode == 1
    assert "the test needs some-package other (there is no apt-get here)" in done.stderr
    assert "apt-get install some-package other" in done.stderr


def test_what_is_missing_is_installed_through_sudo(tmp_path: Path) -> None:
    """Not root, but sudo: apt-get update, then install, quietly and without questions."""
    called = tmp_path / "called"
    fakes = {"id": "echo 1000", "apt-get": f'echo "$DEBIAN_FRONTEND $*" >>{called}', "sudo": 'exec "$@"'}
    for name, text in fakes.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    for name in ("sh", "env", "mktemp", "rm", "cat"):
        (tmp_path / name).symlink_to(f"/usr/bin/{name}")
    done = need_packages(tmp_path, "no-such-program:some-package")
    assert done.returncode == 0, done.stderr
    update, install = called.read_text().splitlines()
    assert update.strip() == "update -qq"
    assert install == "noninteractive install -y -qq --no-install-recommends some-package"
    assert "some-package" in done.stdout


SCRIPTS = ["tools/make-venv", "tools/need-packages", "tools/quietly", ".ci/run", "deploy/healthcheck.py"]


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_can_be_run(name: str) -> None:
    """Their mode survives in the repository."""
    assert os.access(ROOT / name, os.X_OK)


def test_a_quiet_command_speaks_when_it_fails() -> None:
    """Success is silent; failure shows everything and keeps its exit code."""
    quietly = ROOT / "tools" / "quietly"
    done = subprocess.run([quietly, "sh", "-c", "echo loud"], capture_output=True, timeout=60, check=True)
    assert (done.stdout, done.stderr) == (b"", b"")
    script = "echo out; echo err >&2; exit 3"
    failed = subprocess.run([quietly, "sh", "-c", script], capture_output=True, timeout=60, check=False)
    assert (failed.returncode, failed.stdout, failed.stderr) == (3, b"", b"out\nerr\n")
