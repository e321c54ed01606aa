"""Counts what mosquitto_sub prints of fed values, and finds each that is missing: every value counts up by one.

`python -m bench.message_count PORT values|state QOS` answers each line of its standard input: `pid` with that of
mosquitto_sub, anything else with the values so far, how many were missing in between, and the time.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
import time

from bench.fed_gateway import WORDS
from tests.mosquitto import program

READ = 1 << 16  # bytes
NUMBER = re.compile(rb'"(output_frequency|output_current|input_voltage|output_voltage|output_power)":([\d.]+)')


class Count:
    """The values so far, by topic and name."""

    def __init__(self) -> None:
        self.values = 0
        self.missing = 0
        self._last: dict[bytes, int] = {}

    def take(self, line: bytes) -> None:
        """Take a message: topic, blank, payload."""
        topic, _, payload = line.partition(b" ")
        if not payload or topic.endswith(b"/quality"):
            return
        if payload.startswith(b"{"):
            for name, number in NUMBER.findall(payload):
                self._count(topic + name, number)
        elif payload[0] in b"0123456789":
            self._count(topic, payload)

    def _count(self, name: bytes, number: bytes) -> None:
        word = int(number.replace(b".", b""))
        before = self._last.get(name)
        if before is not None:
            self.missing += (word - before - 1) % WORDS
        self._last[name] = word
        self.values += 1


def read(stream: subprocess.Popen[bytes], count: Count) -> None:
    """Count until the subscriber ends."""
    assert stream.stdout is not None  # noqa: S101 - it was asked for
    for line in stream.stdout:
        count.take(line)


def main(port: str, publish: str, qos: str) -> None:
    """Answer until the standard input ends."""
    topics = ["fed/fed/+/state"] if publish == "state" else [f"fed/fed/+/{name}" for name in NAMES]
    options = [option for topic in topics for option in ("-t", topic)]
    command = [program("mosquitto_sub"), "-p", port, "-q", qos, *options, "-F", "%t %p"]
    count = Count()
    with subprocess.Popen(command, stdout=subprocess.PIPE, bufsize=READ) as subscriber:
        threading.Thread(target=read, args=(subscriber, count), daemon=True).start()
        for line in sys.stdin:
            if line.strip() == "pid":
                print(json.dumps({"pid": subscriber.pid}), flush=True)
            else:
                told = {"values": count.values, "missing": count.missing, "time": time.monotonic()}
                print(json.dumps(told), flush=True)
        subscriber.terminate()


NAMES = ("output_frequency", "output_current", "input_voltage", "output_voltage", "output_power")

if __name__ == "__main__":
    main(*sys.argv[1:4])
