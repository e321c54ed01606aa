"""Reads what the gateway sends as a drive would, without being one: what would it write, and to whom."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from gateway.drives.model import BlockForms
from gateway.sim import frames
from gateway.sim.options import MODBUS_RTU, TOSHIBA

SELECTED = -1  # the address of a word that goes where F870 or F871 says


@dataclass(frozen=True, slots=True)
class Written:
    """One word for one drive, 0 for all of them."""

    number: int
    address: int
    word: int
    is_stored: bool


@dataclass(slots=True)
class _Recorder:
    """Stands for a drive's registers, and takes note of what is written to them."""

    blocks: BlockForms
    is_used: bool = False
    is_tripped: bool = False
    most_groups: int = 2
    has_proportional: bool = True
    writes: list[tuple[int, int, bool]] = field(default_factory=list)

    def read(self, address: int) -> int:
        self.is_used = True
        return 0

    def read_direct(self, first: int, count: int) -> Sequence[int]:
        self.is_used = True
        return [0] * count

    def read_block(self, count: int) -> Sequence[int]:
        self.is_used = True
        return [0] * count

    def write_stored(self, address: int, word: int) -> None:
        self.writes.append((address, word, True))

    def write_ram(self, address: int, word: int) -> None:
        self.writes.append((address, word, False))

    def write_block(self, words: Sequence[int]) -> None:
        self.writes += [(SELECTED, word, False) for word in words]

    def write_groups(self, words: Sequence[int]) -> Sequence[int]:
        self.write_block(words)
        return []

    def write_proportional(self, address: int, word: int, *, is_master_tripped: bool) -> None:
        self.writes.append((address, word, False))

    def identity(self) -> tuple[str, str]:
        self.is_used = True
        return "", "0000"


@dataclass(frozen=True, slots=True)
class Reading:
    """What one frame does: whom it is for, and what it writes."""

    numbers: frozenset[int]
    writes: tuple[Written, ...]


def read(frame: bytes, numbers: Iterator[int] | Sequence[int], blocks: BlockForms, *, is_toshiba: bool) -> Reading:
    """Read a frame as drives with these numbers do."""
    addressed, writes = set(), []
    for number in numbers:
        recorder = _Recorder(blocks)
        answer = frames.answer(TOSHIBA if is_toshiba else MODBUS_RTU, frame, number, recorder)
        if answer is not None or recorder.is_used or recorder.writes:
            addressed.add(number)
        writes += [Written(number, *write) for write in recorder.writes]
    return Reading(frozenset(addressed), tuple(writes))
