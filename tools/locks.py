"""Checks that the lock files match pyproject.toml, name no host, and carry hashes for every pin."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^ ;\\]+)(?: ; ([^\\]+?))? \\$")
HASH = re.compile(r"^    --hash=sha256:[0-9a-f]{64}( \\)?$")
COMMENT = re.compile(r"^(    )?#( |$)")

RUNTIME = "requirements.lock"
BUILD = "requirements-build.lock"
DEVELOPMENT = "requirements-dev.lock"
HOUSE = "tests/home_assistant/requirements.lock"  # of an environment of its own, with another Python
REMEDY = "run `make lock`"


@dataclass(slots=True)
class Pin:
    """One package of a lock file. `via` says what it is there for: packages, or the project itself."""

    name: str
    version: str
    marker: str
    hashes: int
    via: list[str]

    @property
    def is_direct(self) -> bool:
        """Say whether the project itself asks for it."""
        return any(name.startswith(("tosvert-gateway", "pyproject.toml")) for name in self.via)


def read(text: str) -> tuple[list[Pin], list[str]]:
    """Return the pins of a lock file, and the lines in it that should not be there."""
    pins: list[Pin] = []
    strange = []
    for line in text.splitlines():
        if match := PIN.match(line):
            pins.append(Pin(canonicalize_name(match[1]), match[2], match[3] or "", 0, []))
        elif HASH.match(line) and pins:
            pins[-1].hashes += 1
        elif not COMMENT.match(line) or "://" in line:
            strange.append(line)
        elif pins and (via := re.match(r"^    #   (?:  )?(\S.*)$|^    # via (\S.*)$", line)):
            pins[-1].via.append(via[1] or via[2])
    return pins, strange


def wanted(project: dict[str, Any], lock: str) -> list[Requirement]:
    """Return what pyproject.toml asks a lock file to hold."""
    groups = project["dependency-groups"]
    runtime = [*project["project"]["dependencies"], *project["project"]["optional-dependencies"]["demo"]]
    lists = {
        RUNTIME: runtime,
        BUILD: groups["build"],
        HOUSE: groups["home-assistant"],
        DEVELOPMENT: [*runtime, *groups["dev"], *groups["bench"], *groups["build"]],
    }
    return [Requirement(text) for text in lists[lock]]


def problems(lock: str, pins: list[Pin], wanted: list[Requirement]) -> Iterator[str]:
    """Yield what is wrong with one lock file."""
    by_name = {pin.name: pin for pin in pins}
    for requirement in wanted:
        pin = by_name.get(canonicalize_name(requirement.name))
        if pin is None:
            yield f"{lock}: {requirement} is missing"
        elif not requirement.specifier.contains(pin.version, prereleases=True):
            yield f"{lock}: {pin.name} {pin.version} is not {requirement}"
    names = {canonicalize_name(requirement.name) for requirement in wanted}
    for pin in pins:
        if pin.is_direct and pin.name not in names:
            yield f"{lock}: {pin.name} is no longer asked for"
        if not pin.hashes:
            yield f"{lock}: {pin.name} has no hash"


def contradictions(locks: dict[str, list[Pin]]) -> Iterator[str]:
    """Yield pins that differ between the lock files; development holds all that the others hold."""
    development = {pin.name: pin.version for pin in locks[DEVELOPMENT]}
    for lock in (RUNTIME, BUILD):
        for pin in locks[lock]:
            if development.get(pin.name) != pin.version:
                other = development.get(pin.name, "nothing")
                yield f"{lock}: {pin.name} {pin.version}, but {other} in {DEVELOPMENT}"


def main() -> int:
    """Print what is wrong; the exit code says whether anything is."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wrong = []
    if project["build-system"]["requires"] != project["dependency-groups"]["build"]:
        wrong.append("pyproject.toml: build-system.requires and dependency-groups.build differ")
    locks = {}
    for lock in (RUNTIME, BUILD, DEVELOPMENT, HOUSE):
        locks[lock], strange = read((ROOT / lock).read_text(encoding="utf-8"))
        wrong += [f"{lock}: does not belong here: {line}" for line in strange]
        wrong += problems(lock, locks[lock], wanted(project, lock))
    wrong += contradictions(locks)
    for line in wrong:
        print(line, file=sys.stderr)
    if wrong:
        print(REMEDY, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
