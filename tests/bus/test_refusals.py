"""What a drive refuses is learnt and planned around, and asked for again after a reset or a loss."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gateway import site
from gateway.bus.blocks import Abilities, PlannedRead, Planner, area
from gateway.bus.reader import DriveReader
from gateway.bus.refusals import BUSY_BLOCKS, REFUSALS
from gateway.bus.work import Learnt, Task, Work
from gateway.errors import Refusal, Refused
from gateway.protocol.pdu import ReadBlock, ReadWords, Words
from tests.bus.rig import FIVE

NO_SUCH = Refused("no such number", Refusal.ADDRESS)


def reader() -> DriveReader:
    """Return the reading of a VF-nC3 that is set up: its block carries five values, one more is read beside them."""
    section = {"name": "p", "number": 1, "model": "vf-nc3", "provision": True}
    section["poll"] = [{"values": [*FIVE, "input_voltage"], "every": "1s"}]
    table = {"gateway": {"name": "g"}, "line": [{"name": "a", "port": "/dev/none", "drive": [section]}]}
    (line,) = site.build(table, "test", Path()).lines
    (drive,) = line.drives
    made = DriveReader(drive, Planner(1, drive.model, drive.codec, line.timing, 0.015))
    made.reading.able = Abilities(mapping=tuple(drive.model.registers[name] for name in FIVE))
    made.reading.facts = {"reset_detection": 1, "block_mode": 0}
    made.reading.is_set_up = True
    return made


def refuse_a_direct_block(of: DriveReader) -> Learnt:
    """Refuse FD00-FD03 in one."""
    registers = [of.reading.drive.model.registers[name] for name in ("output_frequency", "status")]
    read = PlannedRead(ReadWords(1, 0xFD00, 2), tuple(registers))
    return of.on_refused(Work(Task.POLL, read.request, read), NO_SUCH, 1.0)


def refuse_a_value(of: DriveReader) -> Learnt:
    """Refuse a single read as often as it takes."""
    register = of.reading.drive.model.registers["input_voltage"]
    work = Work(Task.POLL, ReadWords(1, register.address), PlannedRead(ReadWords(1, register.address), (register,)))
    return [of.on_refused(work, NO_SUCH, float(time)) for time in range(REFUSALS)][-1]


def refuse_the_block(of: DriveReader) -> Learnt:
    """Refuse the indirect block."""
    work = Work(Task.POLL, ReadBlock(1, 0x1875, 5))
    return of.on_refused(work, NO_SUCH, 1.0)


def reset(of: DriveReader) -> None:
    """Read FA87 as 0: the drive was reset, and nobody saw it silent."""
    register = of.reading.drive.model.registers["reset_detection"]
    read = PlannedRead(ReadWords(1, register.address), (register,))
    learnt = of.on_reply(Work(Task.RECHECK, read.request, read), Words((0,)), 2.0)
    assert "the drive was reset" in learnt.notes
    assert learnt.jobs is not None


def is_planned_around(of: DriveReader) -> dict[str, bool]:
    """Say what is not asked for."""
    reads = [read for _, reads in of.jobs.plan() for read in reads]
    return {
        "direct": area(0xFD00) in of.reading.able.no_direct,
        "value": "input_voltage" not in {register.name for read in reads for register in read.registers},
        "block": not any(isinstance(read.request, ReadBlock) for read in reads),
    }


REFUSED: dict[str, Callable[[DriveReader], Learnt]] = {
    "direct": refuse_a_direct_block,
    "value": refuse_a_value,
    "block": refuse_the_block,
}


@pytest.mark.parametrize("what", REFUSED)
@pytest.mark.parametrize("again", [reset, DriveReader.forget], ids=["a reset", "a loss"])
def test_a_refusal_is_planned_around_until_a_reset_or_a_loss(what: str, again: Callable[[DriveReader], None]) -> None:
    """Direct blocks of the area, a value that is refused, the indirect block: not asked for, then asked for anew."""
    of = reader()
    assert not any(is_planned_around(of).values())
    learnt = REFUSED[what](of)
    assert learnt.jobs is not None
    assert is_planned_around(of)[what]
    if what != "block":
        assert not is_planned_around(of)["block"]
    again(of)
    assert area(0xFD00) not in of.reading.able.no_direct
    assert of.reading.absent == set()
    if what == "block":  # its mapping has to be proved again: the selectors that are read then say which
        assert of.reading.able.mapping is None
    else:
        assert not is_planned_around(of)["value"]


def test_refusals_before_a_reset_do_not_count_with_those_after_it() -> None:
    """One refusal of a value and two of a busy block, a reset, one more each: nothing is given up."""
    of = reader()
    register = of.reading.drive.model.registers["input_voltage"]
    single = PlannedRead(ReadWords(1, register.address), (register,))
    value = Work(Task.POLL, single.request, single)
    block = Work(Task.POLL, ReadBlock(1, 0x1875, 5))
    busy = Refused("busy", Refusal.UNABLE)
    for _ in range(BUSY_BLOCKS - 1):
        of.on_refused(block, busy, 1.0)
    of.on_refused(value, NO_SUCH, 1.0)
    mapping = of.reading.able.mapping
    reset(of)
    of.reading.able = Abilities(mapping=mapping)  # proved again
    assert of.on_refused(block, busy, 3.0).jobs is None
    assert of.on_refused(value, NO_SUCH, 3.0).jobs is None
    assert of.reading.able.mapping == mapping
    assert of.reading.absent == set()
