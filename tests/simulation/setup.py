"""What one trial is about: drives, line, lease and time-outs, drawn by chance, and the files that say so."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from random import Random
from typing import Any

from gateway import site
from gateway.sim.settings import SimulatedLineConfig
from gateway.site import SERIAL_MARGIN, Site

GATEWAY = "sim"
ROOT = f"tosvert/{GATEWAY}"
LINE = "a"
BROKER = ("broker", 1883)
TCP_PORT = 5020
PROTOCOLS = ("modbus-rtu", "toshiba-ascii", "toshiba-binary")
SECONDS = (0.5, 0.8, 1.0, 1.5, 2.0, 3.0)
QUICK = {"acceleration_time_1": 10, "deceleration_time_1": 20}  # 0.1 s: from standstill to FH and back
F804 = {"coast": 1, "stop": 2}
HUNDREDTHS = 100  # of a hertz, the unit of setpoints
LONGEST_REQUEST = 20  # characters
LONGEST_ANSWER = 32
PROCESSING = 0.005  # seconds


@dataclass(frozen=True, slots=True)
class Setup:
    """One gateway with one line. Times in seconds; `timeout` is F803, `is_as_shipped`: the gateway has to set it."""

    drives: int = 1
    protocol: str = "modbus-rtu"
    baud: int = 19200
    lease: float = 1.0
    timeout: float = 1.0
    action: str = "stop"
    on_loss: str = "stop"
    on_exit: str = "stop"
    version: str = "5"
    poll: float = 0.5
    is_as_shipped: bool = False
    command_timeout: float = 1.0
    max_age: float = 2.0
    carries: bool = False  # run commands go with the block read
    model: str = "vf-nc3"  # of the drives that are really there

    @property
    def names(self) -> tuple[str, ...]:
        """Return the drives' names; drive i has number i."""
        return tuple(f"d{number}" for number in self.numbers)

    @property
    def numbers(self) -> range:
        """Return the drives' numbers."""
        return range(1, self.drives + 1)

    @property
    def exchange(self) -> float:
        """Return how long one exchange takes at the most: one without an answer, or with a damaged one."""
        request, answer = LONGEST_REQUEST * 11 / self.baud, LONGEST_ANSWER * 12 / self.baud
        gaps = 3 * 3.5 * 11 / self.baud
        return request + answer + gaps + PROCESSING + 2 * SERIAL_MARGIN

    def site(self) -> Site:
        """Return the gateway's site."""
        return _site(json.dumps(self._tables()))

    def _tables(self) -> dict[str, Any]:
        drive = {
            "model": "vf-nc3",
            "protocol": self.protocol,
            "poll": [
                {
                    "values": ["status", "output_frequency"],
                    "every": _span(self.poll),
                    "max_age": _span(self.max_age),
                }
            ],
            "control": "leased",
            "lease": _span(self.lease),
            "on_loss": self.on_loss,
            "on_exit": self.on_exit,
            "communication_timeout": _span(self.timeout),
            "timeout_action": self.action,
            "command_timeout": _span(self.command_timeout),
            "frequency": {"min": 0.0, "max": 60.0},
            "block_write": self.carries,
        }
        drives = [{"name": f"d{number}", "number": number, **drive} for number in self.numbers]
        return {
            "gateway": {"name": GATEWAY},
            "mqtt": {
                "url": f"mqtt://{BROKER[0]}:{BROKER[1]}",
                "version": self.version,
                "publish": ["state"],
                "keep_alive": "5s",
                "reconnect_after": "100ms",
                "reconnect_at_most": "500ms",
            },
            "modbus_tcp": {"listen": f"127.0.0.1:{TCP_PORT}"},
            "line": [{"name": LINE, "port": "/dev/ttyS0", "baud": self.baud, "drive": drives}],
        }

    def line(self, seed: str) -> SimulatedLineConfig:
        """Return the simulated line."""
        registers = dict(QUICK)
        if not self.is_as_shipped:
            registers |= {"communication_timeout": round(self.timeout * 10), "timeout_action": F804[self.action]}
        spoken = "modbus-rtu" if self.protocol == "modbus-rtu" else "toshiba"
        drive: dict[str, Any] = {"model": self.model, "protocol": spoken, "registers": registers}
        if self.carries:
            drive |= {"block_read": [1, 2, 3, 4, 5], "block_write": [1, 3] if spoken == "modbus-rtu" else [1, 0]}
        drives = [{"number": number, **drive} for number in self.numbers]
        table = {"baud": self.baud, "seed": hash_of(seed), "processing_time": _span(PROCESSING), "drive": drives}
        return SimulatedLineConfig.model_validate(table)

    def but(self, **changed: Any) -> Setup:
        """Return it with something else in it."""
        return replace(self, **changed)


def _span(seconds: float) -> str:
    """Return a duration as the files want it."""
    return f"{round(seconds * 1000)}ms"


def hash_of(text: str) -> int:
    """Return a number for a text, the same in every process."""
    return Random(text).getrandbits(31)


def drawn(chance: Random) -> Setup:
    """Draw a set-up."""
    return Setup(
        drives=chance.choice((1, 1, 1, 1, 1, 1, 2, 2, 2, 3, 4)),
        protocol=chance.choice(PROTOCOLS),
        baud=chance.choice((9600, 19200, 38400)),
        lease=chance.choice(SECONDS),
        timeout=chance.choice(SECONDS),
        action=chance.choice(("stop", "coast")),
        on_loss=chance.choice(("stop", "stop", "coast", "emergency-stop", "quiesce")),
        version=chance.choice(("5", "3.1.1")),
        poll=chance.choice((0.4, 0.7, 1.0)),
        is_as_shipped=chance.random() < 0.15,
        command_timeout=chance.choice((0.2, 0.4, 1.0, 1.0)),
        carries=chance.random() < 0.4,
    )


@lru_cache(256)
def _site(tables: str) -> Site:
    return site.build(json.loads(tables), "simulation", Path())
