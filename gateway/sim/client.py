"""Asks a simulated line over its control socket: from a program, or as `python -m gateway.sim.client` by hand."""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gateway.errors import GatewayError

PATIENCE = 20.0  # seconds for an answer
USAGE = (
    "usage: python -m gateway.sim.client SOCKET DO [KEY=VALUE]...    such as: /tmp/line.control trip drive=1 code=13"
)


class ControlClient:
    """One connection to the control socket of a running line; OSError where there is none."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.settimeout(PATIENCE)
            self._socket.connect(str(path))
        except OSError:
            self._socket.close()
            raise
        self._answers = self._socket.makefile("r")

    def do(self, request: dict[str, Any]) -> Any:
        """Send a request and return its result; GatewayError says why it was refused."""
        self._socket.sendall(json.dumps(request).encode() + b"\n")
        line = self._answers.readline()
        if not line:
            raise GatewayError(f"{request}: the simulated line has ended")
        answer = json.loads(line)
        if not answer["ok"]:
            raise GatewayError(f"{request}: {answer['error']}")
        return answer["result"]

    def close(self) -> None:
        """End the connection."""
        self._answers.close()
        self._socket.close()


def request(words: Sequence[str]) -> dict[str, Any]:
    """Make a request of what was typed: what to do, and KEY=VALUE with values as in JSON, or plain text."""
    do, *pairs = words
    table: dict[str, Any] = {"do": do}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise GatewayError(f"{pair}: give KEY=VALUE")
        try:
            table[key] = json.loads(value)
        except ValueError:
            table[key] = value
    return table


def main(arguments: Sequence[str]) -> int:
    """Do one request, and print its result."""
    if len(arguments) < 2:
        sys.stderr.write(f"{USAGE}\n")
        return 2
    path, *words = arguments
    try:
        client = ControlClient(Path(path))
        try:
            result = client.do(request(words))
        finally:
            client.close()
    except (GatewayError, OSError) as error:
        sys.stderr.write(f"{error}\n" if isinstance(error, GatewayError) else f"{path}: {error.strerror}\n")
        return 1
    sys.stdout.write(json.dumps(result, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
