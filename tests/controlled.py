"""One controlled drive with everything real around it: a pty line, Mosquitto, the gateway, a controller to lose."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig
from tests.mosquitto import Mosquitto, free_port
from tests.processes import LIMIT, gateway, until

LEASE = 1.0  # seconds
F803 = 3.0  # seconds
MARGIN = 0.15  # seconds by which a busy machine may be late with the drive's answers
COMMAND_TIMEOUT = 1.0  # seconds
POLL = 0.1  # seconds between two reads of the drive
BEAT = 0.1  # seconds between two heartbeats
DRIVE: dict[str, Any] = {
    "number": 1,
    "model": "vf-nc3",
    "block_read": [1, 2, 3, 4, 5],
    "registers": {"acceleration_time_1": 5, "deceleration_time_1": 5},  # half a second to 80 Hz
}
CONTROL = f"""control = "leased"
lease = "{LEASE}s"
communication_timeout = "{F803}s"
timeout_action = "stop"
command_timeout = "{COMMAND_TIMEOUT}s"
frequency = {{ min = 0.0, max = 60.0 }}
"""
ROOT = "tosvert/hall-3/pump-1"


class Heartbeat:
    """A controller as a process of its own: another number every `BEAT` seconds, from `with` until it is killed."""

    def __init__(self, port: int) -> None:
        send = f"mosquitto_pub -h 127.0.0.1 -p {port} -t {ROOT}/heartbeat -q 1 -l"
        self._script = f"n=0; while :; do n=$((n+1)); echo $n; sleep {BEAT}; done | {send}"

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            ["sh", "-c", self._script], start_new_session=True, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    def kill(self) -> None:
        """End it without a word; it and its children are a process group of their own."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait(LIMIT)


