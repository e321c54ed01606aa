"""The proof of a block's mapping before it is used: block, single reads, block, and they must agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from gateway.bus import selectors
from gateway.bus.blocks import Abilities, BlockMapping, PlannedRead, Planner
from gateway.bus.work import Task, Work
from gateway.drives.register import Register
from gateway.protocol.pdu import ReadBlock, ReadWords
from gateway.site import Drive


@dataclass(slots=True)
class Proof:
    """Tries the mappings that may be in force, in order. `singles` are the words of the last one's single reads.

    `proven` is the mapping that agreed; `refuted` the last one that did not; `untold` one of which all words were 0,
    so that nothing can be said of it yet.
    """

    drive: Drive
    planner: Planner
    candidates: list[BlockMapping] = field(default_factory=list)
    proven: BlockMapping | None = None
    refuted: BlockMapping | None = None
    untold: BlockMapping | None = None
    singles: dict[str, int] = field(default_factory=dict)
    _blocks: list[tuple[int, ...]] = field(default_factory=list)
    _steps: list[Work] = field(default_factory=list)
    _tries: int = 0

    def propose(self, mapping: BlockMapping | None, *, first: bool = False) -> None:
        """Take one more mapping that may be in force."""
        if mapping is not None and mapping not in self.candidates:
            self.candidates.insert(0 if first else len(self.candidates), mapping)

    def begin(self) -> None:
        """Begin anew with the candidates there are."""
        self.proven = self.refuted = self.untold = None
        self._tries = 0
        self._steps = []

    def drop(self) -> None:
        """Give the candidate under trial up: the drive refuses what would prove it."""
        self.candidates.pop(0)
        self._steps = []

    def next(self, able: Abilities) -> Work | None:
        """Return the next step; None when a mapping is proven, or none is left."""
        if self._steps:
            return self._steps.pop(0)
        while self.candidates and self.proven is None:
            block = self._block(self.candidates[0], able)
            if block is not None:
                edge = Work(Task.PROVE_BLOCK, block.request, block)
                self._blocks, self.singles = [], {}
                self._steps = [*(self._single(r) for r in block.registers if r.name in self.drive.points), edge]
                return edge
            self.candidates.pop(0)  # brings nothing that is wanted, or not cheaper than other reads
        return None

    def _block(self, mapping: BlockMapping, able: Abilities) -> PlannedRead | None:
        wanted = {r.name: r for r in mapping if r is not None and r.name in self.drive.points}
        with_it = Abilities(mapping=mapping, no_direct=able.no_direct)
        reads = self.planner.plan(list(wanted.values()), with_it) if wanted else ()
        return next((read for read in reads if isinstance(read.request, ReadBlock)), None)

    def _single(self, register: Register) -> Work:
        request = ReadWords(self.drive.number, register.address)
        return Work(Task.PROVE_SINGLE, request, PlannedRead(request, (register,)))

    def take(self, work: Work, words: Sequence[int]) -> bool | None:
        """Take the words of a step; say whether the mapping is right, None while that is not known."""
        if work.task is Task.PROVE_BLOCK:
            self._blocks.append(tuple(words))
        elif work.read is not None:
            self.singles[work.read.registers[0].name] = words[0]
        if self._steps:
            return None
        mapping = self.candidates[0]
        is_right = selectors.fits(mapping, self._blocks[0], self._blocks[-1], self.singles)
        self._tries += 1
        if not is_right and self._tries < selectors.PROOFS:
            return None
        self._tries = 0
        self.candidates.pop(0)
        if is_right and not selectors.is_telling(mapping, self._blocks[-1], self.singles):
            self.untold = mapping
            return None
        if is_right:
            self.proven, self.refuted = mapping, None
            self.candidates.clear()
        else:
            self.refuted = mapping
        return is_right

    def is_told_by(self, register: Register, word: int) -> bool:
        """Say whether a value that was read makes it worth trying a mapping again of which all words were 0."""
        return self.untold is not None and register in self.untold and bool(word & register.mask)

    def again(self) -> None:
        """Try that mapping again."""
        self.propose(self.untold, first=True)
        self.begin()
