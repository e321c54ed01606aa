"""Whether a drive takes command and frequency in the one frame that also reads its block, and which commands go so.

17H and X write what F870 and F871 in force select, and read what F875-F879 select (E6581657 4.1.3, 5.1.6). What is
set may not be in force, and a frequency in the place of the command would be obeyed as one. So the exchange is tried
while the drive is being armed and stands still, with words that move nothing wherever they arrive; they are read
back, and what stood there before is written again. Nothing is ever carried but what somebody has commanded: a word
that is only repeated would set a drive in motion that was reset meanwhile.

Pure: it is told what was answered.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from gateway.control.composing import COMMAND, FREQUENCY, HELD_FREQUENCY
from gateway.control.execution import Execution, Phase
from gateway.drives.register import Register
from gateway.errors import Refusal, Refused
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Exchange, Exchanged, ReadBlock, ReadWords, Reply, Request, Words, WriteRam
from gateway.site import Drive

log = logging.getLogger("gateway.control")

STATUS = "status"  # FD01
RUNNING = "running"
# FA00: a preset speed, without priority and without run; in FA50 no terminal has these bits (E6581657 7.1, 7.2)
TRIAL = {COMMAND: 4, FREQUENCY: 8}


@dataclass(frozen=True, slots=True)
class Form:
    """What an exchange reads and writes: the block read that the polls use, and the registers F870, F871 select."""

    read: ReadBlock
    names: tuple[str, ...]

    @property
    def written(self) -> frozenset[str]:
        """Return the names of the registers that it writes."""
        return frozenset(self.names) - {""}

    def is_usable(self, codec: Codec) -> bool:
        """Say whether it writes FA00, alone or with FA01; both only where a drive takes both or none."""
        names = [name for name in self.names if name]
        is_whole = len(names) == 1 or codec.forms.writes_all_or_none
        return is_whole and COMMAND in names and self.written <= TRIAL.keys() and len(names) == len(self.written)


class Stage(Enum):
    """How far it is known that the exchange writes what F870 and F871 say."""

    UNTRIED = "untried"
    STANDING = "looking whether the motor stands"
    TRIAL = "writing harmless words"
    CHECKING = "reading them back"
    RESTORING = "writing what stood there"
    RESTORED = "reading that back"
    PROVEN = "carrying commands"
    GIVEN_UP = "not to be relied on"


READING = (Stage.CHECKING, Stage.RESTORED)
UNDER_WAY = (Stage.STANDING, Stage.TRIAL, Stage.CHECKING, Stage.RESTORING, Stage.RESTORED)


@dataclass(slots=True)
class Carrying:
    """The exchange of one drive. `form` is None where its polls have no block, or F870, F871 select nothing of use.

    `_owed` are words by register that were overwritten by a trial which came to nothing: they are written again,
    one by one, before anything else is tried.
    """

    drive: Drive
    form: Form | None = None
    stage: Stage = Stage.UNTRIED
    _before: dict[str, int] = field(default_factory=dict)
    _owed: dict[str, int] = field(default_factory=dict)
    _unread: list[str] = field(default_factory=list)
    _is_old: bool = False  # what is owed is from before the drive was looked at

    def offer(self, form: Form | None) -> None:
        """Take what the drive's polls and settings allow now; another form has to be proven anew."""
        form = form if form is not None and form.is_usable(self.drive.codec) else None
        if form != self.form:
            self._break_off()
            self.form, self.stage = form, Stage.UNTRIED

    def forget(self, *, was_reset: bool) -> None:
        """Take that the drive was lost, and may be another one; a reset has cleared what a trial wrote."""
        self._break_off()
        self.stage = Stage.UNTRIED
        if was_reset:
            self._owed.clear()

    def begin(self) -> None:
        """Take that the drive is being armed: a trial that was broken off, by a stop, begins anew."""
        if self.stage is not Stage.PROVEN:
            self._break_off()
            self.stage = Stage.UNTRIED
        self._owed.pop(COMMAND, None)
        self._is_old = bool(self._owed)

    def _break_off(self) -> None:
        """Remember what a trial has overwritten; FA00 is the affair of whoever broke it off."""
        if self.stage in UNDER_WAY and FREQUENCY in self._before:
            self._owed[FREQUENCY] = self._before[FREQUENCY]
        self._before.clear()
        self._unread.clear()

    # ---- the trial

    def next_step(self, facts: Mapping[str, int]) -> Request | None:
        """Return the next frame of the trial; None where it is over, or cannot be had. `facts` were just read."""
        if self._is_old and facts.get(HELD_FREQUENCY) != TRIAL[FREQUENCY]:  # somebody has written it, or a reset has
            self._owed.clear()
        self._is_old = False
        if self._owed:
            name, word = next(iter(self._owed.items()))
            return WriteRam(self.drive.number, self._register(name).address, word)
        if self.form is None or self.stage in (Stage.PROVEN, Stage.GIVEN_UP):
            return None
        if self.stage is Stage.UNTRIED and not self._begins(facts):
            return None
        match self.stage:
            case Stage.STANDING:
                return self._read(STATUS)
            case Stage.TRIAL:
                return self._exchange(self.form, TRIAL)
            case Stage.CHECKING | Stage.RESTORED:
                return self._read(self._unread[0])
            case _:
                return self._exchange(self.form, self._before)

    def _begins(self, facts: Mapping[str, int]) -> bool:
        """Note what stands where the trial writes; say whether it may begin: FA00 is 0, and the status can be had."""
        held = {COMMAND: facts.get(COMMAND), FREQUENCY: facts.get(HELD_FREQUENCY, facts.get(FREQUENCY))}
        before = {name: held[name] for name in self.form.written} if self.form is not None else {}
        registers = self.drive.model.registers
        if held[COMMAND] != 0 or None in before.values() or RUNNING not in registers[STATUS].bits.values():
            return False
        self._before = {name: word for name, word in before.items() if word is not None}
        self.stage = Stage.STANDING
        return True

    def _register(self, name: str) -> Register:
        return self.drive.model.registers[name]

    def _read(self, name: str) -> ReadWords:
        return ReadWords(self.drive.number, self._register(name).address)

    def _exchange(self, form: Form, words: Mapping[str, int]) -> Exchange:
        """Return the frame that writes words by name, and reads the block."""
        given = tuple(words[name] if name else 0 for name in form.names)
        address = self.drive.model.blocks.indirect_write_address
        return Exchange(self.drive.number, form.read.address, form.read.count, address, given)

    def answered(self, reply: Reply | None) -> None:
        """Take the answer to the frame of `next_step`."""
        if self._owed:
            self._owed.pop(next(iter(self._owed)))
        elif self.stage in (Stage.TRIAL, Stage.RESTORING) and isinstance(reply, Exchanged):
            self._written(reply)
        elif isinstance(reply, Words) and self.stage is Stage.STANDING:
            bits = self._register(STATUS).bits.items()
            is_running = any(name == RUNNING and reply.words[0] >> bit & 1 for bit, name in bits)
            self.stage = Stage.GIVEN_UP if is_running else Stage.TRIAL  # until it is armed again
        elif isinstance(reply, Words) and self.stage in READING:
            self._seen(reply.words[0])

    def _written(self, reply: Exchanged) -> None:
        if any(self.form.names[place] for place in reply.failed) if self.form is not None else True:
            self._fail("the drive does not write what F870 and F871 select")
            return
        self.stage = Stage.CHECKING if self.stage is Stage.TRIAL else Stage.RESTORED
        self._unread = sorted(self._before)

    def _seen(self, word: int) -> None:
        """Compare a word that was read back with what was written there."""
        register = self._register(self._unread.pop(0))
        expected = (TRIAL if self.stage is Stage.CHECKING else self._before)[register.name]
        if (word ^ expected) & register.mask:
            self._fail(f"{register.name} reads {word:04X}H; F870 and F871 may not be in force yet")
        elif not self._unread:
            self.stage = Stage.RESTORING if self.stage is Stage.CHECKING else Stage.PROVEN
            if self.stage is Stage.PROVEN:
                self._before.clear()

    def refused(self, refused: Refused) -> None:
        """Take a refusal of the frame of `next_step`."""
        if self._owed:
            log.warning("%s: %s cannot be written back: %s", self.drive.name, next(iter(self._owed)), refused)
            self._owed.pop(next(iter(self._owed)))
        else:
            self._fail(str(refused))

    def silent(self, text: str) -> None:
        """Take that the frame of `next_step` was not answered: what it wrote is written over again."""
        if not self._owed:
            self._fail(text)

    def _fail(self, reason: str) -> None:
        """Rely on it no more; what the trial may have overwritten is owed, the command first."""
        log.warning("%s: commands do not go with the block: %s", self.drive.name, reason)
        if self.stage in UNDER_WAY and self.stage is not Stage.STANDING:
            self._owed = dict(sorted(self._before.items()))
        self.stage = Stage.GIVEN_UP
        self._before.clear()
        self._unread.clear()

    # ---- carrying

    def carried(self, execution: Execution) -> tuple[Exchange, int] | None:
        """Return the frame that takes the next writes of a command along, and how many; None where none does."""
        if self.form is None or self.stage is not Stage.PROVEN:
            return None
        if execution.phase is not Phase.WRITING or execution.is_alone or not execution.is_for_armed:
            return None
        writes = execution.ahead[: len(self.form.written)]
        words = {write.register.name: write.word for write in writes if isinstance(write.request, WriteRam)}
        if execution.is_stop or words.keys() != self.form.written or not all(write.is_answered for write in writes):
            return None
        return self._exchange(self.form, words), len(writes)

    def was_refused(self, execution: Execution, refused: Refused, now: float) -> None:
        """Take that a drive has refused an exchange that carried a command, which wrote nothing.

        The command goes on in frames of its own, which tell the word that is refused; unless it is a word that was
        refused, and not the exchange, so do later ones.
        """
        execution.is_alone = True
        execution.undone(now)
        if refused.reason is not Refusal.RANGE:
            self._fail(str(refused))


def selected(codes: Sequence[int | None], selectors: Mapping[int, str]) -> tuple[str, ...]:
    """Return the names of the registers that F870 and F871 select by what was read; () where that is not known."""
    if not codes or any(code not in selectors for code in codes):
        return ()
    return tuple(selectors[code] for code in codes if code is not None)
