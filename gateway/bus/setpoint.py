"""The words that a controlled drive is given: with every block read in one frame, or by writes of their own.

17H and X write what F870 and F871 in force select and read what F875-F879 select (E6581657 4.1.3, 5.1.6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Exchange, ReadBlock, WriteRam


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
