"""One write to several drives of a line: a frame for all where one reaches exactly them, then each one read back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gateway.bus.groups import Reach, reach
from gateway.bus.session import Outcome, Session, may_be_done, writing_time
from gateway.control.writes import PlannedWrite, Verdict, judge
from gateway.errors import BadReply, LineDown, NoReply, Refused
from gateway.protocol.pdu import WriteRam, WriteStored
from gateway.protocol.registry import PROTOCOLS
from gateway.site import Drive

Writes = Sequence[tuple[Drive, PlannedWrite]]


@dataclass(frozen=True, slots=True)
class GroupOutcome:
    """The frames that were sent, and what became of the write at each drive."""

    frames: tuple[Reach, ...]
    outcomes: tuple[Outcome, ...]


@dataclass(slots=True)
class _Member:
    """One drive of the group on its way through a write."""

    drive: Drive
    write: PlannedWrite
    old: int | None
    note: str = ""
    is_refused: bool = False
    is_sent: bool = False
    is_lost: bool = False

    def is_equal(self) -> bool:
        """Say whether the write would wear the EEPROM for nothing."""
        return self.write.wears_eeprom and self.old is not None and self.write.reads_back(self.old)


def frames_of(writes: Writes, on_line: Sequence[Drive]) -> tuple[Reach, ...]:
    """Return the frames for writes: drives that are to be given the same word by the same request share one."""
    alike: dict[WriteRam | WriteStored, list[Drive]] = {}
    for drive, write in writes:
        alike.setdefault(replace(write.request, number=None), []).append(drive)
    return tuple(frame for drives in alike.values() for frame in reach(drives, on_line))


async def write_together(session: Session, writes: Writes, *, again: bool = False) -> GroupOutcome:
    """Write to several drives of the session's line, then read back each of them.

    A drive that is silent beforehand is written to all the same: it may hear what it does not answer. A fault
    reset goes to the tripped ones only, one by one. LineDown: the port was gone before anything was written.
    """
    if not all(write.is_answered for _, write in writes):
        return await _one_by_one(session, writes, again=again)
    members = [_Member(drive, write, await _before(session, drive, write)) for drive, write in writes]
    due = [member for member in members if again or not member.is_equal()]
    frames = frames_of([(member.drive, member.write) for member in due], session.line.drives)
    sent: list[Reach] = []
    try:
        for frame in frames:
            sent.append(frame)
            await _send(session, frame, [m for m in due if any(m.drive is drive for drive in frame.drives)])
    except LineDown as error:
        for member in due:
            member.is_lost, member.note = True, may_be_done(error) if member.is_sent else str(error)
    outcomes = [await _after(session, member, is_due=member in due) for member in members]
    return GroupOutcome(tuple(sent), tuple(outcomes))


async def _one_by_one(session: Session, writes: Writes, *, again: bool) -> GroupOutcome:
    """Make each write by itself; a drive that is silent beforehand, or whose port is gone, is not written to."""
    frames, outcomes = [], []
    for drive, write in writes:
        try:
            outcome = await session.write(drive, write, again=again)
        except (NoReply, BadReply, LineDown) as error:
            outcome = Outcome(drive, write, Verdict.NOT_WRITTEN, None, None, str(error))
        if outcome.verdict not in (Verdict.NOT_WRITTEN, Verdict.EQUAL):
            frames.append(Reach(drive.protocol, drive.number, (drive,)))
        outcomes.append(outcome)
    return GroupOutcome(tuple(frames), tuple(outcomes))


async def _before(session: Session, drive: Drive, write: PlannedWrite) -> int | None:
    return await session.read_if_possible(drive, write.register)


async def _send(session: Session, frame: Reach, members: Sequence[_Member]) -> None:
    """Send one frame; what its one answer says is noted for the drive that gives it."""
    request = replace(members[0].write.request, number=frame.target)
    time = max(writing_time(member.drive, member.write) for member in members)
    for member in members:
        member.is_sent = True
    try:
        await session.send(PROTOCOLS[frame.protocol], request, time)
    except Refused as refused:
        for member in members:
            if not frame.is_group or member.drive is frame.representative:
                member.note, member.is_refused = refused.reason.value, True
    except (NoReply, BadReply) as error:
        for member in members:
            member.note = f"not acknowledged ({error})"


async def _after(session: Session, member: _Member, *, is_due: bool) -> Outcome:
    """Read back what a drive holds now, and judge by it."""
    drive, write = member.drive, member.write
    if not is_due:
        return Outcome(drive, write, Verdict.EQUAL, member.old, member.old)
    if member.is_lost:
        verdict = Verdict.UNKNOWN if member.is_sent else Verdict.NOT_WRITTEN
        return Outcome(drive, write, verdict, member.old, None, member.note)
    try:
        new = await session.read_if_possible(drive, write.register)
    except LineDown as error:
        return Outcome(drive, write, Verdict.UNKNOWN, member.old, None, may_be_done(error))
    verdict = judge(write, new, is_refused=member.is_refused)
    note = member.note or ("silent" if new is None else "")
    return Outcome(drive, write, verdict, member.old, new, note)
