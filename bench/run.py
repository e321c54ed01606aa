"""All benchmarks, one after another: `make bench`."""

from __future__ import annotations

import subprocess
import sys

BENCHMARKS = ("bench.line_load", "bench.block_forms", "bench.control_cycle", "bench.tcp_load")


def main() -> None:
    """Run each in a process of its own, so that none warms another up."""
    failed = []
    for name in BENCHMARKS:
        print(f"\n{name}: {sys.executable} -m {name}", flush=True)
        if subprocess.run([sys.executable, "-m", name], check=False).returncode:
            failed.append(name)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
