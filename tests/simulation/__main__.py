"""Runs one trial again and tells what happened: python -m tests.simulation "death in every state" 17."""

from __future__ import annotations

import sys

from tests.simulation import trial


def main() -> None:
    """Tell a trial's trace, and what must not have been."""
    made = trial.run(sys.argv[1], int(sys.argv[2]))
    if len(sys.argv) == 3:
        for when, *what in made.trace:
            print(f"{when:12.6f}", *what)  # noqa: T201 - what it is for
    for violation in made.violations:
        print("VIOLATION", violation)  # noqa: T201
    print(made.digest, f"{made.seconds:.1f} s", f"{made.frames} frames", made.worst, made.worst_calm)  # noqa: T201


if __name__ == "__main__":
    main()
