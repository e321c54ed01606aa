"""The gateway as a process of its own, and waiting until something can be seen of it."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

LIMIT = 60.0  # seconds after which a wait is given up: several tests start programs at the same time


def until(condition: Callable[[], Any], what: str) -> Any:
    """Wait for a condition to hold, and return what it gives."""
    end = time.monotonic() + LIMIT
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.05)
    raise AssertionError(f"waited {LIMIT} s in vain for {what}")


@contextlib.contextmanager
def gateway(config: Path, log: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Run the gateway as a process of its own, and end it by its pid."""
    with log.open("w") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "gateway", "run", str(config), *options], stdout=output, stderr=output, text=True
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.terminate()
            process.wait(LIMIT)