@dataclass
class Stage:
    """The parts, and what a test asks of them."""

    line: SimulatedLine
    broker: Mosquitto
    process: subprocess.Popen[str]
    told: Path  # what was published of results and events
    tcp: int
    web: int
    facts: dict[str, Any] = field(default_factory=dict)

    # ---- the drive, as the simulated line knows it

    @property
    def drive(self) -> dict[str, Any]:
        """Return what the drive is and holds."""
        return self.line.state(1)

    @property
    def is_running(self) -> bool:
        """Say whether its output is on."""
        return bool(self.drive["is_running"])

    @property
    def now(self) -> float:
        """Return the line's own time, in seconds since it was opened."""
        return float(self.line.stats()["elapsed"])

    def requests(self, since: float) -> list[tuple[float, bytes]]:
        """Return the gateway's frames from that moment on, with their times."""
        sent = [entry for entry in self.line.log(2000) if entry["way"] == "request" and entry["begin"] >= since]
        return [(entry["begin"], bytes.fromhex(entry["data"])) for entry in sent]

    # ---- the controller's side

    def ask(self, command: str) -> dict[str, Any]:
        """Send a command by mosquitto_rr and return its result."""
        done = subprocess.run(
            ["mosquitto_rr", "-h", "127.0.0.1", "-p", str(self.broker.port), "-t", f"{ROOT}/command", "-m", command,
             "-e", f"test/answer/{os.getpid()}", "-W", "5"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.stdout, f"no answer to {command}: {done.stderr}"
        result: dict[str, Any] = json.loads(done.stdout)
        return result

    def do(self, *commands: str) -> None:
        """Send commands that must be done; while F803, F804 and F808 are being set they are sent again."""
        for command in commands:
            until(lambda command=command: self._is_done(command), f"{command} to be done")  # type: ignore[misc]

    def _is_done(self, command: str) -> bool:
        result = self.ask(command)
        if result["status"] == "refused" and result["reason"] == "busy":
            return False
        assert result["status"] == "done", result
        return True

    def run_motor(self, hertz: float) -> None:
        """Take, arm and run, and wait until the motor turns at that speed."""
        self.do("take", "arm", json.dumps({"command": "run", "frequency": hertz}))
        until(lambda: self.drive["frequency"] == hertz, f"{hertz} Hz")

    def send(self, command: str) -> None:
        """Send a command by mosquitto_pub, and wait for nothing."""
        subprocess.run(
            ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(self.broker.port), "-q", "1", "-t", f"{ROOT}/command",
             "-m", command],
            check=True,
        )  # fmt: skip

    def published(self, level: str) -> list[dict[str, Any]]:
        """Return what was published of events or results."""
        lines = self.told.read_text(encoding="utf-8").splitlines()
        return [json.loads(line.split(" ", 1)[1]) for line in lines if line.startswith(f"{ROOT}/{level} ")]

    def until_event(self, name: str) -> dict[str, Any]:
        """Wait for an event."""
        found: dict[str, Any] = until(
            lambda: next((event for event in self.published("event") if event["event"] == name), None), name
        )
        return found

    def until_result(self, known: str) -> dict[str, Any]:
        """Wait for the result of the command with that id."""
        found: dict[str, Any] = until(
            lambda: next((result for result in self.published("result") if result["id"] == known), None), known
        )
        return found

    def is_online(self) -> bool:
        """Say whether the gateway has the drive."""
        url = f"http://127.0.0.1:{self.web}/healthz"
        with contextlib.suppress(OSError), urllib.request.urlopen(url, timeout=5) as answer:
            return bool(answer.status == 200)
        return False


def written(folder: Path, port: str, broker: int, control: str = CONTROL, more: str = "") -> tuple[Path, int, int]:
    """Write the gateway's file; return it, and the ports of MODBUS-TCP and the web."""
    tcp, web = free_port(), free_port()
    path = folder / "gateway.toml"
    path.write_text(f"""{more}
[gateway]
name = "hall-3"
[mqtt]
url = "mqtt://127.0.0.1:{broker}"
reconnect_at_most = "1s"
[modbus_tcp]
listen = "127.0.0.1:{tcp}"
[web]
listen = "127.0.0.1:{web}"
[[line]]
name = "a"
port = "{port}"
answer_margin = "{MARGIN}s"
[[line.drive]]
name = "pump-1"
number = 1
model = "vf-nc3"
poll = [{{ values = ["status", "output_frequency", "output_current"], every = "{POLL}s" }}]
{control}""")
    return path, tcp, web


@contextlib.contextmanager
def telling(broker: int, path: Path) -> Iterator[None]:
    """Write down all results and events while the `with` block lasts."""
    with path.open("w") as output:
        process = subprocess.Popen(
            ["stdbuf", "-oL", "mosquitto_sub", "-h", "127.0.0.1", "-p", str(broker), "-F", "%t %p",
             "-t", f"{ROOT}/result", "-t", f"{ROOT}/event"],
            stdout=output,
        )  # fmt: skip
        try:
            yield
        finally:
            process.kill()
            process.wait(LIMIT)


@contextlib.contextmanager
def staged(
    line: SimulatedLine, broker: Mosquitto, folder: Path, control: str = CONTROL, more: str = ""
) -> Iterator[Stage]:
    """Start a gateway on a line and a broker, and wait until it has the drive."""
    path, tcp, web = written(folder, line.port, broker.port, control, more)
    told = folder / "told"
    with telling(broker.port, told), gateway(path, folder / "log") as process:
        stage = Stage(line, broker, process, told, tcp, web)
        try:
            until(stage.is_online, "a healthy gateway")
            yield stage
        except BaseException:
            print((folder / "log").read_text())  # noqa: T201  (shown by pytest when a test fails)
            raise
        finally:
            process.send_signal(signal.SIGCONT)


@contextlib.contextmanager
def plant(folder: Path, **drive: Any) -> Iterator[tuple[SimulatedLine, Mosquitto]]:
    """Start a line with one drive, and a broker."""
    config = SimulatedLineConfig.model_validate({"drive": [{**DRIVE, **drive}], "link": str(folder / "line")})
    with SimulatedLine(config) as line, Mosquitto() as broker:
        yield line, broker
