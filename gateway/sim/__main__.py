"""Run a simulated line for the program that started this one: its settings come by standard input, as JSON.

Arguments: the path of the control socket. The line ends when the standard input does.
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

from gateway.errors import GatewayError
from gateway.sim.loop import sharpen
from gateway.sim.runner import opened
from gateway.sim.settings import SimulatedLineConfig


def main() -> int:
    """Run until the standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program that started this one
    try:
        config = SimulatedLineConfig.model_validate_json(sys.stdin.readline())
        with opened(config, Path(sys.argv[1])) as line:
            loop = line.loop
            sharpen()  # whoever reads the name of the port finds it served
            loop.add_reader(sys.stdin.fileno(), loop.stop)
            sys.stdout.write(json.dumps({"port": config.link or loop.port.name}) + "\n")
            sys.stdout.flush()
            loop.run()
    except GatewayError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
