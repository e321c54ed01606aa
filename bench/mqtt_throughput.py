"""Values a second that reach a subscriber through Mosquitto, whether one is lost, and what the line feels of it.

The values come from an image that is fed in the gateway's own event loop (bench.fed_gateway), since no set of lines
brings so many; beside it the same process polls a wire-timed line as fast as that allows. Stretches with and without
that load take turns: each loaded one is compared with the two beside it, and what the load costs the line is the
median of those differences. Every value counts up by one, so that a subscriber sees each that is missing. The
subscriber is mosquitto_sub; what it prints is counted in a process of its own: that neither of them is what holds
values up is known by the share of a core that each takes.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
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
SETTLE = 0.4  # seconds from a change of pace to the next stretch
QUIET = 2.0  # seconds without a message, after which none is on its way any more


@dataclass(frozen=True, slots=True)
class Stretch:
    """What was measured in one: values a second, shares of a core and of the line's limit."""

    heard: float
    gateway: float
    subscriber: float
    counter: float
    share: float


@dataclass(frozen=True, slots=True)
class Row:
    """What was measured in all: `idle` stretches are one more than `loaded` ones, which lie between them."""

    qos: int
    publish: str
    asked: float
    lost: int
    idle: Sequence[Stretch]
    loaded: Sequence[Stretch]

    @property
    def costs(self) -> list[float]:
        """Return by how much the line's share was smaller in each loaded stretch than beside it, in points."""
        return costs([each.share for each in self.idle], [each.share for each in self.loaded])


def costs(idle: Sequence[float], loaded: Sequence[float]) -> list[float]:
    """Return how many points less each loaded stretch has than the mean of the idle ones before and after it."""
    beside = [(before + after) / 2 for before, after in pairwise(idle)]
    return [100 * (without - share) for without, share in zip(beside, loaded, strict=True)]


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
    subscriber: int  # its process

    def stretch(self, rate: float, seconds: float) -> Stretch:
        """Let it run so long at that pace."""
        self.gateway.ask(rate)
        time.sleep(SETTLE)
        self.lines.counted()
        before, used = self.counter.ask("count"), self._used()
        time.sleep(seconds)
        (line,) = self.lines.counted()
        after = self.counter.ask("count")
        elapsed = after["time"] - before["time"]
        heard = (after["values"] - before["values"]) / elapsed
        gateway, subscriber, counter = (
            (now - then) / elapsed for now, then in zip(self._used(), used, strict=True)
        )
        return Stretch(heard, gateway, subscriber, counter, line["busy"] / (line["whole"] or elapsed))

    def _used(self) -> tuple[float, float, float]:
        return self.gateway.used, processor_seconds(self.subscriber), self.counter.used


def measure(qos: int, rate: float, publish: str, seconds: float, times: int) -> Row:
    """Measure without load and with it, in turns."""
    with Mosquitto(*BROKER) as broker, tempfile.TemporaryDirectory() as name:
        lines, folder = Lines(1, DRIVES), Path(name)
        (folder / "line.toml").write_text(_line_file(lines.ports[0], broker.port))
        (folder / "fed.toml").write_text(_fed_file(broker.port, qos, publish))
        counter = Talking(COUNTER, str(broker.port), publish, str(qos))
        gateway = Talking("bench.fed_gateway", str(folder / "line.toml"), str(folder / "fed.toml"))
        try:
            until(lambda: gateway.ask(0.0)["is_connected"], "the broker")
            setting = Setting(lines, gateway, counter, counter.ask("pid")["pid"])
            setting.stretch(rate, SETTLE)  # what comes first is slower
            stretches = [setting.stretch(rate if turn % 2 else 0.0, seconds) for turn in range(2 * times + 1)]
            fed = gateway.ask(0.0)["fed"]
            return Row(qos, publish, rate, fed - _all_heard(setting, fed), stretches[::2], stretches[1::2])
        finally:
            for each in (gateway, counter, lines):
                each.close()


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
    f" {'counter':>8}  {'line alone':>10} {'loaded':>7}  {'costs, points':>20}"
)


def row(of: Row) -> str:
    """Return a row as text: medians, and between which quarters half of the costs are."""

    def median(name: str, among: Sequence[Stretch]) -> float:
        found: float = statistics.median(getattr(each, name) for each in among)
        return found

    low, middle, high = statistics.quantiles(of.costs, n=4) if len(of.costs) > 1 else of.costs * 3
    return (
        f"{of.qos:3} {of.publish:8} {of.asked:7.0f} {median('heard', of.loaded):8.0f} {of.lost:6}"
        f"  {median('gateway', of.loaded):8.0%} {median('subscriber', of.loaded):10.0%}"
        f" {median('counter', of.loaded):8.0%}  {median('share', of.idle):10.1%} {median('share', of.loaded):7.1%}"
        f"  {middle:6.2f} ({low:.2f} to {high:.2f})"
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.5, help="length of a stretch")
    parser.add_argument("--times", type=int, default=5, help="loaded stretches, each between two without load")
    parser.add_argument("--rate", type=float, help="values a second in place of what is asked for")
    parser.add_argument("--publish", choices=("values", "state"), help="this alone")
    parser.add_argument("--qos", type=int, choices=(0, 1), help="this alone")
    options = parser.parse_args(arguments)
    print(f"{program('mosquitto')}, one line of {DRIVES} drives at {BAUD} baud beside {FED} fed ones;")
    print("shares of a core: a subscriber or a counter near 100% would be what holds values up; the line's share is")
    print("of its limit, its costs are the median (quartiles) of loaded stretches against those beside them")
    print(HEAD)
    for qos, rate, publish in ASKED:
        if options.publish in (None, publish) and options.qos in (None, qos):
            print(row(measure(qos, options.rate or rate, publish, options.seconds, options.times)), flush=True)


if __name__ == "__main__":
    main()
