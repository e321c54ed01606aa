"""How one drive is read: who it is, how it is set, then its polls; what an answer means for all of that.

Pure: it is told what was answered or refused, and says what was learnt and what to do next.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum

from gateway.bus import selectors
from gateway.bus.blocks import Abilities, BlockMapping, PlannedRead, Planner, area
from gateway.bus.schedule import Job, spread
from gateway.drives.register import Register
from gateway.errors import Refusal, Refused
from gateway.protocol.pdu import Identify, Identity, ReadBlock, ReadWords, Reply, Request, Words
from gateway.site import Drive, PollGroup

FIRST_WITHIN = 0.5  # seconds after a drive is ready, for values that are read seldom
RECHECK_EVERY = 60.0  # seconds between two looks at F875-F879, which somebody may change at the panel
IDENTITY_REGISTERS = ("capacity_code", "cpu_version", "series_code")  # FB05, FE08, FB07


class Task(Enum):
    """What a piece of work is for."""

    IDENTIFY = "identify"
    FACT = "fact"
    PROVE_BLOCK = "prove block"
    PROVE_SINGLE = "prove single"
    POLL = "poll"
    RECHECK = "recheck"
    AUDIT = "audit"
    CONFIRM = "confirm"


@dataclass(frozen=True, slots=True)
class Work:
    """One exchange for one drive: its request, and how its words are to be understood."""

    task: Task
    request: Request
    read: PlannedRead | None = None


@dataclass(slots=True)
class Learnt:
    """What an answer brought. `jobs` replaces all that is done for the drive; `once` is to be done at once."""

    words: list[tuple[int, int]] = field(default_factory=list)
    jobs: list[Job[Work]] | None = None
    once: list[Work] = field(default_factory=list)
    stranger: str = ""
    is_ready: bool = False
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


class DriveReader:
    """The reading of one drive on its line. `phase` (0 to 1) shifts its polls against those of its neighbours."""

    def __init__(self, drive: Drive, planner: Planner, phase: float) -> None:
        self.drive = drive
        self.identity: Identity | None = None
        self.facts: dict[str, int] = {}
        self.able = Abilities()
        self.is_set_up = False
        self.absent: set[str] = set()
        self._planner = planner
        self._phase = phase
        self._missing: list[Register] = []
        self._candidates: list[BlockMapping] = []
        self._proof: list[Work] = []
        self._blocks: list[tuple[int, ...]] = []
        self._singles: dict[str, int] = {}
        self._audit: selectors.Audit | None = None
        self._tries = 0
        self._knows_identification = False
        self._pending: Work | None = None
        self._proofs = 0
        self._as_set: BlockMapping | None = None

    # ---- who is there

    def identify(self) -> Work:
        """Return the question who is there: 2BH, and every third time a plain read, for drives that know no 2BH.

        A drive that has answered 2BH, rightly or as a stranger, is asked nothing else; one that was set up
        without is asked by plain reads.
        """
        self._tries += 1
        status = self.drive.model.registers.get("status")
        is_plain = not self._knows_identification and (self.is_set_up or self._tries % 3 == 0)
        if is_plain and status is not None:
            return Work(Task.IDENTIFY, ReadWords(self.drive.number, status.address))
        return Work(Task.IDENTIFY, Identify(self.drive.number))

    def on_reply(self, work: Work, reply: Reply, now: float) -> Learnt:
        """Take an answer."""
        match work.task, reply:
            case Task.IDENTIFY, Identity():
                return self._identified(reply, now)
            case Task.IDENTIFY, Words():
                return self._resumed(now)
            case Task.FACT, Words(words) if work.read is not None:
                return self._fact(work.read, words, now)
            case (Task.PROVE_BLOCK | Task.PROVE_SINGLE), Words(words):
                return self._proven(work, words, now)
            case Task.RECHECK, Words(words) if work.read is not None:
                return self._rechecked(work.read, words, now)
            case (Task.AUDIT | Task.CONFIRM), Words(words) if work.read is not None and self._audit is not None:
                self._audit.single(work.read.registers[0], words[0])
                return Learnt(work.read.values(words))
            case Task.POLL, Words(words) if work.read is not None:
                return self._polled(work.read, words, now)
        return Learnt()

    def _identified(self, identity: Identity, now: float) -> Learnt:
        self._knows_identification = True
        expected = self.drive.model.identity
        if expected and not identity.device.startswith(expected):
            self.is_set_up = False
            self.identity = None
            self._pending = None
            return Learnt(
                stranger=f"identity mismatch: {self.drive.model.name} is configured, {identity.device!r} answers"
            )
        is_same = self.identity in (None, identity)
        self.identity = identity
        return self._resumed(now) if is_same else self._set_up(now)

    def _resumed(self, now: float) -> Learnt:
        """Go on where a lost frame broke in: with the polls, or with the step of the set-up that got no answer."""
        if self.is_set_up:
            return Learnt(is_ready=True)
        if self._pending is not None:
            return Learnt(jobs=[self._at_once(self._pending, now)])
        return self._set_up(now)

    def forget(self) -> None:
        """Forget all that a reset or another drive may have changed; the mapping in force stays a candidate."""
        if self.able.mapping is not None:
            self._candidates = [self.able.mapping]
        self.is_set_up = False
        self._knows_identification = False
        self._tries = 0
        self._pending = None
        self.identity = None
        self.able = Abilities()
        self.absent.clear()
        self._audit = None

    # ---- how it is set

    def _set_up(self, now: float) -> Learnt:
        """Read, one after another, what must be known before polling: identity codes, selectors, bases."""
        self.is_set_up = False
        model = self.drive.model
        wanted = [model.registers[name] for name in IDENTITY_REGISTERS if name in model.registers]
        wanted += [*self._selector_registers(), *self.drive.bases]
        if self.able.mapping is not None and self.able.mapping not in self._candidates:
            self._candidates.insert(0, self.able.mapping)
        self.able = replace(self.able, mapping=None)
        self._missing = list({register.name: register for register in wanted}.values())
        self.facts.clear()
        return self._next_fact(now)

    def _selector_registers(self) -> list[Register]:
        connector = self.drive.model.connector()
        names = connector.block_read if connector else ()
        return [self.drive.model.registers[name] for name in names]

    def _next_fact(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        if not self._missing:
            return self._start_proof(now, notes)
        read = self._planner.plan(self._missing, self.able)[0]
        return Learnt(jobs=[self._at_once(Work(Task.FACT, read.request, read), now)], notes=list(notes))

    def _at_once(self, work: Work, now: float) -> Job[Work]:
        """Make a step of the set-up: it is remembered until the next one, should its answer be lost."""
        self._pending = work
        return Job(self.drive.name, work, None, now, now)

    def _fact(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        doubtful = {register.name for register in read.doubtful(words)}
        for register, word in zip(read.carries, words, strict=True):
            if register is not None and register.name not in doubtful:
                self.facts[register.name] = word & register.mask
        self.able = replace(self.able, only_single=self.able.only_single | doubtful)
        self._missing = [r for r in self._missing if r.name not in self.facts]
        return self._next_fact(now)

    def _start_proof(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        codes = [self.facts.get(register.name) for register in self._selector_registers()]
        self._as_set = as_set = selectors.mapping_of(self.drive.model, codes)
        self._proofs = 0
        if as_set is not None and as_set not in self._candidates:
            self._candidates.append(as_set)
        return self._next_proof(now, notes)

    def _next_proof(self, now: float, notes: Sequence[str] = ()) -> Learnt:
        """Try the next mapping that may be in force: block, single reads, block."""
        while self._candidates:
            mapping = self._candidates[0]
            wanted = {r.name: r for r in mapping if r is not None and r.name in self.drive.points}
            able = Abilities(mapping=mapping, no_direct=self.able.no_direct)
            reads = self._planner.plan(list(wanted.values()), able) if wanted else ()
            block = next((read for read in reads if isinstance(read.request, ReadBlock)), None)
            if block is None:  # brings nothing that is wanted, or not cheaper than other reads
                self._candidates.pop(0)
                continue
            singles = [
                Work(Task.PROVE_SINGLE, ReadWords(self.drive.number, r.address), self._alone(r))
                for r in block.registers
                if r.name in wanted
            ]
            self._blocks, self._singles = [], {}
            edge = Work(Task.PROVE_BLOCK, block.request, block)
            self._proof = [edge, *singles, edge]
            return Learnt(jobs=[self._at_once(self._proof.pop(0), now)], notes=list(notes))
        return self._start_polls(now, notes)

    def _alone(self, register: Register) -> PlannedRead:
        return PlannedRead(ReadWords(self.drive.number, register.address), (register,))

    def _proven(self, work: Work, words: Sequence[int], now: float) -> Learnt:
        if work.task is Task.PROVE_BLOCK:
            self._blocks.append(tuple(words))
        elif work.read is not None:
            self._singles[work.read.registers[0].name] = words[0]
        if self._proof:
            return Learnt(jobs=[self._at_once(self._proof.pop(0), now)])
        mapping = self._candidates[0]
        is_right = selectors.fits(mapping, self._blocks[0], self._blocks[-1], self._singles)
        self._proofs += 1
        if not is_right and self._proofs < selectors.PROOFS:
            return self._next_proof(now)
        self._proofs = 0
        self._candidates.pop(0)
        if is_right:
            self._candidates.clear()
            self.able = replace(self.able, mapping=mapping)
            return self._start_polls(now)
        learnt = self._next_proof(now)
        learnt.warnings.append(
            "the block does not carry what F875-F879 say: a changed selector acts only after a reset of the drive"
        )
        return learnt

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
            offsets = spread(len(reads), group.period)
            for read, offset in zip(reads, offsets, strict=True):
                due = now + (offset + self._phase * group.period) % group.period if group.period else now
                work = Work(Task.POLL, read.request, read)
                jobs.append(Job(self.drive.name, work, group.period, due, due + group.period))
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
            proven = {r.name for _, r in watched if self._singles.get(r.name, 0) & r.mask}
            as_set = self._as_set or ()
            settled = {r.name for i, r in watched if i < len(as_set) and as_set[i] is r}
            unsettled = frozenset(r.name for _, r in watched) - settled
            self._audit = selectors.Audit(watched, proven, unsettled)
            checks.append(self._audit_job(now))
        registers = self._selector_registers()
        if registers:
            reads = self._planner.plan(registers, replace(self.able, mapping=None))
            for read, offset in zip(reads, spread(len(reads), RECHECK_EVERY), strict=True):
                due = now + RECHECK_EVERY + offset
                work = Work(Task.RECHECK, read.request, read)
                checks.append(Job(self.drive.name, work, RECHECK_EVERY, due, due + RECHECK_EVERY))
        return checks

    def _audit_job(self, now: float) -> Job[Work]:
        audit = self._audit
        if audit is None:
            raise AssertionError("no audit without a block")
        due = now + audit.every
        read = self._alone(audit.next())
        return Job(self.drive.name, Work(Task.AUDIT, read.request, read), None, due, due + audit.every)

    def follow_up(self, work: Work, now: float) -> Job[Work] | None:
        """Return what comes some time after a piece of work: the next audit after an audit."""
        return self._audit_job(now) if work.task is Task.AUDIT and self._audit is not None else None

    def _polled(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        if isinstance(read.request, ReadBlock) and self._audit is not None and not self._audit.block(words):
            self._audit = None
            learnt = self._set_up(now)
            learnt.warnings.append("the block no longer carries what it did: the drive was reset or set anew")
            return learnt
        untrusted = self._untrusted(read, words)
        values = [pair for pair in read.values(words) if pair[0] not in {r.address for r in untrusted}]
        once = [Work(Task.CONFIRM, r.request, r) for r in map(self._alone, untrusted)]
        once += [Work(Task.POLL, r.request, r) for r in map(self._alone, read.doubtful(words))]
        return Learnt(values, once=once)

    def _untrusted(self, read: PlannedRead, words: Sequence[int]) -> list[Register]:
        is_block = isinstance(read.request, ReadBlock) and self._audit is not None
        return self._audit.untrusted(words) if is_block and self._audit is not None else []

    def _rechecked(self, read: PlannedRead, words: Sequence[int], now: float) -> Learnt:
        found = {r.name: word for r, word in zip(read.carries, words, strict=True) if r is not None}
        if all(self.facts.get(name) in (None, word) for name, word in found.items()):
            return Learnt(read.values(words))
        learnt = self._set_up(now)
        learnt.warnings.append("F875-F879 were changed; the change acts after a reset of the drive")
        return learnt

    # ---- refusals

    def on_refused(self, work: Work, refused: Refused, now: float) -> Learnt:
        """Take a refusal: remember it, and serve the values another way."""
        match work:
            case Work(Task.IDENTIFY):
                return Learnt(is_ready=True) if self.is_set_up else self._set_up(now)
            case Work(Task.PROVE_BLOCK | Task.PROVE_SINGLE):
                self._candidates.pop(0)
                return self._next_proof(now)
            case Work(Task.FACT, read=PlannedRead() as read):
                return self._fact_refused(read, refused, now)
            case Work(request=ReadBlock()):
                self.able = replace(self.able, mapping=None)
                return Learnt(jobs=self.polls(now), notes=[f"indirect block: {refused}"])
            case Work(request=ReadWords(count=count)) if count > 1:
                return Learnt(notes=[self._no_direct(work.request, refused)], jobs=self.polls(now))
            case Work(Task.POLL, read=PlannedRead() as read) if refused.reason is not Refusal.UNABLE:
                name = read.registers[0].name
                self.absent.add(name)
                return Learnt(jobs=self.polls(now), warnings=[f"{name}: {refused}; it is not read any more"])
        return Learnt()

    def _fact_refused(self, read: PlannedRead, refused: Refused, now: float) -> Learnt:
        if read.is_direct_block:
            return self._next_fact(now, [self._no_direct(read.request, refused)])
        self._missing.remove(read.registers[0])
        return self._next_fact(now)

    def _no_direct(self, request: Request, refused: Refused) -> str:
        address = request.address if isinstance(request, ReadWords) else 0
        self.able = replace(self.able, no_direct=self.able.no_direct | {area(address)})
        return f"direct block at {address:04X}H: {refused}; single reads instead"

    @property
    def described(self) -> Mapping[str, str]:
        """Return who the drive is, in words, for people."""
        model = self.drive.model
        told = {"vendor": "", "device": "", "version": ""}
        if self.identity is not None:
            told = {
                "vendor": self.identity.vendor,
                "device": self.identity.device,
                "version": self.identity.version,
            }
        capacity = self.facts.get("capacity_code")
        if capacity is not None:
            told["type_form"] = model.capacities.get(capacity, f"code {capacity}")
        if "cpu_version" in self.facts:
            told["cpu_version"] = str(self.facts["cpu_version"])
        return {key: value for key, value in told.items() if value}
