"""What a simulated line says of its exchanges, on this machine's monotonic clock, and what a command waited for.

Processes of one machine share CLOCK_MONOTONIC; the journal counts from when the line was opened, which is found by
entering events between two looks at the clock.
"""

from __future__ import annotations

import time
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from gateway.sim.process import SimulatedLine

KEPT = 10_000  # entries of the journal
KNOWN_WITHIN = 0.0005  # seconds for the gateway to read a command: kernel and event loop
BRACKETS = 30  # events by which the line's clock is found; together they leave some 20 microseconds of doubt
HARMLESS = {"do": "force", "register": "status"}  # an event that changes nothing: what is true is read anyway


@dataclass(frozen=True, slots=True)
class Exchange:
    """A request and its answer, b"" for none. From the request's first bit to the last bit of either, in seconds."""

    begin: float
    end: float
    request: bytes
    answer: bytes = b""


@dataclass(frozen=True, slots=True)
class Wait:
    """How a command came to the line, in seconds.

    `whole`: from when it was sent to the first bit of its frame. `beyond`: the same without the rest of the exchange
    in flight and the gap behind it. `slipped_in`: how long after it was sent others still began.
    """

    begin: float
    whole: float
    beyond: float
    slipped_in: tuple[float, ...]


def exchanges(entries: Iterable[dict[str, Any]], opened: float = 0.0) -> list[Exchange]:
    """Pair requests with what was heard before the next one; `opened` is added to every time."""
    found: list[Exchange] = []
    for entry in sorted(entries, key=lambda each: each["begin"]):
        begin, end = entry["begin"] + opened, entry["end"] + opened
        if entry["way"] == "request":
            found.append(Exchange(begin, end, bytes.fromhex(entry["data"])))
        elif entry["way"] == "heard" and found and "data" in entry:
            last = found[-1]
            found[-1] = Exchange(last.begin, end, last.request, last.answer + bytes.fromhex(entry["data"]))
    return found


def opened(line: SimulatedLine, drive: int = 1) -> float:
    """Return when the line was opened, in monotonic seconds."""
    between: list[tuple[float, float]] = []
    for _ in range(BRACKETS):
        before = time.monotonic()
        line.do(HARMLESS | {"drive": drive})
        between.append((before, time.monotonic()))
    events: list[float] = [entry["begin"] for entry in line.log(10 * BRACKETS) if entry["way"] == "event"][-BRACKETS:]
    pairs = list(zip(between, events, strict=True))
    earliest = max(before - event for (before, _), event in pairs)
    latest = min(after - event for (_, after), event in pairs)
    return (earliest + latest) / 2


def read(line: SimulatedLine, since: float = 0.0) -> list[Exchange]:
    """Return the latest exchanges of a line that began since then, some thousands at most."""
    entries = line.log(KEPT)
    return [exchange for exchange in exchanges(entries, opened(line)) if exchange.begin >= since]


def wait(sent: float, known: float, first: bytes, found: Sequence[Exchange], gap: float) -> Wait | None:
    """Return how the command came to the line whose frame begins with these bytes; None where it never did.

    `known` is when the broker had told it, or when it was sent. In flight is what began before that, or so soon after
    it that the gateway could not know of it yet.
    """
    place = bisect_left(found, sent, key=_begin)
    behind = next((i for i in range(place, len(found)) if found[i].request.startswith(first)), None)
    if behind is None:
        return None
    begin = found[behind].begin
    in_flight = found[: min(behind, bisect_left(found, known + KNOWN_WITHIN, key=_begin))]
    free = max([sent, *(exchange.end + gap for exchange in in_flight[-1:])])
    slipped_in = tuple(exchange.begin - sent for exchange in found[place:behind])
    return Wait(begin, begin - sent, begin - free, slipped_in)


def _begin(exchange: Exchange) -> float:
    return exchange.begin


def late(found: Sequence[Exchange], gap: float) -> Iterator[tuple[float, bytes]]:
    """Yield how much longer than the gap each request came after an answer, in seconds, and the request."""
    for before, after in pairwise(found):
        if before.answer:
            yield after.begin - before.end - gap, after.request


def longest(found: Sequence[Exchange]) -> float:
    """Return the longest time from one request to the next: the most that a command has to wait for."""
    return max(after.begin - before.begin for before, after in pairwise(found))
