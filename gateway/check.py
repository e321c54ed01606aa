"""What a configuration comes to before anything runs: exchanges, their times, the load of each line, topics, map."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path

from gateway import check_control, site
from gateway.bus import arming, fitting, groups, refresh, traffic
from gateway.bus.blocks import PlannedRead
from gateway.bus.plan import DrivePlan, exchanges, plan_drive
from gateway.bus.response import Traffic
from gateway.errors import BadConfig
from gateway.protocol.pdu import ReadBlock
from gateway.protocol.registry import PROTOCOLS
from gateway.site import Line, Site

log = logging.getLogger("gateway")

FULL = 1.0  # share of the line
FASTEST = 38400  # baud, of F800
EXCHANGE_TAKES = 0.0006  # seconds of a processor for one exchange: python -m bench.many_lines
BUSY = 0.7  # of a core: beyond it lines wait for each other


def load(path: Path) -> Site:
    """Read a configuration file to run it; BadConfig for what `site.load` finds wrong, and for contradictions."""
    configured = site.load(path)
    _refuse(refresh.refusals(configured), path)
    return configured


def refuse(configured: Site, path: Path) -> None:
    """Raise BadConfig where a communication time-out contradicts itself, or cannot be kept (SAFETY.md H06, H30)."""
    _refuse([*refresh.refusals(configured), *refresh.too_short(configured)], path)


def refuse_late(configured: Site, path: Path) -> None:
    """Raise BadConfig where polls may be answered after they fall due again, though every drive answers."""
    refusals = []
    for index, line in enumerate(configured.lines):
        best = [plan_drive(drive, line, with_selectors=True) for drive in line.drives]
        if late := traffic.undisturbed(line, best).late:
            periods = ", ".join(map(_period, late))
            refusals.append(f"line[{index}] ({line.name}): polls {periods} may be late: ask for less, or more seldom")
    _refuse(refusals, path)


def warn(configured: Site, path: Path) -> None:
    """Log what `refuse` would say of time-outs that cannot be kept, and of commands: a plant is run with them."""
    for text in (*refresh.too_short(configured), *arming.too_short(configured)):
        log.warning("%s: %s", path, text)


def _refuse(refusals: Sequence[str], path: Path) -> None:
    if refusals:
        raise BadConfig("\n".join(f"{path}: {refusal}" for refusal in refusals))


def report(configured: Site) -> Iterator[str]:
    """Yield the plan of a site as lines of text."""
    name, lines, drives = configured.config.gateway.name, configured.lines, configured.drives
    yield f"gateway {name}: {len(lines)} lines, {len(drives)} drives"
    yield from _processor(lines)
    for line in lines:
        yield from _line(line)


def _processor(lines: Sequence[Line]) -> Iterator[str]:
    """Say what one process has to do: it uses one core, however many there are."""
    plans = ([plan_drive(drive, line, with_selectors=True) for drive in line.drives] for line in lines)
    rate = sum(map(exchanges, plans))
    share = rate * EXCHANGE_TAKES
    took = f"{EXCHANGE_TAKES * 1000:.1f} ms each, as measured on a PC"
    yield f"about {rate:.0f} exchanges a second: {share:.0%} of a core, at {took} (docs/scaling.md)"
    if share > BUSY:
        yield (
            f"TOO MUCH FOR ONE PROCESS: more than {BUSY:.0%} of a core. Give the lines to several processes"
            f" (about {share / BUSY + 0.5:.0f}), each with a file and a gateway.name of its own: docs/scaling.md"
        )


def _line(line: Line) -> Iterator[str]:
    shipped = [plan_drive(drive, line, with_selectors=False) for drive in line.drives]
    best = [plan_drive(drive, line, with_selectors=True) for drive in line.drives]
    yield ""
    yield f"line {line.name}: {line.port}, {line.baud} baud, parity {line.parity}, {len(line.drives)} drives"
    yield f"  gap between frames {line.timing.gap * 1000:.2f} ms; an answer may come {line.margin * 1000:.0f} ms late"
    yield f"  load with F875-F879 as below: {_load(best)};  as shipped (all 0): {_load(shipped)}"
    undisturbed = traffic.undisturbed(line, best)
    yield from _advice(line, shipped, best, undisturbed)
    yield from check_control.line(line)
    worst = refresh.worst_case(line)
    disturbed = traffic.disturbed(line, best).worst
    for plan in best:
        yield from _drive(plan, undisturbed, disturbed)
        yield from check_control.drive(plan.drive, line, worst)
    for group in line.groups:
        members = [drive for drive in line.drives if drive.name in group.drives]
        frames = groups.reach(members, line.drives)
        yield f"  group {group.name}: written by {len(frames)} {'frame' if len(frames) == 1 else 'frames'}"
        yield from (f"    {frame}" for frame in frames)


def _load(plans: Sequence[DrivePlan]) -> str:
    load = sum(plan.load for plan in plans)
    turn = sum(plan.round for plan in plans)
    text = f"{load:.0%} by timed polls"
    if not turn:
        return text
    if load >= FULL:
        return f"{text}, nothing left for the polls without a period"
    return f"{text}, the rest by polls without a period, each every {turn / (FULL - load) * 1000:.0f} ms"


def _advice(
    line: Line, shipped: Sequence[DrivePlan], best: Sequence[DrivePlan], undisturbed: Traffic
) -> Iterator[str]:
    load = sum(plan.load for plan in best)
    if load > FULL:
        longer = max(load, undisturbed.load)  # with the checks of blocks and F803, as each group is reckoned
        ways = "fewer values or longer periods"
        if line.baud < FASTEST:
            ways = f"fewer values, longer periods, or raise F800 ({FASTEST}) and line.baud together"
        yield (
            f"  DOES NOT FIT: {load:.0%} of the line is asked for. Every period will come out about"
            f" {longer:.1f} times as long. Ask for {ways}."
        )
    elif sum(plan.load for plan in shipped) > FULL:
        yield "  FITS ONLY with F875-F879 set as below (and the drives reset afterwards)."
    if undisturbed.is_kept:
        yield "  Every poll is answered before it falls due again, whatever falls together, while all drives answer."
        return
    asked = {group.period for plan in best for group, _ in plan.groups}
    late = ", ".join(_period(period) for period in undisturbed.late if period in asked)
    if load <= FULL and undisturbed.load > FULL:
        yield f"  ALWAYS LATE: with the checks of blocks and F803 the line is asked for {undisturbed.load:.0%} of it."
    elif load <= FULL and late:
        yield f"  LATE AT TIMES: polls {late}, when much falls together: how late, see below."
    ways = "; or ".join(fitting.ways(line, best, undisturbed))
    yield f"  In time whatever falls together: {ways}." if ways else "  No period is long enough: ask for less."


def _period(period: float) -> str:
    return f"every {period * 1000:.0f} ms" if period else "as fast as possible"


def _drive(plan: DrivePlan, undisturbed: Traffic, disturbed: Mapping[float, float]) -> Iterator[str]:
    drive = plan.drive
    unit = f"unit {drive.unit}" if drive.unit else "no unit of its own"
    yield f"  drive {drive.name}: number {drive.number}, {drive.model.name}, {drive.protocol}, {unit}"
    yield from _forms(plan)
    if plan.uses_block:
        pairs = ", ".join(f"F{875 + i}={code}" for i, code in enumerate(plan.selectors))
        who = "set in the drive, then reset it"
        if drive.provision:
            who = "set once by the gateway (EEPROM), then reset the drive"
        yield f"    {who}: {pairs}"
    for group, reads in plan.groups:
        period = f"{group.period * 1000:.0f} ms" if group.period else "as fast as possible"
        took = plan.planner.time(reads) * 1000
        yield f"    every {period}: {len(reads)} exchanges, {took:.1f} ms; stale after {group.max_age:.3g} s"
        if reads:
            yield f"      {_response(group.period, undisturbed, disturbed[group.period])}"
        for read in reads:
            yield f"      {_read(read)}"
        missing = {r.name for r in group.registers} - {r.name for read in reads for r in read.registers}
        if missing:
            yield f"      {', '.join(sorted(missing))}: come with a faster block"


def _response(period: float, undisturbed: Traffic, disturbed: float) -> str:
    """Say what period is reached, and how late an answer is at the worst."""
    worst = undisturbed.worst[period]
    reached = period * max(1.0, undisturbed.load) if period else undisturbed.fastest
    about = "" if period and undisturbed.load <= FULL else "about "
    return (
        f"asked {_asked(period)}, reachable {about}{_seconds(reached)}; answered {_seconds(worst)} after its time at"
        f" the worst, {_seconds(disturbed)} where exchanges are lost"
    )


def _asked(period: float) -> str:
    return _seconds(period) if period else "as fast as possible"


def _seconds(seconds: float) -> str:
    return f"{seconds * 1000:.0f} ms" if seconds < 10 else f"{seconds:.0f} s" if isfinite(seconds) else "any time"


def _forms(plan: DrivePlan) -> Iterator[str]:
    """Say what the protocol has not got, and what is used instead."""
    forms, drive = plan.drive.codec.forms, plan.drive
    has_model_block = drive.model.blocks.indirect_read_maximum > 0
    if has_model_block and not forms.has_block:
        number = drive.number
        better = [name for name, c in PROTOCOLS.items() if c.forms.has_block and number in c.forms.numbers]
        yield f"    {drive.protocol} has no block: single reads instead; with a block: {' or '.join(better)}"
    if drive.provision and not plan.planner.has_block:
        yield "    provision = true has no effect: there is no block to set selectors for"
    if drive.block_write:
        yield f"    {_block_write(plan)}"


def _block_write(plan: DrivePlan) -> str:
    """Say with which F870 and F871 run commands go with the block read."""
    drive, blocks = plan.drive, plan.drive.model.blocks
    if not (plan.uses_block and drive.codec.forms.has_exchange and blocks.has_exchange):
        return "block_write = true has no effect: no block is read, or nothing can be written with it"
    if drive.codec.forms.writes_all_or_none:
        return "run commands go with the block read: F870=1, F871=3 (command and frequency)"
    return "run commands go with the block read: F870=1, F871=0 (of two words, X may take one and refuse the other)"


def _read(read: PlannedRead) -> str:
    names = ", ".join(register.name for register in read.registers)
    if isinstance(read.request, ReadBlock):
        return f"indirect block, {read.request.count} words: {names}"
    form = "single read" if read.request.count == 1 else f"direct block, {read.request.count} words"
    return f"{form} from {read.request.address:04X}H: {names}"
