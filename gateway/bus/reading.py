"""What is known of one drive as far as reading it goes: the parts of its reader share this.

Pure. What was found out holds until a reset or a loss; then it is found out anew.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from gateway.bus import selectors
from gateway.bus.blocks import Abilities, BlockMapping, PlannedRead, Planner
from gateway.bus.identification import Identification
from gateway.bus.proof import Proof
from gateway.bus.provision import Provision, selector_registers
from gateway.bus.schedule import Job
from gateway.bus.work import Work
from gateway.drives.register import Register
from gateway.protocol.pdu import ReadWords
from gateway.site import Drive

BLOCK_MODE = "block_mode"  # FA80: 1 makes the block carry the display's text (E6581657 7.3.1)
DISPLAY_NOTE = "FA80 is 1: the block carries the display's text; it is not used"


@dataclass(slots=True)
class Reading:
    """The reading of one drive on its line, the one at `place` of so many `drives`.

    That says how much of the line its checks may take, and shifts its polls against those of its neighbours; `phases`
    (period -> 0 to 1) does so for each period among the drives that have it.
    """

    drive: Drive
    planner: Planner
    place: int = 0
    drives: int = 1
    phases: Mapping[float, float] = field(default_factory=dict)
    facts: dict[str, int] = field(default_factory=dict)  # words of how it is set, by register name
    able: Abilities = field(default_factory=Abilities)
    absent: set[str] = field(default_factory=set)  # values that were given up
    is_set_up: bool = False
    pending: Work | None = None  # the step of the set-up that is to be answered
    who: Identification = field(init=False)
    proof: Proof = field(init=False)
    provision: Provision = field(init=False)
    audit: selectors.Audit | None = None  # of the block in use
    as_set: BlockMapping | None = None
    before: BlockMapping | None = None  # what was in force before the selectors were provisioned
    refusals: Counter[str] = field(default_factory=Counter)  # of values, in a row
    busy_blocks: int = 0  # refusals of the block in a row because the drive cannot do it now
    silent_blocks: int = 0  # block reads of the proof without an answer
    silent_polls: int = 0  # polls of the block without an answer, in a row
    no_text: tuple[int, ...] = ()  # the last block that looked like the display's text and was none

    def __post_init__(self) -> None:
        self.who = Identification(self.drive)
        self.proof = Proof(self.drive, self.planner)
        self.provision = Provision(self.drive)

    def forget(self) -> None:
        """Forget all that a reset or another drive may have changed; the mapping in force stays a candidate."""
        if self.able.mapping is not None:
            self.proof.candidates = [self.able.mapping]
        self.is_set_up = False
        self.pending = None
        self.who = self.who.afresh()
        self.forget_refusals()
        self.audit = None

    def forget_refusals(self) -> None:
        """Try again whatever was refused, or not answered: a reset, or a parameter, may have changed that."""
        self.able = Abilities()
        self.absent.clear()
        self.refusals.clear()
        self.silent_blocks = self.busy_blocks = 0
        self.no_text = ()

    def at_once(self, work: Work, now: float) -> Job[Work]:
        """Make a step of the set-up: it is remembered until the next one, should its answer be lost."""
        self.pending = work
        return Job(self.drive.name, work, None, now, now)

    def alone(self, register: Register) -> PlannedRead:
        """Return the read of one register."""
        return PlannedRead(ReadWords(self.drive.number, register.address), (register,))

    def selector_registers(self) -> list[Register]:
        """Return F870-F871 and F875-F879, where model and protocol have blocks."""
        connector = self.drive.model.connector()
        writes = [self.drive.model.registers[name] for name in (connector.block_write if connector else ())]
        return [*writes, *selector_registers(self.drive)] if self.planner.has_block else []

    def mapping_as_set(self) -> BlockMapping | None:
        """Return the mapping that the selectors say, whether it is in force or not."""
        codes = [self.facts.get(register.name) for register in selector_registers(self.drive)]
        return selectors.mapping_of(self.drive.model, codes)

    @property
    def is_reset_needed(self) -> bool:
        """Say whether selectors are set that act only after a reset of the drive."""
        as_set, mapping = self.as_set, self.able.mapping
        if as_set is None:
            return False
        if self.provision.awaits_reset(self.facts):
            return as_set != self.before
        return as_set == self.proof.refuted or (mapping is not None and mapping != as_set)
