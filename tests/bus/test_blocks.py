"""The planner: every wanted register once, never over a limit, never dearer than single reads."""

from __future__ import annotations

import itertools
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway import site
from gateway.bus import selectors
from gateway.bus.blocks import HOLE, Abilities, PlannedRead, Planner, area
from gateway.bus.poll_jobs import PollJobs
from gateway.bus.reading import Reading
from gateway.bus.work import Task
from gateway.drives import catalogue
from gateway.drives.model import Model
from gateway.drives.register import Register
from gateway.protocol.codec import Forms
from gateway.protocol.modbus_rtu import ModbusRtu
from gateway.protocol.pdu import ReadBlock, ReadWords
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.timing import LineTiming

MODELS = catalogue.load()
NC3 = MODELS["vf-nc3"]


def planner(model: Model = NC3, baud: int = 19200) -> Planner:
    """Return a planner for drive 1."""
    return Planner(1, model, ModbusRtu(), LineTiming(baud), model.times.processing)


def registers(*names: str, model: Model = NC3) -> list[Register]:
    """Return registers by name."""
    return [model.registers[name] for name in names]


def as_set(*names: str, model: Model = NC3) -> Abilities:
    """Return the abilities of a drive whose block carries these registers ("" for none)."""
    return Abilities(mapping=tuple(model.registers[name] if name else None for name in names))


FIVE = ("status", "output_frequency", "output_current", "output_voltage", "alarm")


def test_five_selected_values_are_one_indirect_block() -> None:
    """F875-F879 = 1-5."""
    (read,) = planner().plan(registers(*FIVE), as_set(*FIVE))
    assert read.request == ReadBlock(1, 0x1875, 5)
    assert [register.name for register in read.registers] == list(FIVE)


def test_the_block_is_no_longer_than_it_must_be_and_not_shorter_than_allowed() -> None:
    """One wanted value: a single read; two: two words; what stands behind is not read."""
    (one,) = planner().plan(registers("status"), as_set(*FIVE))
    assert one.request == ReadWords(1, 0xFD01)
    (two,) = planner().plan(registers("status", "output_frequency"), as_set(*FIVE))
    assert two.request == ReadBlock(1, 0x1875, 2)


def test_an_unset_selector_is_a_dummy_and_its_value_is_read_another_way() -> None:
    """F876 = 0: its word is no value (H20)."""
    able = Abilities(mapping=as_set("status", "", "output_current").mapping, no_direct=frozenset({0xFD}))
    reads = planner().plan(registers("status", "output_frequency", "output_current"), able)
    assert {type(read.request) for read in reads} == {ReadBlock, ReadWords}
    block = next(read for read in reads if isinstance(read.request, ReadBlock))
    assert block.values([0x6400, 0x1234, 5000]) == [(0xFD01, 0x6400), (0xFD03, 5000)]


def test_neighbours_are_one_direct_block_until_that_is_refused() -> None:
    """FD00-FD03 in one; after a refusal of the area, singles."""
    wanted = registers("output_frequency", "status", "output_current")
    (block,) = planner().plan(wanted, Abilities())
    assert block.request == ReadWords(1, 0xFD00, 4)
    singles = planner().plan(wanted, Abilities(no_direct=frozenset({area(0xFD00)})))
    assert [read.request.count for read in singles] == [1, 1, 1]


@pytest.mark.hazard("H20")
def test_8000h_in_a_direct_block_is_doubtful_and_not_a_value() -> None:
    """Only a single read tells a hole from -32768."""
    wanted = registers("output_frequency", "status", "output_current")
    (block,) = planner().plan(wanted, Abilities())
    words = [6000, 0x6400, HOLE, HOLE]
    assert block.values(words) == [(0xFD00, 6000), (0xFD01, 0x6400)]
    assert [register.name for register in block.doubtful(words)] == ["output_current"]


