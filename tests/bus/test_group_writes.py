"""Writes to several drives at once: who is reached by what, and what each of them holds afterwards."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest

from gateway.bus.group_writes import GroupOutcome, write_together
from gateway.control.writes import Allowed, Verdict, plan_write
from gateway.drives.notation import word_of
from gateway.errors import LineDown
from gateway.protocol.pdu import EVERY_DRIVE, Group, WriteRam
from gateway.sim.faults import Kind
from tests.bus.hand import Hand, gone_from, play
from tests.soak import FACTOR

STORED = Allowed(stored=True)
PROTOCOLS = ASCII, BINARY, MODBUS = "toshiba-ascii", "toshiba-binary", "modbus-rtu"


def line(protocol: str, *numbers: int, **more: Any) -> list[dict[str, Any]]:
    """Return VF-nC3 drives of one protocol."""
    return [{"number": number, "model": "vf-nc3", "protocol": protocol, **more} for number in numbers]


async def write(hand: Hand, names: list[str], name: str, value: str, *, again: bool = False) -> GroupOutcome:
    """Write one value to some of the drives."""
    writes = []
    for drive in map(hand.drive, names):
        register = drive.model.registers[name]
        word = word_of(register, value)
        writes.append((drive, plan_write(drive.model, drive.codec, drive.number, register, word, STORED)))
    return await write_together(hand.session, writes, again=again)


def verdicts(done: GroupOutcome) -> dict[str, Verdict]:
    """Return the verdict on each drive."""
    return {outcome.drive.name: outcome.verdict for outcome in done.outcomes}


def addresses(done: GroupOutcome) -> list[str]:
    """Return whom the frames were addressed to."""
    return [frame.address for frame in done.frames]


@pytest.mark.parametrize(("protocol", "address"), [(ASCII, "1*"), (BINARY, "FFH"), (MODBUS, "0")])
def test_one_frame_for_all_and_each_is_read_back(protocol: str, address: str) -> None:
    """Three drives hold what was sent once."""

    async def scene(hand: Hand) -> None:
        done = await write(hand, ["d11", "d12", "d13"], "frequency_command", "25.00")
        assert addresses(done) == [address]
        assert verdicts(done) == {"d11": Verdict.DONE, "d12": Verdict.DONE, "d13": Verdict.DONE}
        assert [hand.word(number, "frequency_command") for number in (11, 12, 13)] == [2500] * 3
        assert len(hand.frames) == 3 + 1 + 3

    play(line(protocol, 11, 12, 13), scene)


def test_drives_that_are_read_in_binary_are_reached_by_a_digit_in_ascii() -> None:
    """Where FFH would reach one more."""

    async def scene(hand: Hand) -> None:
        done = await write(hand, ["d11", "d12"], "frequency_command", "25.00")
        assert addresses(done) == ["1*"]
        assert [hand.word(number, "frequency_command") for number in (11, 12, 22)] == [2500, 2500, 0]

    play(line(BINARY, 11, 12, 22), scene)


@pytest.mark.parametrize("protocol", [ASCII, BINARY, MODBUS])
def test_a_drive_outside_the_group_keeps_what_it_has(protocol: str) -> None:
    """The members are then addressed one by one."""

    async def scene(hand: Hand) -> None:
        done = await write(hand, ["d5", "d16"], "frequency_command", "25.00")
        assert addresses(done) == ["number 5", "number 16"]
        assert hand.word(27, "frequency_command") == 0

    play(line(protocol, 5, 16, 27), scene)


def test_mixed_protocols_have_a_frame_each() -> None:
    """TOSHIBA and MODBUS-RTU on one line."""

    async def scene(hand: Hand) -> None:
        done = await write(hand, ["d1", "d2", "d3", "d4"], "frequency_command", "25.00")
        assert addresses(done) == ["0*", "0"]
        assert set(verdicts(done).values()) == {Verdict.DONE}

    play(line(ASCII, 1, 2) + line(MODBUS, 3, 4), scene)


@pytest.mark.parametrize(
    ("protocol", "group"), [(ASCII, Group(tens=0)), (BINARY, EVERY_DRIVE), (MODBUS, EVERY_DRIVE)]
)
def test_each_drive_is_told_of_for_itself(protocol: str, group: Group) -> None:
    """One did not hear the frame, one is silent altogether."""

    async def scene(hand: Hand) -> None:
        hand.fault(Kind.CUT, 3)
        hand.fault_at(WriteRam(group, 0xFA01, 2500), "d1", Kind.CUT, drive=2, count=1)
        done = await write(hand, ["d1", "d2", "d3"], "frequency_command", "25.00")
        assert verdicts(done) == {"d1": Verdict.DONE, "d2": Verdict.NOT_DONE, "d3": Verdict.UNKNOWN}
        assert [outcome.note for outcome in done.outcomes] == ["", "", "silent"]

    play(line(protocol, 1, 2, 3), scene)


def test_the_representatives_refusal_is_its_own() -> None:
    """The others are judged by what they hold: here they refused it in silence."""

    async def scene(hand: Hand) -> None:
        done = await write(hand, ["d10", "d11"], "frequency_command", "90.00")
        assert addresses(done) == ["1*"]
        assert verdicts(done) == {"d10": Verdict.REFUSED, "d11": Verdict.NOT_DONE}
        assert done.outcomes[0].note == "data range error"

    play(line(ASCII, 10, 11), scene)


@pytest.mark.hazard("H08")
@pytest.mark.parametrize("protocol", [ASCII, BINARY, MODBUS])
def test_nobodys_eeprom_is_worn_for_what_it_has(protocol: str) -> None:
    """A frame for all would wear the one that has the value: the other two are addressed."""

    async def scene(hand: Hand) -> None:
        done = await write(hand, ["d1", "d2", "d3"], "free_notes", "7")
        assert verdicts(done) == {"d1": Verdict.DONE, "d2": Verdict.EQUAL, "d3": Verdict.DONE}
        assert addresses(done) == ["number 1", "number 3"]
        assert [dict(hand.wear(number)) for number in (1, 2, 3)] == [{0x0880: 1}, {}, {0x0880: 1}]
        again = await write(hand, ["d1", "d2", "d3"], "free_notes", "7", again=True)
        assert set(verdicts(again).values()) == {Verdict.DONE}
        assert [hand.wear(number)[0x0880] for number in (1, 2, 3)] == [2, 1, 2]

    drives = line(protocol, 1, 2, 3)
    drives[1]["registers"] = {"free_notes": 7}
    play(drives, scene)


@pytest.mark.hazard("H09")
@pytest.mark.parametrize("protocol", [ASCII, MODBUS])
def test_a_fault_reset_of_a_group_is_seen_at_each_drive(protocol: str) -> None:
    """Nobody answers; all are waited for."""

    async def scene(hand: Hand) -> None:
        for number in (1, 2):
            hand.simulated(number).inverter.trip(1)
        done = await write(hand, ["d1", "d2"], "command", "fault_reset+command_priority")
        assert set(verdicts(done).values()) == {Verdict.DONE}
        assert all(outcome.note.startswith("not tripped") for outcome in done.outcomes)

    play(line(protocol, 1, 2), scene)


@pytest.mark.hazard("H09")
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_fault_reset_of_a_group_goes_to_its_tripped_drives_only(protocol: str) -> None:
    """One by one; the one that runs goes on running, the silent one is not written to."""

    async def scene(hand: Hand) -> None:
        hand.simulated(1).inverter.trip(1)
        hand.fault(Kind.CUT, 3)
        done = await write(hand, ["d1", "d2", "d3"], "command", "fault_reset+command_priority")
        assert addresses(done) == ["number 1"]
        assert verdicts(done) == {"d1": Verdict.DONE, "d2": Verdict.NOT_WRITTEN, "d3": Verdict.NOT_WRITTEN}
        assert [outcome.note[:11] for outcome in done.outcomes[1:]] == ["not tripped", "number 3: n"]

    play(line(protocol, 1, 2, 3, running_at=20.0), scene)


@pytest.mark.hazard("H15")
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_port_that_goes_leaves_what_was_sent_unknown_and_the_rest_not_written(protocol: str) -> None:
    """Two drives of three that are addressed one by one: two reads, two frames, two read-backs."""

    async def scene(hand: Hand) -> None:
        expected = [
            (2, Verdict.UNKNOWN, Verdict.NOT_WRITTEN, (0, 0)),
            (3, Verdict.UNKNOWN, Verdict.UNKNOWN, (2500, 0)),
            (4, Verdict.UNKNOWN, Verdict.UNKNOWN, (2500, 2500)),
            (5, Verdict.DONE, Verdict.UNKNOWN, (2500, 2500)),
        ]
        gone_from(hand, 1)
        with pytest.raises(LineDown):
            await write(hand, ["d5", "d16"], "frequency_command", "25.00")
        for place, first, second, words in expected:
            gone_from(hand, place)
            done = await write(hand, ["d5", "d16"], "frequency_command", "25.00")
            assert verdicts(done) == {"d5": first, "d16": second}
            assert (hand.word(5, "frequency_command"), hand.word(16, "frequency_command")) == words

    play(line(protocol, 5, 16, 27), scene)


def disturbed_group(chance: Random) -> set[Verdict]:
    """Write to some drives of a mixed, disturbed line; hold each verdict against what the drive holds."""
    told: set[Verdict] = set()
    entries = [
        {"number": number, "model": chance.choice(("vf-nc3", "vf-mb1")), "protocol": chance.choice(PROTOCOLS)}
        for number in chance.sample(range(1, 30), 5)
    ]
    members = [f"d{entry['number']}" for entry in entries if chance.random() < 0.6]
    faults = [
        {"kind": kind.value, "probability": chance.uniform(0, 0.3)}
        for kind in chance.sample((Kind.DROP, Kind.CUT, Kind.TRUNCATE, Kind.FLIP, Kind.ECHO), 2)
    ]

    async def scene(hand: Hand) -> None:
        name, value = chance.choice((("frequency_command", "12.34"), ("free_notes", "7")))
        done = await write(hand, members, name, value)
        assert [outcome.drive.name for outcome in done.outcomes] == members
        for outcome in done.outcomes:
            told.add(outcome.verdict)
            held = hand.word(outcome.drive.number, name)
            if outcome.verdict is not Verdict.UNKNOWN:
                assert outcome.new == held
                assert outcome.write.reads_back(held) is outcome.verdict.is_good
        for drive in hand.line.drives:
            assert drive.name in members or hand.word(drive.number, name) == 0
            assert hand.wear(drive.number).get(0x0880, 0) <= 1

    play(entries, scene, fault=faults, seed=chance.randrange(1000))
    return told


@pytest.mark.unmeasured
def test_whatever_goes_wrong_each_verdict_is_what_its_drive_holds() -> None:
    """Random lines, groups and faults; no drive outside the group is written to, and none twice."""
    told = [disturbed_group(Random(seed)) for seed in range(30 * FACTOR)]
    assert {Verdict.DONE, Verdict.NOT_DONE} <= set().union(*told)
