"""What is done for a drive, one exchange at a time, and what its answers bring."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from gateway.bus.blocks import PlannedRead
from gateway.bus.schedule import Job
from gateway.drives.register import Register
from gateway.protocol.pdu import Request


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
    BLOCK_MODE = "block mode"
    PROVISION = "provision"
    TRIP = "trip"
    DISPLAY = "display"
    TRIAL = "trial"


@dataclass(frozen=True, slots=True)
class Work:
    """One exchange for one drive: its request, and how its words are to be understood.

    `register` is what a write goes to.
    """

    task: Task
    request: Request
    read: PlannedRead | None = None
    register: Register | None = None


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
