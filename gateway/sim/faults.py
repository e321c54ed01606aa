"""Faults of a line: what becomes of an answer on its way to the master, decided by chance with a seed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from random import Random

LATE = 0.5  # seconds, where a late answer does not say how late
DUPLICATE_AFTER = 0.005  # seconds between an answer and its copy
BABBLE = 5  # bytes, where babble does not say how many


class Kind(Enum):
    """What goes wrong."""

    DROP = "drop"  # the answer is lost; the drive did what it was asked
    LATE = "late"  # the answer begins `value` seconds later
    DUPLICATE = "duplicate"  # the answer comes again, `value` seconds after its end
    TRUNCATE = "truncate"  # only the first `value` bytes of the answer come
    FLIP = "flip"  # `value` bits of the answer are wrong
    ECHO = "echo"  # the adapter hands the master's own bytes back
    BABBLE = "babble"  # `value` bytes of noise stand before the answer
    CUT = "cut"  # the drive hears nothing


@dataclass(slots=True)
class Fault:
    """One fault: for the answers of one drive or, without a number, of all on the line.

    It strikes with `probability`, at most `count` times, from `after` until `until` (seconds of the line's time).
    """

    kind: Kind
    drive: int | None = None
    value: float | None = None
    probability: float = 1.0
    count: int | None = None
    after: float = 0.0
    until: float = math.inf

    def amount(self, usual: float) -> float:
        """Return `value`, or what is usual for this kind."""
        return usual if self.value is None else self.value


@dataclass(frozen=True, slots=True)
class Sending:
    """Bytes that a drive puts on the line, and how many seconds later than it would."""

    delay: float
    data: bytes


class Faults:
    """All faults of a line."""

    def __init__(self, rng: Random, faults: Iterable[Fault] = ()) -> None:
        self._rng = rng
        self._faults = list(faults)

    @property
    def all(self) -> Sequence[Fault]:
        """Return the faults that have not been ended, those that have struck out included."""
        return tuple(self._faults)

    def add(self, fault: Fault) -> None:
        """Let a fault begin."""
        self._faults.append(fault)

    def clear(self, drive: int | None = None, kind: Kind | None = None) -> int:
        """End faults: all, or those of one drive, one kind or both; return how many."""
        kept = [
            fault
            for fault in self._faults
            if (drive is not None and fault.drive != drive) or (kind is not None and fault.kind is not kind)
        ]
        ended, self._faults = len(self._faults) - len(kept), kept
        return ended

    def strikes(self, kind: Kind, drive: int | None, now: float) -> Fault | None:
        """Return the first fault of that kind that strikes now, and count it; None where none does."""
        for fault in self._faults:
            if fault.kind is kind and fault.drive in (None, drive) and fault.after <= now < fault.until:
                if fault.count == 0 or self._rng.random() >= fault.probability:
                    continue
                if fault.count is not None:
                    fault.count -= 1
                return fault
        return None

    def sendings(self, answer: bytes, drive: int, now: float) -> list[Sending]:
        """Return what comes of an answer: nothing, or one or more sendings in their order."""
        if self.strikes(Kind.DROP, drive, now):
            return []
        late = self.strikes(Kind.LATE, drive, now)
        delay = late.amount(LATE) if late else 0.0
        data = self._damaged(answer, drive, now)
        sendings = [Sending(delay, data)]
        if fault := self.strikes(Kind.DUPLICATE, drive, now):
            sendings.append(Sending(fault.amount(DUPLICATE_AFTER), data))
        return sendings

    def _damaged(self, answer: bytes, drive: int, now: float) -> bytes:
        data = answer
        if fault := self.strikes(Kind.FLIP, drive, now):
            data = self._flipped(data, int(fault.amount(1)))
        if fault := self.strikes(Kind.TRUNCATE, drive, now):
            data = data[: int(fault.amount(len(data) - 1))]
        if fault := self.strikes(Kind.BABBLE, drive, now):
            data = self.noise(int(fault.amount(BABBLE))) + data
        return data

    def _flipped(self, data: bytes, bits: int) -> bytes:
        number = int.from_bytes(data, "big")
        for bit in self._rng.sample(range(8 * len(data)), min(bits, 8 * len(data))):
            number ^= 1 << bit
        return number.to_bytes(len(data), "big")

    def noise(self, count: int) -> bytes:
        """Return random bytes."""
        return self._rng.randbytes(count)

    def collided(self, data: bytes) -> bytes:
        """Return what is heard of bytes that were sent on top of others: each one wrong."""
        return bytes(byte ^ self._rng.randrange(1, 256) for byte in data)
