"""Home Assistant's own core and MQTT integration as a process, to be looked at and to press buttons in."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

ROOT = Path(__file__).parents[2]
PYTHON = ROOT / ".home-assistant" / "bin" / "python"
IS_THERE = PYTHON.exists()
WHY_NOT = "there is no .home-assistant: make home-assistant"
INSIDE = Path(__file__).with_name("inside.py")
LIMIT = 60.0  # seconds after which a wait is given up; a busy machine takes half of it to start
STEP = 0.5  # seconds between two looks
OF_THE_ENVIRONMENT = (  # how complaints begin that are of its own set-up, and of nothing that it was told
    "aiohttp_fast_zlib:",
    "homeassistant.components.http",
    "homeassistant.helpers.frame: Detected code that calls async_forward_entry_setups",
)


class HomeAssistant:
    """Home Assistant with a configuration folder, connected to the broker on a port, from `with` to its end."""

    def __init__(self, folder: Path, port: int) -> None:
        self.complaints: list[str] = []
        self._arguments = [str(PYTHON), str(INSIDE), str(folder), str(port)]

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            self._arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd="/"
        )
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._write({"do": "end"})
            try:
                self._process.wait(LIMIT)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait(LIMIT)
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None
            stream.close()

    def kill(self) -> None:
        """End it without a word."""
        self._process.kill()
        self._process.wait(LIMIT)

    def _write(self, request: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()

    def _ask(self, request: dict[str, Any]) -> dict[str, Any]:
        assert self._process.stdout is not None
        self._write(request)
        line = self._process.stdout.readline()
        assert line, "Home Assistant has ended"
        answer: dict[str, Any] = json.loads(line)
        return answer

    def look(self) -> dict[str, Any]:
        """Return what it knows; complaints that are not of the environment are kept."""
        found = self._ask({"do": "look"})
        self.complaints += [text for text in found["complaints"] if not text.startswith(OF_THE_ENVIRONMENT)]
        return found

    def entities(self) -> dict[str, dict[str, Any]]:
        """Return the entities by id."""
        found: dict[str, dict[str, Any]] = self.look()["entities"]
        return found

    def state(self, entity: str) -> str | None:
        """Return the state of one entity."""
        found = self.entities().get(entity)
        return None if found is None else found["state"]

    def call(self, action: str, entity: str, **more: Any) -> dict[str, Any]:
        """Carry out an action, as a person or an automation does; `error` in the answer says why not."""
        domain, service = action.split(".")
        return self._ask({"do": "call", "domain": domain, "service": service, "with": {"entity_id": entity, **more}})

    def judge(self, component: dict[str, Any]) -> str:
        """Return what its schema has against a component, "" where that is nothing."""
        return str(self._ask({"do": "judge", "component": component}).get("error", ""))

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Wait for a condition to hold, and return what it gives."""
        end = time.monotonic() + LIMIT
        while time.monotonic() < end:
            if found := condition():
                return found
            time.sleep(STEP)
        states = "\n".join(f"{entity}: {found['state']}" for entity, found in self.entities().items())
        raise AssertionError(f"waited {LIMIT:.0f} s in vain for {what}\n{states}\n{self.complaints}")

    def until_state(self, entity: str, state: str) -> None:
        """Wait until an entity has a state."""
        self.until(lambda: self.state(entity) == state, f"{entity} = {state}")
