"""How long after its time a poll is answered at the worst, for every poll of a line: proved before anything runs.

The line is a processor that serves one exchange at a time, earliest deadline first, and never breaks one off. Some
exchanges go ahead of all polls (commands, looks for resets, tries of silent drives). Polls without a period come, one
round of them in each `turn`, out of what the others leave. For that there is an exact theory: a poll is answered
latest when all as urgent falls due together, just behind the longest exchange that is less urgent; one case for
each time at which the poll itself may fall due while the line is busy has to be looked at (George, Rivierre, Spuri:
Preemptive and Non-Preemptive Real-Time UniProcessor Scheduling, INRIA 2966, 1996). Times are in seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, floor, isfinite

SLACK = 0.2  # share of what the timed polls leave that is not promised to those without a period
LEAST_REST = 0.1  # share of the line that polls without a period are promised at the least
MOST_CASES = 1000  # that are gone through for one period, before only the bound is given that holds for any load
FOR_EVER = 120.0  # seconds
EVEN = 1e-9  # seconds: sums of periods differ by less


@dataclass(frozen=True, slots=True)
class Stream:
    """An exchange of `cost` seconds that comes again after `period` at the soonest; 0: as the line allows."""

    period: float
    cost: float


@dataclass(frozen=True, slots=True)
class _Class:
    """The polls of one period: what all of them take together, and the longest and the shortest of them."""

    period: float
    total: float
    longest: float
    shortest: float


def turn(load: float, round_: float) -> float:
    """Return in what time each poll without a period is promised one exchange, where the others take `load`."""
    return round_ / max(LEAST_REST, (1 - SLACK) * (1 - load))


@dataclass(frozen=True)
class Traffic:
    """What one line carries: its polls, and what goes ahead of them. `reserved` is a share that is kept free."""

    polls: Sequence[Stream]
    ahead: Sequence[Stream] = ()
    reserved: float = 0.0

    @cached_property
    def load(self) -> float:
        """Return the share of the line that all but the polls without a period take."""
        return sum(stream.cost / stream.period for stream in (*self.polls, *self.ahead) if stream.period)

    @cached_property
    def turn(self) -> float:
        """Return in what time each poll without a period is promised one exchange; 0 where there are none."""
        round_ = sum(stream.cost for stream in self.polls if not stream.period)
        return turn(self.load + self.reserved, round_)

    @property
    def fastest(self) -> float:
        """Return in what time each poll without a period mostly has its turn, the line being free for them."""
        round_ = sum(stream.cost for stream in self.polls if not stream.period)
        return round_ / max(LEAST_REST, 1 - self.load)

    @cached_property
    def _timed(self) -> tuple[_Class, ...]:
        return tuple(_classes(self.polls))

    @cached_property
    def _rest(self) -> _Class | None:
        costs = [stream.cost for stream in self.polls if not stream.period]
        return _Class(self.turn, sum(costs), max(costs), min(costs)) if costs else None

    @cached_property
    def worst(self) -> Mapping[float, float]:
        """Return for each period how long after its time a poll is answered at the most.

        For a poll without a period that counts from its last answer: one turn, and the response of the next run.
        """
        found = {one.period: min(self._latest(one), self._for_any_load(one.period)) for one in self._timed}
        if (rest := self._rest) is not None:
            found[0.0] = min(
                rest.period + self._latest(rest), self._for_any_load(2 * rest.period), self._turns_taken(rest)
            )
        return found

    @cached_property
    def late(self) -> tuple[float, ...]:
        """Return the periods of polls that may be answered after they fall due again; 0: not within two turns."""
        return tuple(period for period, late in self.worst.items() if late > (period or 2 * self.turn) + EVEN)

    @property
    def is_kept(self) -> bool:
        """Say whether every poll is answered before it falls due again."""
        return not self.late

    @cached_property
    def _all(self) -> tuple[_Class, ...]:
        return (*self._timed, self._rest) if self._rest is not None else self._timed

    # ---- what holds for any load: nothing starves

    def _for_any_load(self, deadline: float) -> float:
        """Return how long a poll may wait even on an overfull line: past its deadline, each other goes first once."""
        everything = sum(one.total for one in self._all)
        blocking = max(one.longest for one in self._all)
        ahead = sum(stream.cost / stream.period for stream in self.ahead)
        if ahead >= 1:
            return float("inf")
        return (deadline + everything + blocking + 2 * sum(stream.cost for stream in self.ahead)) / (1 - ahead)

    def _turns_taken(self, rest: _Class) -> float:
        """Return how long all that has a period, and one round of the others, can keep a poll without one waiting."""
        if self.load >= 1:
            return float("inf")

        def work(time: float) -> float:
            timed = sum(one.total * (2 + floor(time / one.period + EVEN)) for one in self._timed)
            return rest.total + rest.longest + timed + self._ahead_within(time, waiting=1)

        return _fixed(work)

    def _ahead_within(self, time: float, waiting: int = 0) -> float:
        """Return what goes ahead of all polls within that time, where so many of each wait at its beginning."""
        return sum(stream.cost * (waiting + 1 + floor(time / stream.period + EVEN)) for stream in self.ahead)

    # ---- the exact response, where the line is not overfull

    def _latest(self, own: _Class) -> float:
        """Return the longest response of the polls of a period: the worst of all times at which one may fall due."""
        longest, before, time = float("-inf"), float("inf"), 0.0
        for case in self._cases(own):
            blocking = self._blocking(case + own.period)
            time = self._answered(own, case, blocking, time if blocking == before else 0.0)
            longest, before = max(longest, own.longest, time - case), blocking
        return longest if isfinite(longest) else float("inf")

    def _cases(self, own: _Class) -> Sequence[float]:
        """Return the times since the line became busy at which a poll of that period is to be looked at.

        They are those at which its deadline is another's: between them nothing more goes ahead. None where too many.
        """
        busy = self._busy
        if sum(busy / one.period for one in self._all) > MOST_CASES:
            return ()
        cases = {0.0}
        for one in self._all:
            first = max(0, ceil((own.period - one.period) / one.period - EVEN))
            for count in range(first, floor((busy + own.period) / one.period) + 1):
                cases.add(max(0.0, (count + 1) * one.period - own.period))
        return sorted(case for case in cases if case < busy)

    @cached_property
    def _busy(self) -> float:
        """Return the longest time in which the line may be busy without a pause; infinite where it is overfull."""
        promised = self._rest.total / self._rest.period if self._rest is not None else 0.0
        if self.load + promised >= 1 - EVEN:
            return float("inf")
        blocking = max((one.longest for one in self._all), default=0.0)

        def work(time: float) -> float:
            polls = sum(one.total * ceil(time / one.period - EVEN) for one in self._all)
            return blocking + polls + self._ahead_within(time)

        return _fixed(work)

    def _answered(self, own: _Class, case: float, blocking: float, time: float) -> float:
        """Return when a poll is answered that falls due so long after the line became busy: not before `time`."""
        deadline = case + own.period
        fixed = blocking + own.total * (1 + floor(case / own.period + EVEN))
        others = [
            (one.total, one.period, 1 + floor((deadline - one.period) / one.period + EVEN))
            for one in self._all
            if one is not own and one.period <= deadline + EVEN
        ]

        def work(time: float) -> float:
            begun = max(0.0, time - own.shortest)
            urgent = sum(total * min(most, 1 + floor(begun / period + EVEN)) for total, period, most in others)
            return fixed + urgent + self._ahead_within(begun)

        return _fixed(work, max(fixed, time))

    def _blocking(self, deadline: float) -> float:
        """Return the longest exchange that may be under way though it is less urgent: the line was free."""
        less_urgent = [one.longest for one in self._timed if one.period > deadline + EVEN]
        if self._rest is not None:
            less_urgent.append(self._rest.longest)
        return max(less_urgent, default=0.0)


def _classes(polls: Iterable[Stream]) -> Iterable[_Class]:
    costs: dict[float, list[float]] = {}
    for stream in polls:
        if stream.period:
            costs.setdefault(stream.period, []).append(stream.cost)
    return (_Class(period, sum(each), max(each), min(each)) for period, each in sorted(costs.items()))


def _fixed(work: Callable[[float], float], time: float = 0.0) -> float:
    """Return the first time by which the work that has come by then is done; infinite beyond two minutes."""
    while (needed := work(time)) > time + EVEN:
        time = needed
        if time > FOR_EVER:
            return float("inf")
    return time
