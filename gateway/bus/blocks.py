"""Which exchanges read the wanted registers in the least time on the wire."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import ReadBlock, ReadWords, Request
from gateway.protocol.timing import LineTiming

HOLE = 0x8000  # what a direct block carries where no number exists (E6581657 5.1.3): not a value

BlockMapping = tuple[Register | None, ...]  # what each word of the indirect block carries, as far as trusted


@dataclass(frozen=True, slots=True)
class PlannedRead:
    """One read and what its words stand for: a register per word, None for a word that is not wanted."""

    request: ReadWords | ReadBlock
    carries: BlockMapping

    @property
    def registers(self) -> tuple[Register, ...]:
        """Return the registers that this read brings."""
        return tuple(register for register in self.carries if register is not None)

    @property
    def is_direct_block(self) -> bool:
        """Say whether holes are possible."""
        return isinstance(self.request, ReadWords) and self.request.count > 1

    def values(self, words: Sequence[int]) -> list[tuple[int, int]]:
        """Return (communication number, word) for each word that is a value for certain."""
        pairs = zip(self.carries, words, strict=True)
        return [
            (register.address, word)
            for register, word in pairs
            if register is not None and not (self.is_direct_block and word == HOLE)
        ]

    def doubtful(self, words: Sequence[int]) -> list[Register]:
        """Return the registers whose word of a direct block may be a hole: only a single read tells."""
        if not self.is_direct_block:
            return []
        return [r for r, word in zip(self.carries, words, strict=True) if r is not None and word == HOLE]


@dataclass(frozen=True, slots=True)
class Abilities:
    """What one drive is known to be able to do now.

    `mapping` is the indirect block in force, or None where it cannot be used. `no_direct` are areas (see
    `area`) in which a direct block was refused; `only_single` are registers to be read alone.
    """

    mapping: BlockMapping | None = None
    no_direct: frozenset[int] = frozenset()
    only_single: frozenset[str] = frozenset()


def area(address: int) -> int:
    """Return what a refusal of a direct block is remembered for: FA, FB ... or 0 for all parameters."""
    return address >> 8 if address >= 0xFA00 else 0


@dataclass(frozen=True, slots=True)
class Planner:
    """Plans reads for one drive: number, model, protocol, line arithmetic, and its processing time in seconds."""

    number: int
    model: Model
    codec: Codec
    timing: LineTiming
    processing: float

    def cost(self, request: Request) -> float:
        """Return the seconds that an exchange takes, gap to gap."""
        size, answer = len(self.codec.encode(request)), self.codec.answer_size(request)
        return self.timing.exchange(size, answer, self.processing)

    def time(self, reads: Iterable[PlannedRead]) -> float:
        """Return the seconds that these reads take together."""
        return sum(self.cost(read.request) for read in reads)

    @property
    def has_block(self) -> bool:
        """Say whether model and protocol have the indirect block."""
        return self.codec.forms.has_block and self.model.blocks.indirect_read_maximum > 0

    def plan(self, wanted: Sequence[Register], able: Abilities) -> tuple[PlannedRead, ...]:
        """Return the reads that bring every wanted register once, in the least wire time.

        Each length of the indirect block is tried with the best direct blocks and singles for the rest.
        """
        candidates = []
        for block in self._indirect_blocks(able):
            brought = {register.name for register in block.registers}
            rest = [register for register in wanted if register.name not in brought]
            if len(rest) < len(wanted):
                candidates.append((block, *self._direct(rest, able)))
        candidates.append(self._direct(wanted, able))  # last: of equal plans the block, which no drive disputes
        return min(candidates, key=self.time)

    def _indirect_blocks(self, able: Abilities) -> Iterable[PlannedRead]:
        forms = self.model.blocks
        if able.mapping is None or not self.has_block:
            return
        longest = min(forms.indirect_read_maximum, len(able.mapping))
        for count in range(forms.indirect_read_minimum, longest + 1):
            request = ReadBlock(self.number, forms.indirect_read_address, count)
            yield PlannedRead(request, able.mapping[:count])

    def _direct(self, wanted: Sequence[Register], able: Abilities) -> tuple[PlannedRead, ...]:
        """Split the wanted registers into direct blocks and singles: the cheapest split, found from the end."""
        order = sorted(wanted, key=lambda register: register.address)
        best: list[tuple[float, tuple[PlannedRead, ...]]] = [(0.0, ())]
        for first in range(len(order) - 1, -1, -1):
            options = []
            for last in range(first, len(order)):
                read = self._one_read(order[first : last + 1], able)
                if read is None:
                    break
                cost, rest = best[len(order) - 1 - last]
                options.append((cost + self.cost(read.request), (read, *rest)))
            best.append(min(options, key=lambda option: option[0]))
        return best[-1][1]

    def _one_read(self, run: Sequence[Register], able: Abilities) -> PlannedRead | None:
        """Return the read of a run of registers; None where one block cannot bring them."""
        start = run[0].address
        if len(run) == 1:
            return PlannedRead(ReadWords(self.number, start), (run[0],))
        if not self.codec.forms.has_direct_block:
            return None
        span = run[-1].address - start + 1
        if span > self.model.blocks.direct_read_maximum or area(start) != area(run[-1].address):
            return None
        if area(start) in able.no_direct or any(register.name in able.only_single for register in run):
            return None
        at = {register.address: register for register in run}
        return PlannedRead(
            ReadWords(self.number, start, span), tuple(at.get(start + offset) for offset in range(span))
        )
