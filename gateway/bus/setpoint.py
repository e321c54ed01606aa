"""The words that a controlled drive is given: with every block read in one frame, or by writes of their own.

17H and X write what F870 and F871 in force select and read what F875-F879 select (E6581657 4.1.3, 5.1.6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gateway.bus.blocks import PlannedRead, Planner
from gateway.bus.work import Learnt, Task, Work
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Exchange, ReadBlock, ReadWords, Request, WriteRam
from gateway.site import Drive


def selected(model: Model, facts: Mapping[str, int]) -> tuple[str, ...]:
    """Return the names of the registers that F870 and F871 select by what was read; () where that is not known."""
    connector = model.connector()
    names = connector.block_write if connector else ()
    codes = [facts.get(name) for name in names]
    if not names or any(code not in model.write_selectors for code in codes):
        return ()
    return tuple(model.write_selectors[code] for code in codes if code is not None)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Words for registers by name, the ones that act last behind those that they need: frequency, then command."""

    words: Mapping[str, int]

    def fits(self, block: Sequence[str], model: Model, codec: Codec) -> bool:
        """Say whether the block in force carries all of it, in a model and a protocol that have the exchange."""
        has_form = codec.forms.has_exchange and model.blocks.has_exchange
        return has_form and len(set(block) - {""}) == len(self.words) and set(self.words) <= set(block)

    def exchange(self, read: ReadBlock, block: Sequence[str], model: Model) -> Exchange:
        """Return the frame that writes the setpoint and reads the block."""
        words = tuple(self.words.get(name, 0) for name in block)
        return Exchange(read.number, read.address, read.count, model.blocks.indirect_write_address, words)

    def writes(self, number: int, model: Model) -> list[tuple[Register, WriteRam]]:
        """Return the writes that do the same one by one, in order."""
        registers = [model.registers[name] for name in self.words]
        return [(r, WriteRam(number, r.address, self.words[r.name])) for r in registers]

    def is_held(self, register: Register, word: int) -> bool:
        """Say whether a register reads back what it was given."""
        return word & register.mask == self.words.get(register.name, 0) & register.mask


@dataclass(slots=True)
class Control:
    """The setpoint of one drive on its way: with every block read where that is possible, else written once.

    `block` are the registers that F870 and F871 select by what was read of them; they may not be in force, so
    the first exchange with a setpoint is read back.
    """

    drive: Drive
    planner: Planner
    block: tuple[str, ...] = ()
    setpoint: Setpoint | None = None
    _has_block_poll: bool = False
    _is_proven: bool = False

    @property
    def uses_exchange(self) -> bool:
        """Say whether the setpoint goes with the block reads."""
        if self.setpoint is None or not self._has_block_poll:
            return False
        return self.setpoint.fits(self.block, self.drive.model, self.planner.codec)

    def take(self, setpoint: Setpoint | None, *, has_block: bool) -> Learnt:
        """Take a new setpoint, or None to end it; `has_block` says whether the drive's polls use the block."""
        self.setpoint, self._has_block_poll = setpoint, has_block
        self._is_proven = False
        if setpoint is None or self.uses_exchange:
            return Learnt()
        model = self.drive.model
        once = [Work(Task.SETPOINT, write, register=r) for r, write in setpoint.writes(self.drive.number, model)]
        return Learnt(once=once, notes=["the setpoint goes by writes of its own: no exchange carries it"])

    def with_setpoint(self, read: Request) -> Request:
        """Return the exchange that a block read becomes, or the read itself."""
        if self.setpoint is None or not self.uses_exchange or not isinstance(read, ReadBlock):
            return read
        return self.setpoint.exchange(read, self.block, self.drive.model)

    def exchanged(self, failed: Sequence[int]) -> Learnt:
        """Take what became of an exchange's writes."""
        if self.setpoint is None:
            return Learnt()
        if failed:
            names = ", ".join(self.block[place] for place in failed)
            return self.without_exchange(f"not written by the block: {names}")
        if self._is_proven:
            return Learnt()
        self._is_proven = True
        return Learnt(once=[self._verification(self.drive.model.registers[name]) for name in self.setpoint.words])

    def written(self, register: Register) -> Learnt:
        """Take the acknowledgement of a write: it is read back."""
        return Learnt(once=[self._verification(register)])

    def _verification(self, register: Register) -> Work:
        request = ReadWords(self.drive.number, register.address)
        return Work(Task.VERIFY, request, PlannedRead(request, (register,)), register)

    def verified(self, read: PlannedRead, word: int) -> Learnt:
        """Take what a register reads back."""
        learnt = Learnt(read.values([word]))
        register = read.registers[0]
        if self.setpoint is None or register.name not in self.setpoint.words or self.setpoint.is_held(register, word):
            return learnt
        reason = f"{register.name} reads back {word:04X}H"
        if self.uses_exchange:
            instead = self.without_exchange(f"{reason}: F870 and F871 are not in force")
            instead.words = learnt.words
            return instead
        learnt.warnings.append(f"{reason}, not what was written")
        return learnt

    def without_exchange(self, reason: str) -> Learnt:
        """Give the exchange up until the drive is set up anew, and write the setpoint by itself."""
        self.block = ()
        learnt = self.take(self.setpoint, has_block=self._has_block_poll)
        learnt.warnings.append(f"{reason}; single writes instead")
        return learnt
