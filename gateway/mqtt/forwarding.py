"""Decides what of a backlog is sent next, and when: in order, paced, and never before what is live. Pure.

Nothing is let go before the broker is known to have it. What is sent and not known to be there when a connection is
lost stays in the backlog, and is sent again by the next one: as history, twice at the worst, and never as live.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from gateway.backlog import Kept

P = TypeVar("P")

WINDOW = 8  # parcels on their way at a time: Mosquitto takes 20 as installed, and the rest is for what is live
FETCHED = 100  # readings that are asked for at a time
BURST = 0.05  # seconds that sending may lag behind its pace and catch up with
WHILE_FULL = 0.2  # seconds between looks whether the broker has any of what is under way; see `Receipts` for QoS 0
ASK_AGAIN = 1.0  # seconds, after there was nothing to be sent


@dataclass(frozen=True, slots=True)
class Parcel(Generic[P]):
    """One message: how many values it has, and which reading is sent as a whole with it, 0 for none."""

    what: P
    values: int
    number: int = 0


class Forwarder(Generic[P]):
    """One broker. `unpack` makes the messages of a reading; one without any cannot be sent, and is let go."""

    def __init__(self, rate: float, unpack: Callable[[Kept], Sequence[Parcel[P]]], window: int = WINDOW) -> None:
        self._rate = rate
        self._unpack = unpack
        self._window = window
        self._parcels: deque[Parcel[P]] = deque()
        self._under_way: deque[tuple[int, Callable[[], bool]]] = deque()
        self._numbers: set[int] = set()  # of readings that are here or under way
        self._after = 0
        self._without: frozenset[str] = frozenset()
        self._turn = 0  # which question is the one that counts
        self._is_asking = False
        self._ask_at = float("-inf")
        self._free_at = float("-inf")

    # ---- the connection

    def begin(self) -> None:
        """Begin anew with the oldest: nothing that was under way is known to be there."""
        self._under_way.clear()
        self._numbers.clear()
        self._start_over()

    def _start_over(self) -> None:
        self._numbers -= {parcel.number for parcel in self._parcels}
        self._parcels.clear()
        self._after = 0
        self._turn += 1
        self._is_asking = False
        self._ask_at = float("-inf")

    def pass_over(self, drives: frozenset[str]) -> None:
        """Leave out the readings of some drives, for as long as nothing else is said."""
        if drives != self._without:
            self._without = drives
            self._start_over()

    # ---- the backlog

    def question(self, now: float) -> tuple[int, int, frozenset[str], int] | None:
        """Return what to ask the backlog for: after which number, how many, without whom, and the turn; or None."""
        if self._is_asking or len(self._parcels) > self._window or now < self._ask_at:
            return None
        self._is_asking = True
        return self._after, FETCHED, self._without, self._turn

    def take(self, kept: Iterable[Kept], turn: int, now: float) -> list[int]:
        """Take the answer; return the numbers of readings that nothing can be done with."""
        if turn != self._turn:
            return []
        self._is_asking = False
        useless, count = [], 0
        for each in kept:
            count += 1
            self._after = each.number
            if each.number in self._numbers:
                continue
            parcels = self._unpack(each)
            if not parcels:
                useless.append(each.number)
                continue
            self._numbers.add(each.number)
            self._parcels.extend(parcels)
        if count < FETCHED:
            self._ask_at = now + ASK_AGAIN
        return useless

    # ---- the broker

    @property
    def is_full(self) -> bool:
        """Say whether no more may be under way."""
        return len(self._under_way) >= self._window

    @property
    def is_waiting(self) -> bool:
        """Say whether anything is sent and not known to be there."""
        return bool(self._under_way)

    def is_due(self, now: float) -> bool:
        """Say whether something may be sent now."""
        return bool(self._parcels) and not self.is_full and now >= self._free_at

    def next(self, now: float) -> Parcel[P]:
        """Return what is sent next, and reckon with it; something must be due."""
        parcel = self._parcels.popleft()
        self._free_at = max(self._free_at, now - BURST) + parcel.values / self._rate
        return parcel

    def sent(self, parcel: Parcel[P], is_there: Callable[[], bool]) -> None:
        """Take that a parcel is under way; `is_there` says whether the broker has it."""
        self._under_way.append((parcel.number, is_there))

    def settle(self) -> list[int]:
        """Return the numbers of readings that the broker has as a whole; they are let go."""
        done = []
        while self._under_way and self._under_way[0][1]():
            number, _ = self._under_way.popleft()
            if number:
                self._numbers.discard(number)
                done.append(number)
        return done

    def patience(self, now: float, most: float) -> float:
        """Return for how many seconds nothing need be looked at here, at the most so many."""
        if self._parcels:
            return min(most, WHILE_FULL if self.is_full else max(0.0, self._free_at - now))
        return most if self._is_asking else min(most, max(0.0, self._ask_at - now))
