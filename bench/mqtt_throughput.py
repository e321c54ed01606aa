"""Values a second that reach a subscriber through Mosquitto, whether one is lost, and what the line feels of it.

The values come from an image that is fed in the gateway's own event loop (bench.fed_gateway), since no set of lines
brings so many; beside it the same process polls a wire-timed line as fast as that allows. Every value counts up by
one, so that a subscriber sees each that is missing. The subscriber is mosquitto_sub; what it prints is counted in a
process of its own: that neither of them is what holds values up is known by the share of a core that each takes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.many_lines import BAUD, Lines, processor_seconds
from bench.whole_gateway import FIVE, PATIENCE, until
from tests.mosquitto import Mosquitto, program

ASKED = ((0, 20_000, "values"), (0, 20_000, "state"), (1, 5_000, "values"), (1, 5_000, "state"))
FED = 20  # drives
VALUES = '["output_frequency", "output_current", "input_voltage", "output_voltage", "output_power"]'
BROKER = ("allow_anonymous true", "set_tcp_nodelay true", "max_queued_messages 0")
DRIVES = 4  # on the line
COUNTER = "bench.message_count"
SETTLE = 1.0  # seconds
QUIET = 2.0  # seconds without a message, after which none is on its way any more


@dataclass(frozen=True, slots=True)
class Row:
    """What was measured: values a second, shares of a core and of the line's limit."""

    qos: int
    publish: str
    asked: float
    heard: float
    lost: int
    gateway: float
    subscriber: float
    counter: float
    share: float


def _line_file(port: str, broker: int) -> str:
    drives = "".join(
        f'[[line.drive]]\nname = "d{number}"\nnumber = {number}\nmodel = "vf-nc3"\n'
        f'poll = [{{ values = {FIVE}, every = "0s", max_age = "30s" }}]\n'
        for number in range(1, DRIVES + 1)
    )
    return (
        f'[gateway]\nname = "line"\n[mqtt]\nurl = "mqtt://127.0.0.1:{broker}"\npublish = ["state"]\n'
        f'[[line]]\nname = "a"\nport = "{port}"\nbaud = {BAUD}\n{drives}'
    )


def _fed_file(broker: int, qos: int, publish: str) -> str:
    drives = "".join(
        f'[[line.drive]]\nname = "fed-{number}"\nnumber = {number}\nmodel = "vf-nc3"\n'
        f'poll = [{{ values = {VALUES}, every = "1s", max_age = "1h" }}]\n'
        for number in range(1, FED + 1)
    )
    return (
        f'[gateway]\nname = "fed"\n[mqtt]\nurl = "mqtt://127.0.0.1:{broker}"\nbase = "fed"\nqos = {qos}\n'
        f'publish = ["{publish}"]\nretain = false\n[[line]]\nname = "b"\nport = "/dev/null"\n{drives}'
    )


class Talking:
    """A process that answers each line of its standard input by one of JSON."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-m", *arguments]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def ask(self, line: object) -> Any:
        """Return the answer."""
        assert self.process.stdin is not None  # noqa: S101 - it was asked for
        assert self.process.stdout is not None  # noqa: S101 - it was asked for
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    @property
    def used(self) -> float:
        """Return the processor time that it has taken, in seconds."""
        return processor_seconds(self.process.pid)

    def close(self) -> None:
        """End it."""
        self.process.communicate(timeout=PATIENCE)


@dataclass
class Setting:
    """All that runs, and how it is looked at."""

    lines: Lines
    gateway: Talking
    counter: Talking
    elapsed: float = 0.0
    share: float = 0.0

    def run(self, rate: float, seconds: float) -> tuple[float, float, float]:
        """Let it run so long at that pace; return the shares of a core of gateway, subscriber and counter."""
        self.gateway.ask(rate)
        time.sleep(SETTLE)
        self.lines.counted()
        subscriber = self.counter.ask("pid")["pid"]
        begun, used = time.monotonic(), (self.gateway.used, processor_seconds(subscriber), self.counter.used)
        time.sleep(seconds)
        (line,) = self.lines.counted()
        self.elapsed = time.monotonic() - begun
        self.share = line["busy"] / self.elapsed
        after = self.gateway.used, processor_seconds(subscriber), self.counter.used
        return tuple((now - before) / self.elapsed for now, before in zip(after, used, strict=True))  # type: ignore[return-value]


def measure(qos: int, rate: float, publish: str, seconds: float) -> Iterator[Row]:
    """Yield what is measured without any load, and with it."""
    with Mosquitto(*BROKER) as broker, tempfile.TemporaryDirectory() as name:
        lines, folder = Lines(1, DRIVES), Path(name)
        (folder / "line.toml").write_text(_line_file(lines.ports[0], broker.port))
        (folder / "fed.toml").write_text(_fed_file(broker.port, qos, publish))
        counter = Talking(COUNTER, str(broker.port), publish, str(qos))
        gateway = Talking("bench.fed_gateway", str(folder / "line.toml"), str(folder / "fed.toml"))
        setting = Setting(lines, gateway, counter)
        try:
            until(lambda: gateway.ask(0.0)["is_connected"], "the broker")
            before = setting.run(0.0, seconds)
            yield Row(qos, publish, 0.0, 0.0, 0, *before, setting.share)
            shares = setting.run(rate, seconds)
            yield _loaded(setting, Row(qos, publish, rate, 0.0, 0, *shares, setting.share))
        finally:
            for each in (gateway, counter, lines):
                each.close()


def _loaded(setting: Setting, row: Row) -> Row:
    """Return the row with what was heard of all that was fed; what is on its way is waited for."""
    first = setting.counter.ask("count")
    time.sleep(SETTLE)
    second = setting.counter.ask("count")
    setting.gateway.ask(0.0)
    time.sleep(SETTLE)
    fed = setting.gateway.ask(0.0)["fed"]
    heard = (second["values"] - first["values"]) / (second["time"] - first["time"])
    lost = fed - _all_heard(setting, fed)
    return Row(row.qos, row.publish, row.asked, heard, lost, row.gateway, row.subscriber, row.counter, row.share)


def _all_heard(setting: Setting, fed: int) -> int:
    """Return how many values were heard, when it is all of them, or no more have come for a while."""
    before, heard = -1, 0
    while before < heard < fed:
        before = heard
        time.sleep(QUIET)
        heard = setting.counter.ask("count")["values"]
    return heard


HEAD = (
    f"{'qos':>3} {'publish':8} {'asked':>7} {'values/s':>8} {'lost':>6}  {'gateway':>8} {'subscriber':>10}"
    f" {'counter':>8}  {'share of the line':>17}"
)


def row(of: Row) -> str:
    """Return a row as text."""
    return (
        f"{of.qos:3} {of.publish:8} {of.asked:7.0f} {of.heard:8.0f} {of.lost:6}  {of.gateway:8.0%}"
        f" {of.subscriber:10.0%} {of.counter:8.0%}  {of.share:17.1%}"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="length of a measurement")
    parser.add_argument("--rate", type=float, help="values a second in place of what is asked for")
    options = parser.parse_args(arguments)
    print(f"{program('mosquitto')}, one line of {DRIVES} drives at {BAUD} baud beside {FED} fed ones;")
    print("shares of a core: a subscriber or a counter near 100% would be what holds values up")
    print(HEAD)
    for qos, rate, publish in ASKED:
        for found in measure(qos, options.rate or rate, publish, options.seconds):
            print(row(found), flush=True)


if __name__ == "__main__":
    main()
