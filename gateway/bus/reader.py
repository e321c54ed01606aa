"""How one drive is read: who it is, how it is set, then its polls; what an answer means for all of that.

Pure: it is told what was answered or refused, and says what was learnt and what to do next.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from gateway.bus import selectors
from gateway.bus.blocks import Abilities, BlockMapping, PlannedRead, Planner, area
from gateway.bus.identification import IDENTITY_REGISTERS, Identification
from gateway.bus.proof import Proof
from gateway.bus.provision import RESET_MARK, Provision, selector_registers
from gateway.bus.schedule import Job, on_grid, spread
from gateway.bus.work import Learnt, Task, Work
from gateway.control.carrying import Form, selected
from gateway.control.watchdog import control_registers
from gateway.drives.register import Register
from gateway.errors import Refusal, Refused
from gateway.protocol.pdu import Identity, ReadBlock, ReadWords, Reply, Request, Words, Written
from gateway.site import Drive, PollGroup

FIRST_WITHIN = 0.5  # seconds after a drive is ready, for values that are read seldom
RECHECK_EVERY = 60.0  # seconds between two looks at F875-F879, which somebody may change at the panel
RECHECK_SOON = 5.0  # the same while a reset is awaited, or while the block carries the display's text
BLOCK_MODE = "block_mode"  # FA80: 1 makes the block carry the display's text (E6581657 7.3.1)
SILENT_BLOCKS = 3  # block reads without an answer while other questions have one, before the block is given up
BUSY_BLOCKS = 3  # refusals of the block in a row because the drive cannot do it now, before it is given up
BELIEVED_FOR = 1.0  # seconds for which a block that looks like text is believed after FA80 was read as 0
REFUSALS = 2  # in a row, before a value is given up
NOT_IN_FORCE = "the block does not carry what F875-F879 say: a changed selector acts only after a reset of the drive"
DISPLAY_NOTE = "FA80 is 1: the block carries the display's text; it is not used"
TRIP_REGISTERS = ("trip_code", "status")  # FC90, FD01: what is read at once when a drive trips or no longer does


def phases(drives: Sequence[Drive]) -> dict[str, dict[float, float]]:
    """Return by drive and period which part of the period its polls are shifted by: evenly, whoever else there is."""
    found: dict[str, dict[float, float]] = {drive.name: {} for drive in drives}
    for period in {group.period for drive in drives for group in drive.groups}:
        having = [drive for drive in drives if any(group.period == period for group in drive.groups)]
        for place, drive in enumerate(having):
            found[drive.name][period] = place / len(having)
    return found


class DriveReader:
    """The reading of one drive on its line, the one at `place` of so many.

    That says how much of the line its checks may take, and shifts its polls against those of its neighbours; `phases`
    (period -> 0 to 1) does so for each period among the drives that have it.
    """

    def __init__(
        self,
        drive: Drive,
        planner: Planner,
        place: int = 0,
        drives: int = 1,
        phases: Mapping[float, float] | None = None,
    ) -> None:
        self.drive = drive
        self.facts: dict[str, int] = {}
        self.able = Abilities()
        self.is_set_up = False
        self.absent: set[str] = set()
        self._planner = planner
        self._phase = place / drives
        self._phases = phases or {}
        self._drives = drives
        self._missing: list[Register] = []
        self._who = Identification(drive)
        self._proof = Proof(drive, planner)
        self._audit: selectors.Audit | None = None
        self._pending: Work | None = None
        self._as_set: BlockMapping | None = None
        self._provision = Provision(drive)
        self._before: BlockMapping | None = None  # what was in force before the selectors were provisioned
        self._is_to_be_read_back = False
        self._silent_blocks = 0
        self._silent_polls = 0
        self._busy_blocks = 0
        self._no_text: tuple[int, ...] = ()  # the last block that looked like the display's text and was none
        self._no_text_until = float("-inf")
        self._refusals: Counter[str] = Counter()

    # ---- who is there

    def identify(self) -> Work:
        """Return the question who is there."""
        return self._who.ask(is_set_up=self.is_set_up)

    @property
    def is_doubtful(self) -> bool:
        """Say whether somebody answers, and what would tell another model is still to be asked."""
        return any(sign in self._missing for sign in self._who.signs)

    def on_reply(self, work: Work, reply: Reply, now: float) -> Learnt:
        """Take an answer."""
        match work.task, reply:
            case Task.IDENTIFY, Identity():
                return self._identified(reply, now)
            case Task.IDENTIFY, Words(words) if work.read is not None:
                return self._answers(work.read.registers[0], words[0], now)
            case Task.FACT, Words(words) if work.read is not None:
                return self._fact(work.read, words, now)
            case ((Task.PROVE_BLOCK | Task.PROVE_SINGLE), Words(words)):
                return self._proven(work, words, now)
            case Task.RECHECK, Words(words) if work.read is not None:
                return self._rechecked(work.read, words, now)
            case ((Task.AUDIT | Task.CONFIRM), Words(words)) if work.read is not None and self._audit is not None:
                self._audit.single(work.read.registers[0], words[0])
                return Learnt(work.read.values(words))
            case Task.POLL, Words(words) if work.read is not None:
                return self._polled(work.read, words, now)
            case Task.TRIP, Words(words) if work.read is not None:
                return Learnt(work.read.values(words))
            case Task.BLOCK_MODE, Words(words):
                return self._block_mode(words[0], now)
            case Task.DISPLAY, Words(words):
                return self._display_seen(words[0], now)
            case Task.PROVISION, Written() if work.register is not None:
                return self._provisioned(work.register, now)
        return Learnt()

    def _identified(self, identity: Identity, now: float) -> Learnt:
        known = self._who.identity
        if stranger := self._who.is_stranger(identity):
            return self._stranger(stranger)
        return self._resumed(now) if known in (None, identity) else self._set_up(now)

    def _answers(self, register: Register, word: int, now: float) -> Learnt:
        """Take a plain read as the sign that somebody is there; the series code says who."""
        stranger = self._who.is_other_model(register, word)
        return self._stranger(stranger) if stranger else self._resumed(now)

    def _stranger(self, reason: str) -> Learnt:
        self.is_set_up = False
        self._pending = None
        return Learnt(stranger=reason)

    def _resumed(self, now: float) -> Learnt:
        """Go on where a lost frame broke in: with the polls, or with the step of the set-up that got no answer.

        A write to the EEPROM that got no answer may have been done: that is read before it is made again.
        """
        if self.is_set_up:
            return Learnt(is_ready=True)
        if self._pending is not None and self._pending.task is Task.PROVE_BLOCK:
            self._silent_blocks += 1
            if self._silent_blocks >= SILENT_BLOCKS:  # the TOSHIBA protocol has no other way to say that X is unknown
                self._proof.candidates.clear()
                return self._start_polls(now, ["the block is not answered; other reads instead"])
        if self._pending is not None and self._pending.task is not Task.PROVISION:
            return Learnt(jobs=[self._at_once(self._pending, now)])
        return self._set_up(now)

    def forget(self) -> None:
        """Forget all that a reset or another drive may have changed; the mapping in force stays a candidate."""
        if self.able.mapping is not None:
            self._proof.candidates = [self.able.mapping]
        self.is_set_up = False
        self._pending = None
        self._who = self._who.afresh()
        self._forget_refusals()
        self._audit = None

    def _forget_refusals(self) -> None:
        """Try again whatever was refused, or not answered: a reset, or a parameter, may have changed that."""
        self.able = Abilities()
        self.absent.clear()
        self._refusals.clear()
        self._silent_blocks = self._busy_blocks = 0
        self._no_text = ()

    # ---- how it is set

    def _set_up(self, now: float) -> Learnt:
        """Read, one after another, what must be known before polling: identity codes, selectors, bases.

        It comes after a reset, another identity, or a change of the settings: what was refused before is tried again.
        """
        self.is_set_up = False
        model = self.drive.model
        names = (*IDENTITY_REGISTERS, *((BLOCK_MODE, RESET_MARK) if self._planner.has_block else ()))
        wanted = control_registers(self.drive)
        wanted += [model.registers[name] for name in names if name in model.registers]
        wanted += [*self._selector_registers(), *self.drive.bases, *self._who.signs]
        self._proof.propose(self.able.mapping, first=True)
        self._forget_refusals()
        self._missing = list({register.name: register for register in wanted}.values())
        self.facts.clear()
        return self._next_fact(now)

    def _selector_registers(self) -> list[Register]:
        """Return F870-F871 and F875-F879, where model and protocol have blocks."""
        connector = self.drive.model.connector()
        writes = [self.drive.model.registers[name] for name in (connector.block_write if connector else ())]
        return [*writes, *selector_registers(self.drive)] if self._planner.has_block else []

    def _next_fact(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        if not self._missing:
            return self._next_provision(now, notes)
        signs = [register for register in self._missing if register in self._who.signs]
        read = self._planner.plan(signs or self._missing, self.able)[0]
        return Learnt(jobs=[self._at_once(Work(Task.FACT, read.request, read), now)], notes=list(notes))

    def _at_once(self, work: Work, now: float) -> Job[Work]:
        """Make a step of the set-up: it is remembered until the next one, should its answer be lost."""
        self._pending = work
        return Job(self.drive.name, work, None, now, now)

    def _fact(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        doubtful = {register.name for register in read.doubtful(words)}
        told = set()
        for register, word in zip(read.carries, words, strict=True):
            if register is None or register.name in doubtful:
                continue
            told.add(register.name)
            if stranger := self._who.is_other_model(register, word):
                return self._stranger(stranger)
            if register.name in self.drive.model.registers:
                self.facts[register.name] = word & register.mask
        self._missing = [register for register in self._missing if register.name not in told]
        self.able = replace(self.able, only_single=self.able.only_single | doubtful)
        return self._next_fact(now)

    def _next_provision(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        """Write the next selector that is not as wanted, if that is permitted; read all back; then the proof."""
        if not self.drive.provision or not self._would_use_block():
            return self._start_proof(now, notes)
        mapping = self._mapping_as_set()
        if not self._is_to_be_read_back:
            self._provision.read_back(self.facts)
        step = self._provision.next(self.facts)
        if step is None and self._is_to_be_read_back:
            self._is_to_be_read_back = False
            learnt = self._set_up(now)
            learnt.notes += notes
            return learnt
        if step is None:
            learnt = self._start_proof(now, notes)
            if self._provision.is_at_its_end(self.facts):
                learnt.warnings.append("F875-F879 are not as wanted, and are set once only: set them by hand")
            return learnt
        register, request = step
        if register.name == RESET_MARK or not self._provision.awaits_reset(self.facts):
            self._before = mapping
        self._provision.attempted(register)
        work = Work(Task.PROVISION, request, register=register)
        said = []
        if register.name != RESET_MARK:
            said = [f"{register.title or register.name}: {request.word} is written (was {self.facts[register.name]})"]
        return Learnt(jobs=[self._at_once(work, now)], notes=[*notes, *said])

    def _would_use_block(self) -> bool:
        """Say whether the block would be used with the best selectors: else they are not worth a write."""
        mapping = selectors.mapping_of(self.drive.model, selectors.best(self.drive))
        able = replace(self.able, mapping=mapping)
        reads = (read for group in self.drive.groups for read in self._planner.plan(group.registers, able))
        return self._planner.has_block and any(isinstance(read.request, ReadBlock) for read in reads)

    def _provisioned(self, register: Register, now: float) -> Learnt:
        if register.name == RESET_MARK:
            self._provision.marked()
            self.facts[RESET_MARK] = 1
            return self._next_provision(now)
        self._is_to_be_read_back = True
        place = [r.name for r in selector_registers(self.drive)].index(register.name)
        self.facts[register.name] = selectors.best(self.drive)[place]
        return self._next_provision(now)

    def _not_provisioned(self, register: Register, refused: Refused, now: float) -> Learnt:
        self._provision.refused(register)
        learnt = self._next_provision(now)
        learnt.warnings.append(f"{register.title or register.name} cannot be set: {refused}")
        return learnt

    def _mapping_as_set(self) -> BlockMapping | None:
        codes = [self.facts.get(register.name) for register in selector_registers(self.drive)]
        return selectors.mapping_of(self.drive.model, codes)

    def _start_proof(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        self._as_set = as_set = self._mapping_as_set()
        self._proof.begin()
        if self._provision.awaits_reset(self.facts):  # what is set is known not to be in force
            self._proof.candidates.clear()
            self._proof.propose(self._before)
        else:
            self._proof.propose(as_set)
        if self.facts.get(BLOCK_MODE) == 1:
            self._proof.candidates.clear()
            learnt = self._start_polls(now, [*notes, DISPLAY_NOTE])
        else:
            learnt = self._next_proof(now, notes)
        if self.is_reset_needed:
            learnt.warnings.append("reset needed: F875-F879 were set and act after a reset (switch it off and on)")
        return learnt

    @property
    def is_reset_needed(self) -> bool:
        """Say whether selectors are set that act only after a reset of the drive."""
        as_set, mapping = self._as_set, self.able.mapping
        if as_set is None:
            return False
        if self._provision.awaits_reset(self.facts):
            return as_set != self._before
        return as_set == self._proof.refuted or (mapping is not None and mapping != as_set)

    def _next_proof(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        """Try the next mapping that may be in force."""
        step = self._proof.next(self.able)
        if step is None:
            return self._start_polls(now, notes)
        return Learnt(jobs=[self._at_once(step, now)], notes=list(notes))

    def _alone(self, register: Register) -> PlannedRead:
        return PlannedRead(ReadWords(self.drive.number, register.address), (register,))

    def _proven(self, work: Work, words: Sequence[int], now: float) -> Learnt:
        is_right = self._proof.take(work, words)
        self._silent_blocks = 0
        if is_right:
            self.able = replace(self.able, mapping=self._proof.proven)
            if self.able.mapping == self._as_set:
                self._provision.in_force()
        if is_right is False and BLOCK_MODE in self.drive.model.registers:
            address = self.drive.model.registers[BLOCK_MODE].address
            return Learnt(jobs=[self._at_once(Work(Task.DISPLAY, ReadWords(self.drive.number, address)), now)])
        learnt = self._next_proof(now)
        if is_right is False:
            learnt.warnings.append(NOT_IN_FORCE)
        return learnt

    def _display_seen(self, word: int, now: float) -> Learnt:
        """Judge a block that did not agree: it may have carried the display's text (FA80 = 1)."""
        if word != 1:
            learnt = self._next_proof(now)
            learnt.warnings.append(NOT_IN_FORCE)
            return learnt
        self.facts[BLOCK_MODE] = 1
        self._proof.begin()
        self._proof.candidates.clear()
        return self._start_polls(now, [DISPLAY_NOTE])

    # ---- its polls

    def _start_polls(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        self.is_set_up = True
        self._pending = None
        return Learnt(jobs=self.polls(now), is_ready=True, notes=list(notes))

    def plan(self) -> list[tuple[PollGroup, tuple[PlannedRead, ...]]]:
        """Plan every poll group, the fastest first; what a faster group's block brings is not asked again."""
        planned = []
        brought: set[str] = set()
        for group in sorted(self.drive.groups, key=lambda group: group.period):
            wanted = [r for r in group.registers if r.name not in brought | self.absent]
            reads = self._planner.plan(wanted, self.able) if wanted else ()
            brought |= {register.name for read in reads for register in read.registers}
            planned.append((group, reads))
        return planned

    def polls(self, now: float) -> list[Job[Work]]:
        """Return the jobs of this drive, spread over their periods."""
        jobs = []
        for group, reads in self.plan():
            offsets = spread(len(reads), group.period, self._phases.get(group.period, self._phase))
            for read, offset in zip(reads, offsets, strict=True):
                due = on_grid(offset, group.period, now) if group.period else now
                work = Work(Task.POLL, read.request, read)
                jobs.append(Job(self.drive.name, work, group.period, due, due + group.period, waits_since=now))
                if due > now + FIRST_WITHIN:  # its place on the grid is far: the first value comes before
                    jobs.append(Job(self.drive.name, work, None, now, now + FIRST_WITHIN))
        return jobs + self._checks(now, jobs)

    def _checks(self, now: float, jobs: Iterable[Job[Work]]) -> list[Job[Work]]:
        """Return the jobs that keep the mapping honest, where the block is in use."""
        blocks = [job.work.read for job in jobs if isinstance(job.work.request, ReadBlock)]
        checks = []
        if blocks and blocks[0] is not None:
            carried = enumerate(blocks[0].carries)
            watched = tuple((i, r) for i, r in carried if r is not None and r.name in self.drive.points)
            proven = {r.name for _, r in watched if self._proof.singles.get(r.name, 0) & r.mask}
            as_set = self._as_set or ()
            settled = {r.name for i, r in watched if i < len(as_set) and as_set[i] is r}
            unsettled = frozenset(r.name for _, r in watched) - settled
            self._audit = selectors.Audit(watched, proven, unsettled)
            checks.append(self._audit_job(now))
        return checks + self._rechecks(now)

    def _rechecks(self, now: float) -> list[Job[Work]]:
        """Return the looks at what somebody else may change: the selectors, FA80, and FA87 while it matters."""
        is_awaited = self._provision.awaits_reset(self.facts)
        names = [BLOCK_MODE, RESET_MARK] if is_awaited else [BLOCK_MODE]
        registers = [self.drive.model.registers[name] for name in names if name in self.facts]
        registers += self._selector_registers()
        if not self._planner.has_block or not registers:
            return []
        is_soon = is_awaited or self.facts.get(BLOCK_MODE) == 1
        every = RECHECK_SOON if is_soon else RECHECK_EVERY
        reads = self._planner.plan(registers, replace(self.able, mapping=None))
        jobs = []
        for read, offset in zip(reads, spread(len(reads), every), strict=True):
            due = now + every + offset
            jobs.append(Job(self.drive.name, Work(Task.RECHECK, read.request, read), every, due, due + every))
        return jobs

    def _audit_job(self, now: float) -> Job[Work]:
        audit = self._audit
        if audit is None:
            raise AssertionError("no audit without a block")
        read = self._alone(audit.next())
        every = audit.every
        if every >= selectors.UNPROVEN_EVERY:  # nothing disagrees: the checks of all drives keep to their share
            every = max(every, self._drives * self._planner.cost(read.request) / selectors.AUDIT_SHARE)
        due = now + every
        return Job(self.drive.name, Work(Task.AUDIT, read.request, read), None, due, due + every)

    def follow_up(self, work: Work, now: float) -> Job[Work] | None:
        """Return what comes some time after a piece of work: the next audit after an audit."""
        return self._audit_job(now) if work.task is Task.AUDIT and self._audit is not None else None

    def _polled(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        if isinstance(read.request, ReadBlock):
            self._busy_blocks = self._silent_polls = 0
            if self._may_be_text(read, words, now):
                self._no_text = tuple(words)  # believed from the answer on that FA80 is 0
                register = self.drive.model.registers[BLOCK_MODE]
                return Learnt(once=[Work(Task.BLOCK_MODE, ReadWords(self.drive.number, register.address))])
            return self._block_polled(read, words, now)
        if self._refusals:
            self._refusals -= Counter(register.name for register in read.registers)
        values = read.values(words)
        once = [Work(Task.POLL, r.request, r) for r in map(self._alone, read.doubtful(words))]
        if any(self._proof.is_told_by(register, word) for register, word in zip(read.registers, words, strict=False)):
            self._proof.again()
            learnt = self._next_proof(now)
            return Learnt(values, jobs=learnt.jobs, once=once)
        return Learnt(values, once=once)

    def _block_polled(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        """Take the block: what is not believed yet is read alone."""
        audit = self._audit
        if audit is None:
            return Learnt(read.values(words))
        stirred = audit.stirred(words)
        if not audit.block(words):
            self._audit = None
            learnt = self._set_up(now)
            learnt.warnings.append("the block no longer carries what it did: the drive was reset or set anew")
            return learnt
        untrusted = audit.untrusted(words)
        withheld = {register.address for register in untrusted}
        checked = {register.name: register for register in (*untrusted, *stirred)}
        once = [Work(Task.CONFIRM, r.request, r) for r in map(self._alone, checked.values())]
        return Learnt([pair for pair in read.values(words) if pair[0] not in withheld], once=once)

    def _may_be_text(self, read: PlannedRead, words: Sequence[int], now: float) -> bool:
        """Say whether a block may be the display's text, and FA80 has to be looked at before it is believed."""
        if BLOCK_MODE not in self.drive.model.registers or not selectors.may_be_display(words):
            self._no_text = ()
            return False
        is_like = len(self._no_text) == len(words) and all(
            register is None or selectors.agree(register, word, before, before)
            for register, word, before in zip(read.carries, words, self._no_text, strict=True)
        )
        return not (is_like and now < self._no_text_until)

    def _block_mode(self, word: int, now: float) -> Learnt:
        """Take FA80: 1 takes the block away until it is 0 again."""
        if word != 1:
            self._no_text_until = now + BELIEVED_FOR
            return Learnt()
        if self.able.mapping is None:
            return Learnt()
        self._proof.candidates = [self.able.mapping]
        self.able = replace(self.able, mapping=None)
        self.facts[BLOCK_MODE] = 1
        return Learnt(jobs=self.polls(now), notes=[DISPLAY_NOTE])

    def _rechecked(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        found = {r.name: word for r, word in zip(read.carries, words, strict=True) if r is not None}
        changed = [name for name, word in found.items() if self.facts.get(name) not in (None, word)]
        if not changed:
            return Learnt(read.values(words))
        learnt = self._set_up(now)
        titles = ", ".join(self.drive.model.registers[name].title or name for name in changed)
        if RESET_MARK in changed:
            learnt.notes.append("the drive was reset")
        else:
            learnt.warnings.append(f"changed by somebody else: {titles}; a selector acts after a reset of the drive")
        return learnt

    # ---- its exchange

    def exchange(self) -> Form | None:
        """Return the exchange of a block poll with what F870 and F871 select; None where there is none."""
        model, codec = self.drive.model, self.drive.codec
        if not (self.drive.block_write and self.is_set_up and codec.forms.has_exchange and model.blocks.has_exchange):
            return None
        connector = model.connector()
        codes = [self.facts.get(name) for name in (connector.block_write if connector else ())]
        requests = (read.request for _, reads in self.plan() for read in reads)
        block = next((request for request in requests if isinstance(request, ReadBlock)), None)
        return Form(block, selected(codes, model.write_selectors)) if block is not None else None

    # ---- trips

    def on_trip(self) -> Learnt:
        """Return what is to be read at once when the drive has tripped, or no longer is."""
        registers = self.drive.model.registers
        reads = [self._alone(registers[name]) for name in TRIP_REGISTERS if name in registers]
        return Learnt(once=[Work(Task.TRIP, read.request, read) for read in reads])

    def glance(self) -> Work:
        """Return a read that is always worth its time: the status, or the question who is there."""
        status = self.drive.model.registers.get(TRIP_REGISTERS[-1])
        if status is None or status.name in self.absent:
            return self.identify()
        read = self._alone(status)
        return Work(Task.TRIP, read.request, read)

    # ---- silence and refusals

    def on_silence(self, work: Work, now: float) -> Learnt:
        """Take that a poll was not answered: a block is given up after some in a row, though the drive is there."""
        if work.task is not Task.POLL or not isinstance(work.request, ReadBlock) or self.able.mapping is None:
            return Learnt()
        self._silent_polls += 1
        if self._silent_polls < SILENT_BLOCKS:
            return Learnt()
        self._silent_polls = 0
        self.able = replace(self.able, mapping=None)
        return Learnt(jobs=self.polls(now), notes=["the block is not answered any more; other reads instead"])

    def on_refused(self, work: Work, refused: Refused, now: float) -> Learnt:
        """Take a refusal of what was sent: remember it, and serve the values another way."""
        match work:
            case Work(Task.IDENTIFY):
                self._who.refused(work, refused.reason)
                return Learnt(is_ready=True) if self.is_set_up else self._set_up(now)
            case Work(Task.PROVISION, register=Register() as register):
                return self._not_provisioned(register, refused, now)
            case Work(Task.DISPLAY):
                return self._display_seen(0, now)
            case Work(Task.TRIP | Task.BLOCK_MODE):
                return Learnt()
            case Work(Task.PROVE_BLOCK | Task.PROVE_SINGLE):
                self._proof.drop()
                return self._next_proof(now)
            case Work(Task.FACT, read=PlannedRead() as read):
                return self._fact_refused(read, refused, now)
            case Work(request=ReadBlock()):
                return self._block_refused(refused, now)
            case Work(request=ReadWords(count=count)) if count > 1:
                return Learnt(notes=[self._no_direct(work.request, refused)], jobs=self.polls(now))
            case Work(Task.POLL, read=PlannedRead() as read) if refused.reason is not Refusal.UNABLE:
                return self._poll_refused(read.registers[0].name, refused, now)
        return Learnt()

    def _block_refused(self, refused: Refused, now: float) -> Learnt:
        """Give the block up; a drive that is only busy is asked again."""
        self._busy_blocks += 1
        if refused.reason is Refusal.UNABLE and self._busy_blocks < BUSY_BLOCKS:
            return Learnt()
        self.able = replace(self.able, mapping=None)
        return Learnt(jobs=self.polls(now), notes=[f"indirect block: {refused}"])

    def _poll_refused(self, name: str, refused: Refused, now: float) -> Learnt:
        """Give a value up once it was refused twice in a row: the first may be a request damaged on its way."""
        self._refusals[name] += 1
        if self._refusals[name] < REFUSALS:
            return Learnt()
        self.absent.add(name)
        return Learnt(jobs=self.polls(now), warnings=[f"{name}: {refused}; it is not read any more"])

    def _fact_refused(self, read: PlannedRead, refused: Refused, now: float) -> Learnt:
        if read.is_direct_block:
            return self._next_fact(now, [self._no_direct(read.request, refused)])
        known = self._who.signs
        self._who.refused(Work(Task.FACT, read.request, read), refused.reason)
        self._missing.remove(read.registers[0])
        self._missing += [sign for sign in self._who.signs if sign not in known]
        return self._next_fact(now)

    def _no_direct(self, request: Request, refused: Refused) -> str:
        address = request.address if isinstance(request, ReadWords) else 0
        self.able = replace(self.able, no_direct=self.able.no_direct | {area(address)})
        return f"direct block at {address:04X}H: {refused}; single reads instead"

    @property
    def described(self) -> Mapping[str, str]:
        """Return who the drive is, in words, for people."""
        return self._who.described(self.facts)
