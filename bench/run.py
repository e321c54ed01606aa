"""All benchmarks, one after another, or some: `make bench`, `make bench BENCH_ARGS="--quick stop_latency"`."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Mapping, Sequence

BENCHMARKS: Mapping[str, Sequence[str]] = {  # with what makes them quick, and rough
    "line_load": ("--runs", "1", "--seconds", "1"),
    "block_forms": ("--runs", "1", "--seconds", "0.5"),
    "control_cycle": ("--runs", "1", "--seconds", "0.5"),
    "command_latency": ("--quick",),
    "stop_latency": ("--quick",),
    "mqtt_latency": ("--quick",),
    "three_rates": ("--seconds", "6"),
    "mqtt_throughput": ("--seconds", "2"),
    "dead_drives": ("--seconds", "2", "--dead", "0", "--dead", "7"),
    "many_lines": ("--seconds", "1", "--lines", "1", "--lines", "4"),
    "tcp_load": ("--runs", "1", "--seconds", "0.3", "--rounds", "1"),
}


def main() -> None:
    """Run each in a process of its own, so that none warms another up."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", nargs="*", help=f"of a benchmark, all by default: {', '.join(BENCHMARKS)}")
    parser.add_argument("--quick", action="store_true", help="rough figures in short time")
    options = parser.parse_args()
    if unknown := set(options.name) - set(BENCHMARKS):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(BENCHMARKS)}")
    failed = []
    for name in options.name or BENCHMARKS:
        command = [sys.executable, "-m", f"bench.{name}", *(BENCHMARKS[name] if options.quick else ())]
        print(f"\n{name}: {' '.join(command)}", flush=True)
        if subprocess.run(command, check=False).returncode:
            failed.append(name)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