@pytest.mark.hazard("H20")
def test_8000h_of_a_single_read_or_an_indirect_block_is_a_value() -> None:
    """There are no holes there."""
    (single,) = planner().plan(registers("cumulative_operation_time"), Abilities())
    assert single.values([HOLE]) == [(0xFE14, HOLE)]
    (block,) = planner().plan(registers(*FIVE), as_set(*FIVE))
    assert block.doubtful([HOLE] * 5) == []


abilities = st.builds(
    Abilities,
    mapping=st.none()
    | st.lists(st.sampled_from([None, *(NC3.registers[name] for name in NC3.read_selectors.values() if name)]),
               min_size=5, max_size=5).map(tuple),
    no_direct=st.frozensets(st.sampled_from([0, 0xFA, 0xFB, 0xFC, 0xFD, 0xFE])),
    only_single=st.frozensets(st.sampled_from(sorted(NC3.registers))),
)
wanted_sets = st.lists(st.sampled_from(sorted(NC3.registers)), unique=True, max_size=14)


def check(reads: tuple[PlannedRead, ...], wanted: list[Register], able: Abilities) -> None:
    """Assert what every plan must keep."""
    brought = [r.name for read in reads for r in read.registers if r in wanted]
    assert sorted(brought) == sorted(r.name for r in wanted)
    for read in reads:
        if isinstance(read.request, ReadBlock):
            assert read.request.address == NC3.blocks.indirect_read_address
            assert NC3.blocks.indirect_read_minimum <= read.request.count <= NC3.blocks.indirect_read_maximum
        elif read.request.count > 1:
            assert read.request.count <= NC3.blocks.direct_read_maximum
            assert read.carries[0] is not None
            assert read.carries[-1] is not None
            assert area(read.request.address) not in able.no_direct
            assert not able.only_single & {r.name for r in read.registers}


@settings(max_examples=300)
@given(wanted_sets, abilities)
def test_every_wanted_register_comes_exactly_once_and_no_limit_is_broken(
    names: list[str], able: Abilities
) -> None:
    """And no plan costs more than single reads of everything."""
    wanted = registers(*names)
    plan = planner()
    carried = [register.name for register in able.mapping or () if register is not None]
    if len(set(carried)) < len(carried):
        able = Abilities(None, able.no_direct, able.only_single)  # the same value twice in the block
    reads = plan.plan(wanted, able)
    check(reads, wanted, able)
    assert plan.time(reads) <= len(wanted) * plan.cost(ReadWords(1, 0)) + 1e-9


@given(wanted_sets.filter(lambda names: 0 < len(names) <= 5), st.sampled_from([9600, 19200, 38400]))
def test_no_split_into_direct_blocks_and_singles_is_cheaper(names: list[str], baud: int) -> None:
    """Against every way to cut the sorted registers."""
    plan = planner(baud=baud)
    order = sorted(registers(*names), key=lambda register: register.address)
    best = min(_cost_of(plan, order, cuts) for cuts in itertools.product([False, True], repeat=len(order) - 1))
    assert plan.time(plan.plan(order, Abilities())) == pytest.approx(best)


def _cost_of(plan: Planner, order: list[Register], cuts: tuple[bool, ...]) -> float:
    runs = [[order[0]]]
    for register, cut in zip(order[1:], cuts, strict=True):
        if cut:
            runs.append([register])
        else:
            runs[-1].append(register)
    total = 0.0
    for run in runs:
        span = run[-1].address - run[0].address + 1
        if span > NC3.blocks.direct_read_maximum or area(run[0].address) != area(run[-1].address):
            return float("inf")
        total += plan.cost(ReadWords(1, 0, span))
    return total


# ---- in every protocol and model: as often as promised, no hole, no limit broken


