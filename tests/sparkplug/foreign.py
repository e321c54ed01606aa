"""Decoders of others, each a process of its own: pysparkplug with Google's protobuf, and npm's sparkplug-payload."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, Self

FOREIGN = Path(__file__).parents[2] / ".venv" / "foreign"
HERE = Path(__file__).parent


class Decoder:
    """A program that answers to each line of JSON by one, from `with` to its end."""

    def __init__(self, name: str) -> None:
        if not FOREIGN.is_dir():
            raise AssertionError(f"{FOREIGN} is missing: `make test` makes it")
        self.name = name
        self._environment = {"PYTHONPATH": str(FOREIGN / "python")}
        self._arguments = {
            "pysparkplug": [sys.executable, str(HERE / "foreign_decoder.py")],
            "sparkplug-payload": ["node", str(HERE / "foreign_decoder.js"), str(FOREIGN / "node")],
        }[name]

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            self._arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=self._environment if self.name == "pysparkplug" else None,
        )  # fmt: skip
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait(20)
        self._process.stdout.close()

    def _ask(self, asked: object) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, f"{self.name} cannot read {asked}"
        return json.loads(answer)

    def decode(self, kind: str, payload: bytes, device: str = "") -> dict[str, Any]:
        """Return what it makes of a message."""
        found: dict[str, Any] = self._ask({"kind": kind, "hex": payload.hex(), "device": device})
        return found

    def encode(self, kind: str, timestamp: int, metrics: list[dict[str, Any]]) -> bytes:
        """Return a command as it writes it; types by the names of the specification."""
        if self.name == "pysparkplug":
            metrics = [{**metric, "type": metric["type"].upper()} for metric in metrics]
        return bytes.fromhex(self._ask({"kind": kind, "timestamp": timestamp, "metrics": metrics}))
