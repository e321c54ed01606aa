"""A simulated line in a process of its own, for tests and benchmarks: its timing is nobody else's."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gateway.errors import GatewayError
from gateway.sim.client import ControlClient
from gateway.sim.settings import SimulatedLineConfig

PATIENCE = 20.0  # seconds for the process to start or to end


class SimulatedLine:
    """Runs a line while the `with` block lasts; `port` is what a master opens, `control` its control socket.

    The process ends with its parent: it watches its standard input.
    """

    def __init__(self, config: SimulatedLineConfig) -> None:
        self._config = config
        self._folder = Path(tempfile.mkdtemp(prefix="tosvert-sim-"))
        self._process: subprocess.Popen[str] | None = None
        self._client: ControlClient | None = None
        self.port = ""
        self.control = self._folder / "control"

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self) -> None:
        """Start the process and wait until its port is there; GatewayError says why it did not start."""
        self._process = subprocess.Popen(  # noqa: S603  (this interpreter, with arguments of our own)
            [sys.executable, "-m", "gateway.sim", str(self.control)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        pipes = self._process
        if pipes.stdin is None or pipes.stdout is None:
            raise AssertionError("both are pipes")
        with contextlib.suppress(BrokenPipeError):
            pipes.stdin.write(self._config.model_dump_json(by_alias=True) + "\n")
            pipes.stdin.flush()
        first = pipes.stdout.readline()
        if not first:
            _, reason = pipes.communicate(timeout=PATIENCE)
            self.close()
            raise GatewayError(f"the simulated line did not start: {reason.strip()}")
        self.port = json.loads(first)["port"]
        self._client = ControlClient(self.control)

    def do(self, request: dict[str, Any]) -> Any:
        """Send a control request and return its result; GatewayError says why it was refused."""
        if self._client is None:
            raise GatewayError("the simulated line is not running")
        return self._client.do(request)

    def stats(self) -> dict[str, Any]:
        """Return what the line counted and how late it was."""
        result: dict[str, Any] = self.do({"do": "stats"})
        return result

    def state(self, drive: int | str) -> dict[str, Any]:
        """Return what one drive is and holds."""
        result: dict[str, Any] = self.do({"do": "state", "drive": drive})
        return result

    def log(self, count: int = 100) -> list[dict[str, Any]]:
        """Return the latest frames and events, the oldest first."""
        result: list[dict[str, Any]] = self.do({"do": "log", "count": count})
        return result

    def unplug(self) -> None:
        """Pull the adapter out."""
        self.do({"do": "unplug"})

    def plug(self) -> str:
        """Put it back; the port may have another name then, a link leads to it."""
        self.port = self.do({"do": "plug"})
        return self.port

    def close(self) -> None:
        """End the process and remove what it left."""
        if self._client is not None:
            self._client.close()
            self._client = None
        if self._process is not None:
            self._end(self._process)
            self._process = None
        shutil.rmtree(self._folder, ignore_errors=True)

    def _end(self, process: subprocess.Popen[str]) -> None:
        if process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()
