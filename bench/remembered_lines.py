"""Many wire-timed lines in one process, for so little of the processor that a gateway beside it can be measured.

Each request is answered by a real simulated drive once; from then on its answer is remembered. Time is kept as on the
wire: 11-bit characters out, 3.5 of silence, 5 ms in the drive, 12-bit characters back.
`python -m bench.remembered_lines LINES DRIVES BAUD` prints the ports, then answers each line of its standard input
with what each RS485 line has counted since the last one, and ends with its standard input.
"""

from __future__ import annotations

import asyncio
import heapq
import itertools
import json
import os
import pty
import sys
import tty
from dataclasses import dataclass, field

import uvloop

from bench.whole_gateway import simulated
from gateway.clock import Clock, SystemClock
from gateway.protocol.timing import LineTiming
from gateway.sim import settings
from gateway.sim.drive import SimulatedDrive

PROCESSING = 0.005  # seconds, of the simulated drives
READ_SIZE = 4096
LENGTHS = {0x2B: 7}  # of requests, by function; all others that poll have 8 bytes
LENGTH = 8
EARLY = 2e-4  # seconds by which a frame may come too soon: what the two processes' clocks may be apart


@dataclass(slots=True)
class RememberedLine:
    """One line: its port, its drives, and what it has counted. Times in monotonic seconds."""

    timing: LineTiming
    drives: dict[int, SimulatedDrive]
    own: int
    name: str
    answers: dict[bytes, bytes] = field(default_factory=dict)
    received: bytearray = field(default_factory=bytearray)
    quiet_from: float = 0.0
    busy: float = 0.0
    first: float = 0.0  # the last request that was counted before
    last: float = 0.0  # the last one of all
    requests: int = 0
    violations: int = 0
    late: list[float] = field(default_factory=list)

    def request(self, now: float) -> tuple[float, bytes] | None:
        """Take what has come; return when which answer has to be there, None while nothing is to be answered."""
        try:
            self.received += os.read(self.own, READ_SIZE)
        except BlockingIOError:
            return None
        if len(self.received) < 2 or len(self.received) < LENGTHS.get(self.received[1], LENGTH):
            return None
        frame = bytes(self.received)
        self.received.clear()
        self.requests += 1
        self.last = now
        self.violations += now < self.quiet_from - EARLY
        answer = self._answer(frame, now)
        if answer is None:
            return None
        cost = self.timing.exchange(len(frame), len(answer), PROCESSING)
        self.busy += cost
        self.quiet_from = now + cost
        return now + cost - self.timing.gap, answer

    def _answer(self, frame: bytes, now: float) -> bytes | None:
        known = self.answers.get(frame)
        if known is None and frame[0] in self.drives:
            known, _ = self.drives[frame[0]].handle(frame, now)
            if known is not None:
                self.answers[frame] = known
        return known

    def counted(self) -> dict[str, float]:
        """Return what was counted since the last time, and begin anew; the `whole` requests took so many seconds."""
        late = sorted(self.late)
        told = {
            "busy": self.busy,
            "requests": self.requests,
            "whole": self.last - self.first,
            "violations": self.violations,
            "late_p99": late[int(0.99 * len(late))] if late else 0.0,
        }
        self.busy, self.requests, self.violations, self.late = 0.0, 0, 0, []
        self.first = self.last
        return told


def opened(drives: int, baud: int, now: float) -> RememberedLine:
    """Open a pty for a line of drives."""
    own, others = pty.openpty()
    tty.setraw(others)
    os.set_blocking(own, False)
    wire = settings.build(simulated(baud, drives, running_at=30.0), now)
    return RememberedLine(LineTiming(baud), {drive.number: drive for drive in wire.drives}, own, os.ttyname(others))


class Pending:
    """The answers that are under way on all lines, the next one first."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._alarm = clock.alarm()
        self._heap: list[tuple[float, int, RememberedLine, bytes]] = []
        self._order = itertools.count()

    def hear(self, line: RememberedLine) -> None:
        """Take a request of a line, if one is there."""
        found = line.request(self._clock.now())
        if found is not None:
            heapq.heappush(self._heap, (found[0], next(self._order), line, found[1]))
            self._alarm.ring()

    async def run(self) -> None:
        """Send each answer at its time, for ever."""
        while True:
            while self._heap and self._heap[0][0] <= (now := self._clock.now()):
                when, _, line, answer = heapq.heappop(self._heap)
                line.late.append(now - when)
                os.write(line.own, answer)
            await self._alarm.wait_until(self._heap[0][0] if self._heap else self._clock.now() + 1.0)


async def serve(count: int, drives: int, baud: int) -> None:
    """Serve until the standard input ends."""
    clock, loop = SystemClock(), asyncio.get_running_loop()
    lines = [opened(drives, baud, clock.now()) for _ in range(count)]
    pending = Pending(clock)
    for line in lines:
        loop.add_reader(line.own, pending.hear, line)
    task = asyncio.create_task(pending.run())
    print(json.dumps([line.name for line in lines]), flush=True)
    reader = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while await reader.readline():
        print(json.dumps([line.counted() for line in lines]), flush=True)
    task.cancel()


if __name__ == "__main__":
    uvloop.run(serve(*map(int, sys.argv[1:4])))
