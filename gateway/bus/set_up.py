"""The set-up of a drive before its polls: who it is, how it is set, and its block selectors as they are wanted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gateway.bus import selectors
from gateway.bus.blocks import PlannedRead, area
from gateway.bus.identification import IDENTITY_REGISTERS
from gateway.bus.proving import Proving
from gateway.bus.provision import RESET_MARK, selector_registers
from gateway.bus.reading import BLOCK_MODE, Reading
from gateway.bus.work import Learnt, Task, Work
from gateway.control.watchdog import control_registers
from gateway.drives.register import Register
from gateway.errors import Refused
from gateway.protocol.pdu import Identity, ReadBlock, ReadWords, Request


class SetUp:
    """Reads, and where that is permitted writes, what must be known before a drive is polled."""

    def __init__(self, reading: Reading, proving: Proving) -> None:
        self._reading = reading
        self._proving = proving
        self._drive = reading.drive
        self._missing: list[Register] = []
        self._is_to_be_read_back = False

    # ---- who is there

    @property
    def is_doubtful(self) -> bool:
        """Say whether somebody answers, and what would tell another model is still to be asked."""
        return any(sign in self._missing for sign in self._reading.who.signs)

    def identified(self, identity: Identity, now: float) -> Learnt:
        """Take the answer of 2BH."""
        who = self._reading.who
        known = who.identity
        if stranger := who.is_stranger(identity):
            return self._stranger(stranger)
        return self._resumed(now) if known in (None, identity) else self.begin(now)

    def answers(self, register: Register, word: int, now: float) -> Learnt:
        """Take a plain read as the sign that somebody is there; the series code says who."""
        stranger = self._reading.who.is_other_model(register, word)
        return self._stranger(stranger) if stranger else self._resumed(now)

    def _stranger(self, reason: str) -> Learnt:
        self._reading.is_set_up = False
        self._reading.pending = None
        self._proving.trial.forget()
        return Learnt(stranger=reason)

    def _resumed(self, now: float) -> Learnt:
        """Go on where a lost frame broke in: with the polls, or with the step of the set-up that got no answer.

        A write to the EEPROM that got no answer may have been done: that is read before it is made again.
        """
        pending = self._reading.pending
        if self._reading.is_set_up:
            return Learnt(is_ready=True)
        if pending is not None and pending.task is Task.PROVE_BLOCK:
            learnt = self._proving.unanswered(now)
            if learnt is not None:
                return learnt
        if pending is not None and pending.task is Task.TRIAL:
            return self._proving.trial_unanswered(now)
        if pending is not None and pending.task is not Task.PROVISION:
            return Learnt(jobs=[self._reading.at_once(pending, now)])
        return self.begin(now)

    # ---- how it is set

    def begin(self, now: float) -> Learnt:
        """Read, one after another, what must be known before polling: identity codes, selectors, bases.

        It comes after a reset, another identity, or a change of the settings: what was refused before is tried again.
        """
        reading, model = self._reading, self._drive.model
        reading.is_set_up = False
        if self._proving.trial.is_under_way:
            self._proving.trial.forget()
        names = (*IDENTITY_REGISTERS, *((BLOCK_MODE, RESET_MARK) if reading.planner.has_block else ()))
        wanted = control_registers(self._drive)
        wanted += [model.registers[name] for name in names if name in model.registers]
        wanted += [*reading.selector_registers(), *self._drive.bases, *reading.who.signs]
        reading.proof.propose(reading.able.mapping, first=True)
        reading.forget_refusals()
        self._missing = list({register.name: register for register in wanted}.values())
        reading.facts.clear()
        return self._next_fact(now)

    def _next_fact(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        if not self._missing:
            return self._next_provision(now, notes)
        signs = [register for register in self._missing if register in self._reading.who.signs]
        read = self._reading.planner.plan(signs or self._missing, self._reading.able)[0]
        work = Work(Task.FACT, read.request, read)
        return Learnt(jobs=[self._reading.at_once(work, now)], notes=list(notes))

    def fact(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        """Take words of how it is set."""
        reading = self._reading
        doubtful = {register.name for register in read.doubtful(words)}
        told = set()
        for register, word in zip(read.carries, words, strict=True):
            if register is None or register.name in doubtful:
                continue
            told.add(register.name)
            if stranger := reading.who.is_other_model(register, word):
                return self._stranger(stranger)
            if register.name in self._drive.model.registers:
                reading.facts[register.name] = word & register.mask
        self._missing = [register for register in self._missing if register.name not in told]
        reading.able = replace(reading.able, only_single=reading.able.only_single | doubtful)
        return self._next_fact(now)

    def fact_refused(self, read: PlannedRead, refused: Refused, now: float) -> Learnt:
        """Take a refusal of such a read: other reads instead, or a word less that is known."""
        who = self._reading.who
        if read.is_direct_block:
            return self._next_fact(now, [no_direct(self._reading, read.request, refused)])
        known = who.signs
        who.refused(Work(Task.FACT, read.request, read), refused.reason)
        self._missing.remove(read.registers[0])
        self._missing += [sign for sign in who.signs if sign not in known]
        return self._next_fact(now)

    # ---- its block selectors

    def _next_provision(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        """Write the next selector that is not as wanted, if that is permitted; read all back; then the proof."""
        if not self._drive.provision or not self._would_use_block():
            return self._proving.start(now, notes)
        reading, provision, facts = self._reading, self._reading.provision, self._reading.facts
        mapping = reading.mapping_as_set()
        if not self._is_to_be_read_back:
            provision.read_back(facts)
        step = provision.next(facts)
        if step is None:
            return self._provisions_done(now, notes)
        register, request = step
        if register.name == RESET_MARK or not provision.awaits_reset(facts):
            reading.before = mapping
        provision.attempted(register)
        work = Work(Task.PROVISION, request, register=register)
        said = []
        if register.name != RESET_MARK:
            said = [f"{register.title or register.name}: {request.word} is written (was {facts[register.name]})"]
        return Learnt(jobs=[reading.at_once(work, now)], notes=[*notes, *said])

    def _provisions_done(self, now: float, notes: Sequence[str]) -> Learnt:
        """Read back what was written, then prove what is in force."""
        if self._is_to_be_read_back:
            self._is_to_be_read_back = False
            learnt = self.begin(now)
            learnt.notes += notes
            return learnt
        learnt = self._proving.start(now, notes)
        if self._reading.provision.is_at_its_end(self._reading.facts):
            learnt.warnings.append("F875-F879 are not as wanted, and are set once only: set them by hand")
        return learnt

    def _would_use_block(self) -> bool:
        """Say whether the block would be used with the best selectors: else they are not worth a write."""
        planner = self._reading.planner
        mapping = selectors.mapping_of(self._drive.model, selectors.best(self._drive))
        able = replace(self._reading.able, mapping=mapping)
        reads = (read for group in self._drive.groups for read in planner.plan(group.registers, able))
        return planner.has_block and any(isinstance(read.request, ReadBlock) for read in reads)

    def provisioned(self, register: Register, now: float) -> Learnt:
        """Take that a selector, or the mark, was written."""
        facts = self._reading.facts
        if register.name == RESET_MARK:
            self._reading.provision.marked()
            facts[RESET_MARK] = 1
            return self._next_provision(now)
        self._is_to_be_read_back = True
        place = [r.name for r in selector_registers(self._drive)].index(register.name)
        facts[register.name] = selectors.best(self._drive)[place]
        return self._next_provision(now)

    def not_provisioned(self, register: Register, refused: Refused, now: float) -> Learnt:
        """Take that the drive refuses that write."""
        self._reading.provision.refused(register)
        learnt = self._next_provision(now)
        learnt.warnings.append(f"{register.title or register.name} cannot be set: {refused}")
        return learnt


def no_direct(reading: Reading, request: Request, refused: Refused) -> str:
    """Read no direct block of that area any more; return what is to be said of that."""
    address = request.address if isinstance(request, ReadWords) else 0
    reading.able = replace(reading.able, no_direct=reading.able.no_direct | {area(address)})
    return f"direct block at {address:04X}H: {refused}; single reads instead"
