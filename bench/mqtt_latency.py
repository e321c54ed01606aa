"""From the last bit of an answer on the line to the value in a subscriber's hands, through Mosquitto.

Every drive's motor ramps up, so that each reading brings another frequency: by it a message is known to be of that
answer.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from bench import line_journal
from bench.figures import SPREAD, milliseconds, spread
from bench.line_journal import Exchange
from bench.whole_gateway import ROOT, More, Ports, drive_name, on_simulated_line, simulated
from gateway.sim.process import SimulatedLine

BAUDS = (19200, 38400)
DRIVES = (1, 8)
SECONDS = 6.0  # of a ramp: 48 Hz of 60
QUICK = 1.5
RAMP = {"acceleration_time_1": 100}  # 10.0 s to 80 Hz (FH)
TARGET = 60.0  # Hz
BLOCK_READ = (3, 0x18, 0x75)  # function and address of the poll, whose second word is the output frequency
FREQUENCY_AT = 5  # in an answer, behind number, function, length and the status
VALUE, STATE = "output_frequency", "state"  # levels of topics
SETTLE = 0.8  # seconds in which the gateway sees that the blocks can be believed
LAST_ONES = 0.2  # seconds for messages that are on their way

Reading = tuple[int, int]  # number of a drive, hundredths of a hertz


@dataclass(frozen=True, slots=True)
class Row:
    """One line; seconds from the answer to the value's own message and to the JSON state."""

    baud: int
    drives: int
    values: list[float]
    states: list[float]
    missed: int
    lateness: float


def readings(exchanges: Iterable[Exchange]) -> dict[Reading, float]:
    """Return when each frequency was read that was read only once, and is not 0."""
    found: dict[Reading, float] = {}
    twice = set()
    for exchange in exchanges:
        if tuple(exchange.request[1:4]) != BLOCK_READ or not exchange.answer:
            continue
        reading = exchange.request[0], int.from_bytes(exchange.answer[FREQUENCY_AT : FREQUENCY_AT + 2], "big")
        if reading in found:
            twice.add(reading)
        found[reading] = exchange.end
    return {reading: end for reading, end in found.items() if reading not in twice and reading[1]}


def delays(read: Mapping[Reading, float], heard: Mapping[Reading, float]) -> list[float]:
    """Return how long after its answer each reading was heard of, in seconds; those not heard of are left out."""
    return [heard[reading] - end for reading, end in read.items() if reading in heard]


class Subscriber:
    """Notes when which frequency of which drive came, by the value's own topic and by the state."""

    def __init__(self, ports: Ports, drives: int) -> None:
        self.heard: dict[str, dict[Reading, float]] = {VALUE: {}, STATE: {}}
        self._numbers = {drive_name(number): number for number in range(1, drives + 1)}
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", ports.broker)
        self._client.subscribe([(f"{ROOT}/+/{level}", 0) for level in self.heard])

    def _on_message(self, _client: Any, _data: Any, message: Any) -> None:
        now = time.monotonic()
        *_, drive, level = message.topic.split("/")
        text = message.payload.decode()
        value = json.loads(text, parse_float=Decimal)[VALUE] if level == STATE else text
        if value:
            self.heard[level].setdefault((self._numbers[drive], int(Decimal(value) * 100)), now)

    def listen(self, seconds: float) -> None:
        """Take messages for so long."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._client.loop(left)

    def close(self) -> None:
        """Disconnect."""
        self._client.disconnect()


def measure(line: SimulatedLine, ports: Ports, baud: int, drives: int, seconds: float) -> Row:
    """Let every motor ramp up, and see when its frequencies are heard of."""
    subscriber = Subscriber(ports, drives)
    try:
        for number in range(1, drives + 1):
            line.do({"do": "run", "drive": number, "frequency": TARGET})
        subscriber.listen(SETTLE)
        line.do({"do": "reset_stats"})
        begun = time.monotonic()
        subscriber.listen(seconds)
        ended, lateness = time.monotonic(), line.stats()["lateness_p99"]
        subscriber.listen(LAST_ONES)
    finally:
        subscriber.close()
    exchanges = line_journal.read(line, since=begun)
    read = readings(exchange for exchange in exchanges if exchange.end < ended)
    values, states = (delays(read, subscriber.heard[level]) for level in (VALUE, STATE))
    return Row(baud, drives, values, states, 2 * len(read) - len(values) - len(states), lateness)


def measured(bauds: Sequence[int], drives: Sequence[int], seconds: float) -> Iterator[Row]:
    """Yield a row for each number of drives and baud rate."""
    for baud in bauds:
        for on_line in drives:
            with on_simulated_line(simulated(baud, on_line, registers=RAMP), More()) as (line, ports):
                yield measure(line, ports, baud, on_line, seconds)


HEAD = (
    f"{'':5} {'':6} {'':4}  {'to the message of the value':^31}  {'to the JSON state':^31}  {'line':>5}\n"
    f"{'baud':>5} {'drives':>6} {'n':>4}  {SPREAD}  {SPREAD}  {'late':>5} missed"
)


def row(found: Row) -> str:
    """Return a row of the table."""
    return (
        f"{found.baud:5} {found.drives:6} {len(found.values):4}  {spread(found.values)}"
        f"  {spread(found.states)}  {milliseconds(found.lateness):>5} {found.missed:6}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help=f"{QUICK:g} s a row in place of {SECONDS:g}")
    options = parser.parse_args()
    print("From the end of an answer on a fully loaded line to a subscriber; times in ms")
    print(HEAD)
    for found in measured(BAUDS, DRIVES, QUICK if options.quick else SECONDS):
        print(row(found), flush=True)


if __name__ == "__main__":
    main()
