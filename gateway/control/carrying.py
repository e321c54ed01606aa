"""Which commands go in the one frame that also reads the block, where a drive is known to take them so.

17H and X write what F870 and F871 in force select, and read what F875-F879 select (E6581657 4.1.3, 5.1.6). Nothing is
carried but what somebody has commanded: a word that is only repeated would set a drive in motion that was reset
meanwhile. Whether F870 and F871 are in force is found out by `gateway.bus.trial`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gateway.control.composing import COMMAND, FREQUENCY
from gateway.control.execution import Execution, Phase
from gateway.errors import Refusal, Refused
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Exchange, ReadBlock, WriteRam


@dataclass(frozen=True, slots=True)
class Form:
    """What an exchange reads and writes: a drive's block read, and the registers that F870 and F871 select."""

    read: ReadBlock
    write_address: int
    names: tuple[str, ...]

    def is_usable(self, codec: Codec) -> bool:
        """Say whether commands can go by it: FA00 and FA01, where a drive takes both or none of two words.

        Where it takes each by itself (X) the command alone goes, as the first of one word: 17H always writes two, so
        that one which nothing seems to select is no place for a word that nobody has commanded.
        """
        if codec.forms.writes_all_or_none:
            return len(self.names) == 2 and set(self.names) == {COMMAND, FREQUENCY}
        return self.names[:1] == (COMMAND,) and not any(self.names[1:])

    @property
    def written(self) -> tuple[str, ...]:
        """Return the names of the registers that it writes, in order."""
        return tuple(name for name in self.names if name)

    def exchange(self, words: Mapping[str, int]) -> Exchange:
        """Return the frame that writes these words, by name, and reads the block."""
        given = tuple(words[name] for name in self.written)
        return Exchange(self.read.number, self.read.address, self.read.count, self.write_address, given)


@dataclass(slots=True)
class Carrying:
    """The exchange of one drive; `form` is None where it has none that is proven."""

    form: Form | None = None

    def carried(self, execution: Execution) -> tuple[Exchange, int] | None:
        """Return the frame that takes the next writes of a command along, and how many; None where none does."""
        form = self.form
        if form is None or execution.phase is not Phase.WRITING or execution.is_alone or execution.is_stop:
            return None
        writes = execution.ahead[: len(form.written)]
        words = {write.register.name: write.word for write in writes if isinstance(write.request, WriteRam)}
        if not execution.is_for_armed or words.keys() != set(form.written):
            return None
        return (form.exchange(words), len(writes)) if all(write.is_answered for write in writes) else None

    def was_refused(self, execution: Execution, refused: Refused, now: float) -> bool:
        """Take that a drive has refused an exchange that carried a command, which wrote nothing.

        The command goes on in frames of its own, which tell the word that is refused. Say whether the exchange was
        refused, and not a word: then nothing goes by it any more.
        """
        execution.is_alone = True
        execution.undone(now)
        if refused.reason is Refusal.RANGE:
            return False
        self.form = None
        return True


def selected(codes: Sequence[int | None], selectors: Mapping[int, str]) -> tuple[str, ...]:
    """Return the names of the registers that F870 and F871 select by what was read; () where that is not known."""
    if not codes or any(code not in selectors for code in codes):
        return ()
    return tuple(selectors[code] for code in codes if code is not None)
