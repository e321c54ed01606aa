"""What the answer to a poll or a check is worth: which words are believed, and what makes the set-up begin anew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from gateway.bus import selectors
from gateway.bus.blocks import PlannedRead
from gateway.bus.poll_jobs import PollJobs
from gateway.bus.proving import Proving
from gateway.bus.provision import RESET_MARK
from gateway.bus.reading import BLOCK_MODE, DISPLAY_NOTE, Reading
from gateway.bus.set_up import SetUp
from gateway.bus.work import Learnt, Task, Work
from gateway.protocol.pdu import ReadBlock, ReadWords

BELIEVED_FOR = 1.0  # seconds for which a block that looks like text is believed after FA80 was read as 0


class PollAnswers:
    """Judges what a drive says while it is polled."""

    def __init__(self, reading: Reading, jobs: PollJobs, proving: Proving, set_up: SetUp) -> None:
        self._reading = reading
        self._jobs = jobs
        self._proving = proving
        self._set_up = set_up
        self._no_text_until = float("-inf")

    def polled(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        """Take the words of a poll."""
        reading = self._reading
        if isinstance(read.request, ReadBlock):
            reading.busy_blocks = reading.silent_polls = 0
            if self._may_be_text(read, words, now):
                reading.no_text = tuple(words)  # believed from the answer on that FA80 is 0
                register = reading.drive.model.registers[BLOCK_MODE]
                return Learnt(once=[Work(Task.BLOCK_MODE, ReadWords(reading.drive.number, register.address))])
            return self._block_polled(read, words, now)
        if reading.refusals:
            reading.refusals -= Counter(register.name for register in read.registers)
        values = read.values(words)
        once = [Work(Task.POLL, r.request, r) for r in map(reading.alone, read.doubtful(words))]
        proof = reading.proof
        if any(proof.is_told_by(register, word) for register, word in zip(read.registers, words, strict=False)):
            proof.again()
            learnt = self._proving.next(now)
            return Learnt(values, jobs=learnt.jobs, once=once)
        return Learnt(values, once=once)

    def _block_polled(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        """Take the block: what is not believed yet is read alone."""
        audit = self._reading.audit
        if audit is None:
            return Learnt(read.values(words))
        stirred = audit.stirred(words)
        if not audit.block(words):
            self._reading.audit = None
            learnt = self._set_up.begin(now)
            learnt.warnings.append("the block no longer carries what it did: the drive was reset or set anew")
            return learnt
        untrusted = audit.untrusted(words)
        withheld = {register.address for register in untrusted}
        checked = {register.name: register for register in (*untrusted, *stirred)}
        once = [Work(Task.CONFIRM, r.request, r) for r in map(self._reading.alone, checked.values())]
        return Learnt([pair for pair in read.values(words) if pair[0] not in withheld], once=once)

    def _may_be_text(self, read: PlannedRead, words: Sequence[int], now: float) -> bool:
        """Say whether a block may be the display's text, and FA80 has to be looked at before it is believed."""
        reading = self._reading
        if BLOCK_MODE not in reading.drive.model.registers or not selectors.may_be_display(words):
            reading.no_text = ()
            return False
        is_like = len(reading.no_text) == len(words) and all(
            register is None or selectors.agree(register, word, before, before)
            for register, word, before in zip(read.carries, words, reading.no_text, strict=True)
        )
        return not (is_like and now < self._no_text_until)

    def block_mode(self, word: int, now: float) -> Learnt:
        """Take FA80: 1 takes the block away until it is 0 again."""
        reading = self._reading
        if word != 1:
            self._no_text_until = now + BELIEVED_FOR
            return Learnt()
        if reading.able.mapping is None:
            return Learnt()
        reading.proof.candidates = [reading.able.mapping]
        reading.able = replace(reading.able, mapping=None)
        reading.facts[BLOCK_MODE] = 1
        return Learnt(jobs=self._jobs.polls(now), notes=[DISPLAY_NOTE])

    def checked(self, read: PlannedRead, words: Sequence[int]) -> Learnt:
        """Take a single read that the block is held against."""
        if self._reading.audit is None:
            return Learnt()
        self._reading.audit.single(read.registers[0], words[0])
        return Learnt(read.values(words))

    def rechecked(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        """Take a look at what somebody else may change."""
        facts, registers = self._reading.facts, self._reading.drive.model.registers
        found = {r.name: word for r, word in zip(read.carries, words, strict=True) if r is not None}
        changed = [name for name, word in found.items() if facts.get(name) not in (None, word)]
        if not changed:
            return Learnt(read.values(words))
        learnt = self._set_up.begin(now)
        titles = ", ".join(registers[name].title or name for name in changed)
        if RESET_MARK in changed:
            learnt.notes.append("the drive was reset")
        else:
            learnt.warnings.append(f"changed by somebody else: {titles}; a selector acts after a reset of the drive")
        return learnt
