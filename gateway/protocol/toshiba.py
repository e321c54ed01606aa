"""What the ASCII and the binary mode of the TOSHIBA protocol have in common."""

from __future__ import annotations

from gateway.errors import Refusal, Refused
from gateway.protocol.codec import Answering
from gateway.protocol.pdu import Group, Target

READ = b"R"
READ_TWO_WIRE = b"G"  # binary mode only
WRITE_STORED = b"W"
WRITE_RAM = b"P"
BLOCK = b"X"  # binary mode only
BLOCK_ANSWER = b"Y"
PROPORTIONAL = b"S"  # binary mode only (VF-MB1 manual 4.2)
REFUSAL = b"N"

REFUSALS = {  # E6581657 4.3
    0: Refusal.UNABLE,
    1: Refusal.RANGE,
    2: Refusal.ADDRESS,
    3: Refusal.COMMAND,
    4: Refusal.CHECKSUM,
}


def answering(target: Target) -> Answering:
    """Say whether a request to a target is answered: for a group only where the line has its representative."""
    return Answering.MAYBE if isinstance(target, Group) else Answering.ALWAYS


def letters(command: bytes) -> tuple[tuple[bytes, bool], ...]:
    """Return how a command is answered, and whether that says that the drive is tripped (E6581657 4.1)."""
    return (command, False), (command.lower(), True)


def refused(target: Target, code: int, is_tripped: bool) -> Refused:
    """Return what an answer N or n says."""
    reason = REFUSALS.get(code, Refusal.OTHER)
    who = "the drive" if target is None else f"number {target}"
    return Refused(f"{who}: error {code:04X} ({reason.value})", reason, is_tripped)


def answerer(target: Target) -> int | None:
    """Return the number that an answer carries: of a group its representative, none where the request has none."""
    return target.representative if isinstance(target, Group) else target
