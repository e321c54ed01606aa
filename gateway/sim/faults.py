"""Faults of a line: what becomes of requests and answers on their way, decided by chance with a seed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from random import Random

Range = tuple[float, float]  # the least and the most of what is drawn by chance

LATE = 0.5  # seconds, where a late answer does not say how late
DUPLICATE_AFTER = 0.005  # seconds between an answer and its copy
PAUSE = 0.02  # seconds between the halves of a split answer: what USB adapters make of two packets
BABBLE = 5  # bytes, where babble does not say how many


class Kind(Enum):
    """What goes wrong."""

    CUT = "cut"  # the request does not arrive: at one drive, or at none
    REQUEST_FLIP = "request_flip"  # `value` bits of the request arrive wrong
    DROP = "drop"  # the answer is lost; the drive did what it was asked
    LATE = "late"  # the answer begins `value` seconds later
    DUPLICATE = "duplicate"  # the answer comes again, `value` seconds after its end
    TRUNCATE = "truncate"  # only the first `value` bytes of the answer come
    SPLIT = "split"  # the answer pauses for `value` seconds, at a byte chosen by chance
    FLIP = "flip"  # `value` bits of the answer are wrong
    ECHO = "echo"  # the adapter hands the master's own bytes back
    BABBLE = "babble"  # `value` bytes of noise stand before the answer


@dataclass(slots=True)
class Fault:
    """One fault: of one drive or, without any, of the whole line.

    `drive` is the drive itself, whatever its number becomes, or a number, whoever has it.
    It strikes with `probability`, at most `count` times, from `after` until `until` (seconds of the line's time).
    A `value` of two numbers is drawn evenly between them each time it strikes.
    """

    kind: Kind
    drive: object | None = None
    value: float | Range | None = None
    probability: float = 1.0
    count: int | None = None
    after: float = 0.0
    until: float = math.inf

    def is_of(self, whose: Collection[object]) -> bool:
        """Say whether this is a fault of a drive that goes by one of those; of the line, where there are none."""
        return self.drive in whose if whose else self.drive is None


@dataclass(frozen=True, slots=True)
class Sending:
    """Bytes that a drive puts on the line, how many seconds later than it would, and the faults in them."""

    delay: float
    data: bytes
    note: str = ""


class Faults:
    """All faults of a line."""

    def __init__(self, rng: Random, faults: Iterable[Fault] = ()) -> None:
        self._rng = rng
        self._faults = list(faults)
        self.struck: Counter[str] = Counter()  # how often, by kind

    @property
    def all(self) -> Sequence[Fault]:
        """Return the faults that have not been ended, those that have struck out included."""
        return tuple(self._faults)

    def add(self, fault: Fault) -> None:
        """Let a fault begin."""
        self._faults.append(fault)

    def clear(self, whose: Collection[object] | None = None, kind: Kind | None = None) -> int:
        """End faults: all, or those of a drive (of just the line, where `whose` is empty), of a kind, or both."""
        kept = [
            fault
            for fault in self._faults
            if (whose is not None and not fault.is_of(whose)) or (kind is not None and fault.kind is not kind)
        ]
        ended, self._faults = len(self._faults) - len(kept), kept
        return ended

    def strikes(self, kind: Kind, whose: Collection[object], now: float) -> Fault | None:
        """Return the first fault of a drive or of its line that strikes now, and count it; None where none does."""
        return self._strikes(kind, now, lambda fault: fault.drive is None or fault.drive in whose)

    def _strikes(self, kind: Kind, now: float, concerns: Callable[[Fault], bool]) -> Fault | None:
        for fault in self._faults:
            if fault.kind is kind and concerns(fault) and fault.after <= now < fault.until:
                if fault.count == 0 or self._rng.random() >= fault.probability:
                    continue
                if fault.count is not None:
                    fault.count -= 1
                self.struck[kind.value] += 1
                return fault
        return None

    # -- on the way to the drives ---------------------------------------------------------------------------

    def heard(self, request: bytes, whose: Collection[object], now: float) -> bytes | None:
        """Return what arrives of a request at a drive or, where `whose` is empty, on the line; None for nothing."""
        if self._strikes(Kind.CUT, now, lambda fault: fault.is_of(whose)):
            return None
        if fault := self._strikes(Kind.REQUEST_FLIP, now, lambda fault: fault.is_of(whose)):
            return self._flipped(request, self._number(fault, 1, 8 * len(request)))
        return request

    # -- on the way back ------------------------------------------------------------------------------------

    def sendings(self, answer: bytes, whose: Collection[object], now: float) -> list[Sending]:
        """Return what comes of an answer: nothing, or sendings in their order, each after the one before."""
        if self.strikes(Kind.DROP, whose, now):
            return []
        data, notes = self._damaged(answer, whose, now)
        delay = 0.0
        if fault := self.strikes(Kind.LATE, whose, now):
            delay = self._seconds(fault, LATE)
            notes.append(fault.kind.value)
        pieces = [Sending(delay, data, " ".join(notes))]
        if len(data) > 1 and (fault := self.strikes(Kind.SPLIT, whose, now)):
            pieces = self._split(pieces[0], self._seconds(fault, PAUSE))
        if fault := self.strikes(Kind.DUPLICATE, whose, now):
            copied = " ".join([*notes, fault.kind.value])
            pieces.append(Sending(self._seconds(fault, DUPLICATE_AFTER), data, copied))
        return pieces

    def _damaged(self, answer: bytes, whose: Collection[object], now: float) -> tuple[bytes, list[str]]:
        """Return the bytes that come of an answer, and the kinds of the faults in them."""
        data, kinds = answer, []
        if fault := self.strikes(Kind.FLIP, whose, now):
            data = self._flipped(data, self._number(fault, 1, 8 * len(data)))
            kinds.append(fault.kind.value)
        if fault := self.strikes(Kind.TRUNCATE, whose, now):
            data = data[: self._number(fault, len(data) - 1, len(data) - 1)]
            kinds.append(fault.kind.value)
        if fault := self.strikes(Kind.BABBLE, whose, now):
            data = self.noise(self._number(fault, BABBLE)) + data
            kinds.append(fault.kind.value)
        return data, kinds

    def _split(self, whole: Sending, pause: float) -> list[Sending]:
        place = self._rng.randrange(1, len(whole.data))
        note = f"{whole.note} {Kind.SPLIT.value}".strip()
        return [Sending(whole.delay, whole.data[:place], note), Sending(pause, whole.data[place:], note)]

    # -- by chance ------------------------------------------------------------------------------------------

    def _seconds(self, fault: Fault, usual: float) -> float:
        """Return a fault's value in seconds, or what is usual."""
        if isinstance(fault.value, tuple):
            return self._rng.uniform(*fault.value)
        return usual if fault.value is None else fault.value

    def _number(self, fault: Fault, usual: int, most: int | None = None) -> int:
        """Return a fault's value as a whole number, or what is usual."""
        return usual if fault.value is None else self.counted(fault.value, most)

    def counted(self, amount: float | Range, most: int | None = None) -> int:
        """Return an amount as a whole number; one that is drawn is not more than `most`."""
        if not isinstance(amount, tuple):
            return int(amount)
        low, high = (int(value) if most is None else min(int(value), most) for value in amount)
        return self._rng.randint(low, high)

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