def drive_of(draw: st.DrawFn) -> tuple[site.Drive, Reading]:
    """Draw a drive of any model with poll groups of any values, and its reading."""
    model = MODELS[draw(st.sampled_from(["vf-nc3", "vf-mb1"]))]
    protocol = draw(st.sampled_from(sorted(PROTOCOLS)))
    readable = sorted(name for name in model.registers if name not in ("command",))
    groups = draw(st.lists(st.lists(st.sampled_from(readable), min_size=1, max_size=7), min_size=1, max_size=3))
    periods = draw(st.lists(st.sampled_from(["0s", "100ms", "1s", "7s"]), min_size=3, max_size=3, unique=True))
    polls = [{"values": names, "every": every} for names, every in zip(groups, periods, strict=False)]
    section = {"name": "p", "number": 1, "model": model.name, "protocol": protocol, "poll": polls}
    (line,) = site.build(
        {"gateway": {"name": "g"}, "line": [{"name": "a", "port": "/dev/none", "drive": [section]}]}, "test", Path()
    ).lines
    (drive,) = line.drives
    plan = Planner(1, drive.model, drive.codec, line.timing, drive.model.times.processing)
    return drive, Reading(drive, plan)


@pytest.mark.unmeasured
@settings(max_examples=60, deadline=None)
@given(st.data())
def test_every_asked_register_is_read_as_often_as_promised_in_every_protocol(data: st.DataObject) -> None:
    """By one read of its fastest group or a faster one, by none besides but a block that carries it anyway."""
    drive, reading = data.draw(st.composite(drive_of)())
    forms, model = drive.codec.forms, drive.model
    codes = [code for code, name in model.read_selectors.items() if name]
    if forms.has_block and data.draw(st.booleans()):
        words = data.draw(st.lists(st.sampled_from(codes), min_size=5, max_size=5, unique=True))
        reading.able = Abilities(mapping=selectors.mapping_of(model, words))
    promised: dict[str, float] = {}
    for group in drive.groups:
        for register in group.registers:
            promised[register.name] = min(group.period, promised.get(register.name, group.period))
    polls = [
        (job.period, job.work.read)
        for job in PollJobs(reading).polls(0.0)
        if job.work.task is Task.POLL and job.period is not None and job.work.read is not None
    ]
    for name, period in promised.items():
        carried = [(every, read) for every, read in polls if name in {r.name for r in read.registers}]
        assert min(every for every, _ in carried) <= period
        assert sum(not isinstance(read.request, ReadBlock) for _, read in carried) <= 1
    for _, read in polls:
        assert any(register.name in promised for register in read.registers)
        keeps_the_limits(read, model, forms)


def keeps_the_limits(read: PlannedRead, model: Model, forms: Forms) -> None:
    """Assert that protocol and model have the form, at that length."""
    count = read.request.count
    if isinstance(read.request, ReadBlock):
        assert forms.has_block
        assert model.blocks.indirect_read_minimum <= count <= model.blocks.indirect_read_maximum
    elif count > 1:
        assert forms.has_direct_block
        assert count <= model.blocks.direct_read_maximum
        assert read.carries[0] is not None
        assert read.carries[-1] is not None


@given(wanted_sets.filter(bool), st.integers(0, 999))
def test_no_value_comes_out_of_a_hole(names: list[str], seed: int) -> None:
    """A drive with numbers missing between the wanted ones: what is read is what the registers hold."""
    chance = Random(seed)
    wanted = registers(*names)
    memory = {register.address: chance.choice([HOLE, chance.randrange(0x10000)]) for register in wanted}
    told: dict[int, int] = {}
    doubtful: set[int] = set()
    for read in planner().plan(wanted, Abilities()):
        assert isinstance(read.request, ReadWords)
        words = [memory.get(read.request.address + offset, HOLE) for offset in range(read.request.count)]
        told |= dict(read.values(words))
        doubtful |= {register.address for register in read.doubtful(words)}
    assert told.items() <= memory.items()
    assert doubtful == memory.keys() - told.keys()
    assert all(memory[address] == HOLE for address in doubtful)
