"""The words that a controlled drive is given with every read of its block: all of it in one frame.

17H and X write what F870 and F871 in force select and read what F875-F879 select (E6581657 4.1.3, 5.1.6).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from gateway.bus.blocks import PlannedRead
from gateway.bus.work import Learnt, Task, Work
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Exchange, ReadBlock, ReadWords, Request
from gateway.site import Drive

COMMAND = "command"  # FA00
AGAIN = 5  # block reads, after which a reading back that was not answered is repeated


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

    def is_held(self, register: Register, word: int) -> bool:
        """Say whether a register reads back what it was given."""
        return word & register.mask == self.words.get(register.name, 0) & register.mask


class Stage(Enum):
    """How far it is known that the exchange writes what F870 and F871 say."""

    LOOKING = "reading FA00"
    TRIAL = "writing harmless words"
    CHECKING = "reading them back"
    PROVEN = "carrying the setpoint"


@dataclass(slots=True)
class Control:
    """A setpoint on its way with every block read of one drive.

    `block` are the registers that F870 and F871 select by what was read of them. They may not be in force, and a
    frequency in the place of the command would be obeyed as one: so the exchange is tried with harmless words
    first, while nothing is commanded (FA00 is 0), and each new setpoint is read back. Whatever is odd ends it:
    the setpoint is not kept for a drive that was lost, reset or set anew (SAFETY.md H12).
    """

    drive: Drive
    block: tuple[str, ...] = ()
    setpoint: Setpoint | None = None
    _stage: Stage = Stage.LOOKING
    _sent: Setpoint | None = None  # the words that the last exchange wrote
    _unread: set[str] = field(default_factory=set)  # of these, the registers that were not read back yet
    _polls: int = 0

    def take(self, setpoint: Setpoint | None, *, has_block: bool) -> Learnt:
        """Take a new setpoint, or None to end it; `has_block` says whether the drive's polls use the block."""
        if setpoint is None:
            self.end("")
            return Learnt()
        is_new, self.setpoint = self.setpoint is None, setpoint
        if not has_block or not setpoint.fits(self.block, self.drive.model, self.drive.codec):
            return self.end("no exchange of this drive carries it")
        return Learnt(once=self._verifications([COMMAND]) if is_new else [])  # else the proof goes on, or is done

    def end(self, reason: str) -> Learnt:
        """Carry nothing any more; the exchange has to be proven again."""
        had, self.setpoint, self._stage = self.setpoint is not None, None, Stage.LOOKING
        self._sent, self._polls = None, 0
        self._unread.clear()
        return Learnt(warnings=[f"the setpoint is not carried by the block: {reason}"] if had else [])

    def with_setpoint(self, read: Request) -> Request:
        """Return the exchange that a block read becomes, or the read itself."""
        if self.setpoint is None or not isinstance(read, ReadBlock):
            return read
        if self._stage not in (Stage.TRIAL, Stage.PROVEN):
            return read
        given = self.setpoint if self._stage is Stage.PROVEN else self._trial
        if given != self._sent:
            self._sent, self._unread = given, set(given.words)
        return given.exchange(read, self.block, self.drive.model)

    @property
    def _trial(self) -> Setpoint:
        """Return words that move nothing wherever they arrive, and are told apart when they are read back.

        In FA00 they select a preset speed without command priority and without run (E6581657 7.1).
        """
        names = dict.fromkeys(name for name in self.block if name)
        return Setpoint({name: place for place, name in enumerate(names, 1)})

    def exchanged(self, failed: Sequence[int]) -> Learnt:
        """Take what became of an exchange's writes."""
        if self.setpoint is None:
            return Learnt()
        if failed:
            return self.end(f"not written: {', '.join(self.block[place] for place in failed)}")
        if self._stage is Stage.TRIAL:
            self._stage = Stage.CHECKING
        return Learnt(once=self._verifications(sorted(self._unread)))

    def _verifications(self, names: Iterable[str]) -> list[Work]:
        registers = [self.drive.model.registers[name] for name in names]
        reads = [PlannedRead(ReadWords(self.drive.number, r.address), (r,)) for r in registers]
        return [Work(Task.VERIFY, read.request, read, read.registers[0]) for read in reads]

    def polled(self) -> Learnt:
        """Take note of a block read without words: a reading back that was lost is asked for again."""
        if self.setpoint is None or self._stage not in (Stage.LOOKING, Stage.CHECKING):
            return Learnt()
        self._polls += 1
        if self._polls % AGAIN:
            return Learnt()
        return Learnt(once=self._verifications([COMMAND] if self._stage is Stage.LOOKING else sorted(self._unread)))

    def verified(self, read: PlannedRead, word: int) -> Learnt:
        """Take what a register reads back."""
        learnt = Learnt(read.values([word]))
        register = read.registers[0]
        if self.setpoint is None or self._stage is Stage.TRIAL:  # asked for before: it says nothing of the trial
            return learnt
        if self._stage is Stage.LOOKING:
            is_right, follows = word & register.mask == 0, Stage.TRIAL
        else:
            self._unread.discard(register.name)
            is_right = self._sent is not None and self._sent.is_held(register, word)
            follows = self._stage if self._unread else Stage.PROVEN
        if not is_right:
            learnt.warnings += self.end(f"{register.name} reads {word:04X}H").warnings
            return learnt
        self._stage = follows
        return learnt
