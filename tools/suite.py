"""Runs the tests in three parts, each in the way that suits it, and ends with 1 if any part fails.

`python -m tools.suite [ARGUMENTS OF PYTEST]`. Tests that need nothing but a processor share all of them; so do
those that go through many thousands of inputs, or play the whole daemon in virtual time, whose coverage is not
measured, for measuring takes three times as long; of the tests with real programs, which mostly wait, three are under
way at a time, and those who have done with theirs take over from others.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

NOTHING_SELECTED = 5  # exit code of pytest


@dataclass(frozen=True, slots=True)
class Part:
    """Some of the tests: by which marks they are chosen, and with what pytest is to run them."""

    name: str
    marks: str
    arguments: tuple[str, ...]


PARTS = (
    Part("measured", "not e2e and not unmeasured", ("-n", "auto", "--cov", "--cov-branch", "--cov-report=")),
    Part("unmeasured", "unmeasured", ("-n", "auto")),
    Part("with real programs", "e2e", ("-n", "3", "--dist", "worksteal", "--cov", "--cov-branch", "--cov-append")),
)


def run(part: Part, more: Sequence[str]) -> int:
    """Run one part; return the exit code of pytest, 0 where `more` has chosen none of its tests."""
    print(f"\n== {part.name}", flush=True)
    command = [sys.executable, "-m", "pytest", "-q", "-m", part.marks, *part.arguments, *more]
    code = subprocess.run(command, check=False).returncode  # noqa: S603 (this interpreter)
    return 0 if more and code == NOTHING_SELECTED else code


def main(more: Sequence[str]) -> int:
    """Run all parts, whatever becomes of the first ones."""
    codes = {part.name: run(part, more) for part in PARTS}
    failed = [name for name, code in codes.items() if code]
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
