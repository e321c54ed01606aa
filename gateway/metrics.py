"""What the daemon counts of itself: plain numbers, cheap to add to and read by whoever shows them."""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from math import ceil

from gateway.backlog import BacklogStats

ANSWER_BOUNDS = (0.005, 0.01, 0.015, 0.02, 0.03, 0.05, 0.1, 0.25, 0.5, 1.0)  # seconds
QUANTILES = (0.5, 0.95, 0.99)
LATEST = 1024  # answers of one drive that quantiles are taken from: 25 s of a drive that has its line to itself
GAP_BOUNDS = (0.001, 0.002, 0.0025, 0.003, 0.005, 0.01, 0.05, 0.1, 0.5, 1.0, 5.0)  # seconds


class Histogram:
    """Counts of observations up to each bound, and beyond the last."""

    __slots__ = ("bounds", "counts", "total")

    def __init__(self, bounds: Sequence[float]) -> None:
        self.bounds = tuple(bounds)
        self.counts = [0] * (len(self.bounds) + 1)
        self.total = 0.0

    def observe(self, value: float) -> None:
        """Count one observation."""
        self.counts[bisect_left(self.bounds, value)] += 1
        self.total += value

    @property
    def count(self) -> int:
        """Return the number of observations."""
        return sum(self.counts)

    def cumulated(self) -> list[int]:
        """Return the number of observations up to each bound, and last of all of them."""
        return list(accumulate(self.counts))

    def quantile(self, share: float) -> float:
        """Return the bound below which that share of the observations lies; the last bound past it, 0 without any."""
        wanted = share * self.count
        if not wanted:
            return 0.0
        seen = 0
        for bound, count in zip(self.bounds, self.counts, strict=False):
            seen += count
            if seen >= wanted:
                return bound
        return self.bounds[-1]


class AnswerTimes(Histogram):
    """How long answers took: counted by bounds, the latest kept for exact quantiles, the longest for good."""

    __slots__ = ("_latest", "_place", "longest")

    def __init__(self) -> None:
        super().__init__(ANSWER_BOUNDS)
        self._latest = array("d")
        self._place = 0
        self.longest = 0.0

    def observe(self, value: float) -> None:
        """Count one answer; the oldest of the latest gives way."""
        super().observe(value)
        self.longest = max(self.longest, value)
        if len(self._latest) < LATEST:
            self._latest.append(value)
        else:
            self._latest[self._place] = value
            self._place = (self._place + 1) % LATEST

    def latest(self) -> dict[float, float]:
        """Return the quantiles of the latest answers, each a time that was measured; none before the first."""
        ordered = sorted(self._latest)
        return {share: ordered[ceil(share * len(ordered)) - 1] for share in QUANTILES if ordered}


@dataclass(slots=True)
class Responses:
    """How long after its time the polls of a group were answered at the worst, in seconds, against what was reckoned.

    `predicted` holds while every drive answers, `disturbed` while exchanges are lost now and then. `late` counts
    answers later than `predicted`, `very_late` those later than `disturbed`.
    """

    predicted: float
    disturbed: float
    worst: float = 0.0
    late: int = 0
    very_late: int = 0

    def observe(self, seconds: float) -> None:
        """Take one response."""
        if seconds > self.worst:
            self.worst = seconds
        if seconds > self.predicted:
            self.late += 1
            if seconds > self.disturbed:
                self.very_late += 1


@dataclass(slots=True)
class LineStats:
    """One RS485 line. `busy` sums the seconds in which the wire and the drives were necessarily busy.

    `is_low_latency` and `has_echo` say what is known of the adapter, None for nothing.
    """

    is_up: bool = False
    opened: int = 0
    exchanges: int = 0
    busy: float = 0.0
    errors: Counter[str] = field(default_factory=Counter)
    gaps: Histogram = field(default_factory=lambda: Histogram(GAP_BOUNDS))
    load: float = 0.0
    rate: float = 0.0
    is_low_latency: bool | None = None
    has_echo: bool | None = None


@dataclass(slots=True)
class DriveStats:
    """One drive. `answers` is the time from the end of a request to the end of its answer.

    `eeprom_writes` counts requests that write the EEPROM, by communication number, whatever became of them.
    `communication_timeout` is F803 in seconds, 0 where it is off or not known; `least_margin` is how close the gaps
    between two answers came to it, inf before the first. `commands` counts results by status and reason, `events`
    what happened to permission; `standing` says whether it may be set in motion, "" where nobody may command it.
    `responses` are those of its polls, by their period in seconds, 0 as fast as possible.
    """

    exchanges: int = 0
    timeouts: int = 0
    bad_replies: int = 0
    refusals: int = 0
    answers: AnswerTimes = field(default_factory=AnswerTimes)
    longest_gap: float = 0.0
    last_heard: float = float("-inf")
    eeprom_writes: Counter[int] = field(default_factory=Counter)
    communication_timeout: float = 0.0
    least_margin: float = float("inf")
    commands: Counter[tuple[str, str]] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    standing: str = ""
    responses: dict[float, Responses] = field(default_factory=dict)


@dataclass(slots=True)
class MqttStats:
    """The MQTT side, and what controllers send by it.

    `ignored` counts messages that mean nothing, `refused`, by reason, commands that did not come to the door, and
    `untold` results and events that could not be told. `missed` counts what is kept while the broker is away.
    `certificates` are UTC seconds at which a certificate of this connection expires, by what it is.
    """

    is_connected: bool = False
    connects: int = 0
    published: int = 0
    dropped: int = 0
    heard: int = 0
    ignored: int = 0
    inbox_dropped: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    untold: int = 0
    waiting: int = 0
    missed: BacklogStats = field(default_factory=BacklogStats)
    certificates: dict[str, float] = field(default_factory=dict)


@dataclass(slots=True)
class TcpStats:
    """The MODBUS-TCP server.

    `not_allowed` counts clients that `allow` does not name, `denied` requests that rights refused, `handshakes` those
    of TLS by how they ended; `certificates` are UTC seconds at which a certificate expires, by what it is.
    """

    connections: int = 0
    accepted: int = 0
    turned_away: int = 0
    not_allowed: int = 0
    denied: int = 0
    handshakes: Counter[str] = field(default_factory=Counter)
    certificates: dict[str, float] = field(default_factory=dict)
    requests: Counter[int] = field(default_factory=Counter)
    exceptions: Counter[int] = field(default_factory=Counter)


@dataclass(slots=True)
class Stats:
    """Everything that is counted, by line and drive name, and by broker ("" is one without a name).

    `started` is UTC seconds.
    """

    started: float
    lines: dict[str, LineStats] = field(default_factory=dict)
    drives: dict[str, DriveStats] = field(default_factory=dict)
    brokers: dict[str, MqttStats] = field(default_factory=dict)
    sparkplug: MqttStats = field(default_factory=MqttStats)
    tcp: TcpStats = field(default_factory=TcpStats)
