"""The whole gateway as a process, with a broker and all its servers, on a simulated line that it loads fully."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig
from tests.mosquitto import Mosquitto, free_port

NAME = "bench"
ROOT = f"tosvert/{NAME}"
PATIENCE = 30.0  # seconds for something that must happen
SAID = 2000  # characters of the gateway's log that are repeated when something goes wrong
LOOK_EVERY = 0.05  # seconds between two looks whether it has
FIVE = '["status", "output_frequency", "output_current", "output_voltage", "alarm"]'
BROKER = ("allow_anonymous true", "set_tcp_nodelay true")  # as installed, Mosquitto may hold a message for 40 ms
CONTROLLED = 'control = "direct"\ncommunication_timeout = "15s"\ntimeout_action = "stop"\n'


@dataclass(frozen=True, slots=True)
class Ports:
    """Where a gateway is reached on loopback: its broker, and its own servers."""

    broker: int
    tcp: int
    web: int


def drive_name(number: int) -> str:
    """Return the name of a drive, for topics."""
    return f"d{number}"


def simulated(baud: int, drives: int, **more: Any) -> SimulatedLineConfig:
    """Return a line of VF-nC3 whose selectors are set, 5 ms in each drive; `more` are keys of each drive."""
    entries = [
        {"number": number, "model": "vf-nc3", "block_read": [1, 2, 3, 4, 5]} | more for number in range(1, drives + 1)
    ]
    return SimulatedLineConfig.model_validate({"baud": baud, "drive": entries})


@dataclass(frozen=True, slots=True)
class More:
    """Further keys in the gateway's file, and in the broker's."""

    of_mqtt: str = ""
    of_line: str = ""
    of_drive: str = ""
    of_broker: tuple[str, ...] = BROKER
    polls: str = f'{{ values = {FIVE}, every = "0s" }}'


@contextlib.contextmanager
def running(port: str, baud: int, drives: int, more: More) -> Iterator[Ports]:
    """Run the gateway on a line while the block lasts; what it said goes with the SystemExit that ends the block."""
    with Mosquitto(*more.of_broker) as broker, tempfile.TemporaryDirectory() as folder:
        ports = Ports(broker.port, free_port(), free_port())
        config, log = Path(folder) / "gateway.toml", Path(folder) / "log"
        config.write_text("".join(_file(port, baud, drives, ports, more)))
        command = [sys.executable, "-m", "gateway", "run", str(config)]
        with log.open("w") as output, subprocess.Popen(command, stderr=output) as process:
            try:
                yield ports
            except SystemExit as error:
                raise SystemExit(f"{error}\nthe gateway said:\n{log.read_text()[-SAID:]}") from None
            finally:
                process.terminate()
                process.wait(PATIENCE)


def _file(port: str, baud: int, drives: int, ports: Ports, more: More) -> Iterator[str]:
    """Yield a configuration with everything switched on, polling as fast as the line allows."""
    yield f'[gateway]\nname = "{NAME}"\n[mqtt]\nurl = "mqtt://127.0.0.1:{ports.broker}"\n{more.of_mqtt}'
    yield f'[modbus_tcp]\nlisten = "127.0.0.1:{ports.tcp}"\n[web]\nlisten = "127.0.0.1:{ports.web}"\n'
    yield f'[[line]]\nname = "a"\nport = "{port}"\nbaud = {baud}\nparity = "even"\n{more.of_line}'
    for number in range(1, drives + 1):
        yield f'[[line.drive]]\nname = "{drive_name(number)}"\nnumber = {number}\nmodel = "vf-nc3"\n{more.of_drive}'
        yield f"poll = [{more.polls}]\n"


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait until something has happened; SystemExit says what did not."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"waited {PATIENCE:g} s in vain for {what}")
        time.sleep(LOOK_EVERY)


def is_healthy(ports: Ports) -> bool:
    """Say whether the gateway has a fresh value of every drive."""
    url = f"http://127.0.0.1:{ports.web}/healthz"
    with contextlib.suppress(OSError), urllib.request.urlopen(url, timeout=5) as answer:
        return bool(answer.status == 200)
    return False


@contextlib.contextmanager
def on_simulated_line(config: SimulatedLineConfig, more: More) -> Iterator[tuple[SimulatedLine, Ports]]:
    """Run line and gateway while the block lasts, which begins when every drive is read."""
    with SimulatedLine(config) as line, running(line.port, config.baud, len(config.drive), more) as ports:
        until(lambda: is_healthy(ports), "every drive to be read")
        yield line, ports
