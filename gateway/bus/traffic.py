"""What one line carries, in exchanges and seconds: its polls, and the premise on which their response is reckoned.

Always: every drive answers, each in its model's time at the longest. To the drives that may be commanded goes one
command a second, a frame and its read-back; FA87 of each is looked at once a second, F803, F804 or F808 every ten
seconds; and each is talked to in time for its F803.

Disturbed besides: one exchange in ten seconds is lost and takes the longest time there is; the drive is asked who it
is, and all its polls that fell due while it was left alone come at once. And silent drives take their share.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from gateway.bus import refresh
from gateway.bus.blocks import Planner
from gateway.bus.keepalive import PER_TIMEOUT
from gateway.bus.plan import DrivePlan
from gateway.bus.response import Stream, Traffic
from gateway.bus.schedule import Job
from gateway.bus.selectors import UNPROVEN_EVERY
from gateway.bus.work import Task, Work
from gateway.control import watchdog
from gateway.control.resets import MARK, MARK_EVERY
from gateway.control.timeout_looks import LOOK_EVERY
from gateway.protocol.pdu import Identify, ReadWords, Request
from gateway.site import Drive, Line

OWN = 0.001  # seconds of the gateway for each exchange
COMMAND_EVERY = 1.0  # seconds, of a whole line
COMMAND_FRAMES = 2  # the command itself, and its read-back
LOSS_EVERY = 10.0  # seconds


def streams(planner: Planner, jobs: Iterable[Job[Work]]) -> Iterator[Stream]:
    """Yield what is done for a drive again and again: its polls, and its checks of the block."""
    for job in jobs:
        period = job.period
        if job.work.task is Task.AUDIT:  # one that disagreed comes sooner, and soon no more
            period = max(UNPROVEN_EVERY, job.deadline - job.due)
        if period is not None:
            yield Stream(period, planner.cost(job.work.request) + OWN)


def undisturbed(line: Line, plans: Sequence[DrivePlan]) -> Traffic:
    """Return what a line carries while all drives answer and nothing is lost."""
    reserved = sum(stream.cost / stream.period for stream in _disturbances(line, plans))
    return Traffic(_polls(plans), tuple(_commands(line)), reserved)


def disturbed(line: Line, plans: Sequence[DrivePlan]) -> Traffic:
    """Return what a line carries when an exchange is lost now and then, and some drives are silent."""
    return Traffic(_polls(plans), (*_commands(line), *_disturbances(line, plans)))


def beside(line: Line, plans: Sequence[DrivePlan]) -> float:
    """Return the share of a line that goes ahead of polls, or is kept free for that."""
    return sum(stream.cost / stream.period for stream in (*_commands(line), *_disturbances(line, plans)))


def _polls(plans: Sequence[DrivePlan]) -> tuple[Stream, ...]:
    return tuple(stream for plan in plans for stream in streams(plan.planner, plan.jobs))


def _commands(line: Line) -> Iterator[Stream]:
    """Yield what goes to the drives that may be commanded."""
    controlled = [drive for drive in line.drives if drive.is_controlled]
    if not controlled:
        return
    longest = max(refresh.turn(line, drive) for drive in controlled)
    yield Stream(COMMAND_EVERY, COMMAND_FRAMES * (longest + OWN))
    lead = refresh.worst_case(line).lead
    for drive in controlled:
        if MARK in drive.model.registers:
            yield Stream(MARK_EVERY, _good(line, drive, ReadWords(drive.number, 0)))
        if watchdog.registers(drive.model):
            yield Stream(LOOK_EVERY, _good(line, drive, ReadWords(drive.number, 0)))
        timeout = drive.section.communication_timeout if drive.section is not None else None
        interval = (timeout or 0.0) / PER_TIMEOUT
        every = interval - lead if interval >= lead else interval / 2  # as `keepalive` lets a drive fall due
        cost = refresh.turn(line, drive) + OWN
        if interval and not any(group.period <= every for group in drive.groups):
            yield Stream(every + cost, cost)


def _disturbances(line: Line, plans: Sequence[DrivePlan]) -> Iterator[Stream]:
    lost = max(refresh.at_most(line, plan.drive, request) for plan in plans for request in _requests(plan))
    again = max(_good(line, plan.drive, who_is_there(plan.drive)) for plan in plans)
    held = max(sum(stream.cost for stream in streams(plan.planner, plan.jobs)) for plan in plans)
    yield Stream(LOSS_EVERY, lost + again + held)
    if len(line.drives) > 1:
        cost = max(silence(line, plan.drive) for plan in plans)
        yield Stream(cost / line.silent_share, cost)


def _requests(plan: DrivePlan) -> list[Request]:
    return [*(job.work.request for job in plan.jobs), who_is_there(plan.drive)]


def who_is_there(drive: Drive) -> Request:
    """Return what a drive is asked behind a loss, and while it is silent."""
    return Identify(drive.number) if drive.codec.forms.has_identification else ReadWords(drive.number, 0)


def silence(line: Line, drive: Drive) -> float:
    """Return how long a try of a silent drive takes."""
    sent = line.timing.request(len(drive.codec.encode(who_is_there(drive))))
    processing = drive.model.times.processing + drive.wait_time
    return 3 * line.timing.gap + sent + processing + line.margin + OWN


def _good(line: Line, drive: Drive, request: Request) -> float:
    codec, processing = drive.codec, drive.model.times.processing + drive.wait_time
    return line.timing.exchange(len(codec.encode(request)), codec.answer_size(request), processing) + OWN
