"""A line used by hand: reads that are retried, writes that are made once and read back."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest

from gateway.bus.session import READ_TRIES
from gateway.control.writes import Allowed, PlannedWrite, Verdict, plan_write
from gateway.drives.notation import word_of
from gateway.errors import BadReply, LineDown, NoReply, Refused
from gateway.sim.faults import Kind
from gateway.site import Drive
from tests.bus.hand import Hand, gone_from, play
from tests.soak import FACTOR

STORED = Allowed(stored=True)
PROTOCOLS = ["modbus-rtu", "toshiba-ascii", "toshiba-binary"]
every_protocol = pytest.mark.parametrize("protocol", PROTOCOLS)


def nc3(number: int = 1, protocol: str = "modbus-rtu", **more: Any) -> dict[str, Any]:
    """Return a simulated and configured VF-nC3."""
    return {"number": number, "model": "vf-nc3", "protocol": protocol, **more}


def planned(drive: Drive, name: str, value: str, allowed: Allowed = STORED) -> PlannedWrite:
    """Plan a write of a value to one drive."""
    register = drive.model.registers[name]
    return plan_write(drive.model, drive.codec, drive.number, register, word_of(register, value), allowed)


@every_protocol
def test_a_read_brings_the_word(protocol: str) -> None:
    """And is one exchange where nothing goes wrong."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        assert await hand.session.read(drive, drive.model.registers["output_frequency"]) == 3000
        assert len(hand.frames) == 1

    play([nc3(protocol=protocol, running_at=30.0)], scene)


@every_protocol
@pytest.mark.parametrize("kind", [Kind.DROP, Kind.TRUNCATE, Kind.FLIP])
def test_a_read_is_repeated_where_its_answer_is_lost_or_broken(kind: Kind, protocol: str) -> None:
    """Twice; then it is given up, and said."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        register = drive.model.registers["output_frequency"]
        hand.fault(kind, count=READ_TRIES - 1)
        assert await hand.session.read(drive, register) == 3000
        assert len(hand.frames) == READ_TRIES
        hand.frames.clear()
        hand.fault(Kind.CUT)
        with pytest.raises(NoReply, match="number 1: no answer"):
            await hand.session.read(drive, register)
        assert len(hand.frames) == READ_TRIES

    play([nc3(protocol=protocol, running_at=30.0)], scene)


@every_protocol
def test_two_drives_with_one_number_are_suspected_where_garbage_answers(protocol: str) -> None:
    """Their answers fall upon each other, each time."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        hand.fault(Kind.FLIP)
        with pytest.raises(BadReply, match=r"number 1 answers garbage \(do two drives have this number\?\): "):
            await hand.session.read(drive, drive.model.registers["output_frequency"])

    play([nc3(protocol=protocol, running_at=30.0)], scene)


@pytest.mark.hazard("H16")
def test_a_late_answer_is_not_taken_for_the_next_ones() -> None:
    """MODBUS-RTU answers do not say what was asked: after silence the line is let rest first."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        hand.fault(Kind.LATE, value=0.3, count=1)
        assert await hand.session.read(drive, drive.model.registers["output_frequency"]) == 3000
        assert await hand.session.read(drive, drive.model.registers["trip_code"]) == 0

    play([nc3(running_at=30.0)], scene)


@every_protocol
def test_a_refused_read_is_not_repeated(protocol: str) -> None:
    """The drive understood and said no."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        with pytest.raises(Refused):
            await hand.session.read(drive, drive.model.registers["master_slave"])
        assert len(hand.frames) == 1

    play([{**nc3(protocol=protocol), "model": "vf-mb1", "is": "vf-nc3"}], scene)


@every_protocol
def test_a_write_is_read_before_and_after(protocol: str) -> None:
    """Old value, the write, new value: three exchanges."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        outcome = await hand.session.write(drive, planned(drive, "frequency_command", "30.00"))
        assert (outcome.verdict, outcome.old, outcome.new) == (Verdict.DONE, 0, 3000)
        assert len(hand.frames) == 3
        assert hand.word(1, "frequency_command") == 3000
        assert not hand.wear(1)

    play([nc3(protocol=protocol)], scene)


@pytest.mark.hazard("H08")
@every_protocol
def test_the_eeprom_is_not_worn_for_a_value_that_it_has(protocol: str) -> None:
    """Only where it is asked for again: RAM may have it, and the EEPROM not."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        write = planned(drive, "free_notes", "7")
        assert (await hand.session.write(drive, write)).verdict is Verdict.DONE
        assert (await hand.session.write(drive, write)).verdict is Verdict.EQUAL
        assert hand.wear(1) == {0x0880: 1}
        assert (await hand.session.write(drive, write, again=True)).verdict is Verdict.DONE
        assert hand.wear(1) == {0x0880: 2}

    play([nc3(protocol=protocol)], scene)


@pytest.mark.hazard("H15")
@every_protocol
@pytest.mark.parametrize(("kind", "verdict", "word"), [(Kind.DROP, Verdict.DONE, 7), (Kind.CUT, Verdict.NOT_DONE, 0)])
def test_a_write_without_an_answer_is_never_repeated_and_the_drive_tells(
    kind: Kind, verdict: Verdict, word: int, protocol: str
) -> None:
    """The answer was lost, or the request: reading back decides."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        write = planned(drive, "free_notes", "7")
        hand.fault_at(write.request, "d1", kind, count=1)
        outcome = await hand.session.write(drive, write)
        assert (outcome.verdict, outcome.new) == (verdict, word)
        assert outcome.note == "not acknowledged (number 1: no answer)"
        assert hand.sent(write.request, "d1") == 1

    play([nc3(protocol=protocol)], scene)


@every_protocol
def test_a_drive_that_falls_silent_leaves_a_write_unknown(protocol: str) -> None:
    """Never failed: it may have been done."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        write = planned(drive, "free_notes", "7")
        hand.fault_at(write.request, "d1", Kind.CUT)
        outcome = await hand.session.write(drive, write)
        assert (outcome.verdict, outcome.old, outcome.new) == (Verdict.UNKNOWN, 0, None)

    play([nc3(protocol=protocol)], scene)


@every_protocol
def test_nothing_is_written_to_a_drive_that_is_silent_from_the_start(protocol: str) -> None:
    """The old value could not be read."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        hand.fault(Kind.CUT)
        with pytest.raises(NoReply):
            await hand.session.write(drive, planned(drive, "frequency_command", "30.00"))
        assert len(hand.frames) == READ_TRIES

    play([nc3(protocol=protocol)], scene)


@every_protocol
def test_a_refusal_is_told_with_the_drives_reason(protocol: str) -> None:
    """80 Hz is the limit of the simulated drive; the old value stays."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        outcome = await hand.session.write(drive, planned(drive, "frequency_command", "90.00"))
        assert (outcome.verdict, outcome.old, outcome.new) == (Verdict.REFUSED, 0, 0)
        assert "data range error" in outcome.note

    play([nc3(protocol=protocol)], scene)


@pytest.mark.hazard("H09")
@every_protocol
def test_a_fault_reset_is_sent_once_and_the_status_tells(protocol: str) -> None:
    """Silence is expected; the drive is deaf for a second, and not tripped afterwards."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        hand.simulated(1).inverter.trip(1)
        reset = planned(drive, "command", "fault_reset+command_priority")
        outcome = await hand.session.write(drive, reset)
        assert (outcome.verdict, outcome.note[:11]) == (Verdict.DONE, "not tripped")
        assert hand.sent(reset.request, "d1") == 1

    play([nc3(protocol=protocol)], scene)


@pytest.mark.hazard("H09")
@every_protocol
def test_a_drive_that_is_not_tripped_is_not_reset(protocol: str) -> None:
    """Its output would be cut, and its RAM lost: it goes on running."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        reset = planned(drive, "command", "fault_reset+command_priority")
        outcome = await hand.session.write(drive, reset)
        assert (outcome.verdict, outcome.note) == (
            Verdict.NOT_WRITTEN,
            "not tripped: a reset would stop it and clear its RAM",
        )
        assert hand.sent(reset.request, "d1") == 0

    play([nc3(protocol=protocol, running_at=30.0)], scene)


@pytest.mark.hazard("H09")
@every_protocol
def test_a_fault_reset_of_a_drive_that_stays_silent_is_unknown(protocol: str) -> None:
    """It was tripped, and nobody knows whether it is."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        hand.simulated(1).inverter.trip(1)
        reset = planned(drive, "command", "fault_reset+command_priority")
        hand.fault_at(reset.request, "d1", Kind.CUT)
        assert (await hand.session.write(drive, reset)).verdict is Verdict.UNKNOWN

    play([nc3(protocol=protocol)], scene)


@pytest.mark.hazard("H15")
@every_protocol
@pytest.mark.parametrize(("place", "word"), [(1, 0), (2, 3000)])
def test_a_port_that_goes_with_a_write_leaves_it_unknown(place: int, word: int, protocol: str) -> None:
    """At the write itself, or at its read-back; before that nothing was written, and LineDown says so."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        write = planned(drive, "frequency_command", "30.00")
        gone_from(hand, 0)
        with pytest.raises(LineDown):
            await hand.session.write(drive, write)
        gone_from(hand, place)
        outcome = await hand.session.write(drive, write)
        assert (outcome.verdict, outcome.note) == (Verdict.UNKNOWN, "it may have been done (pulled out)")
        assert hand.word(1, "frequency_command") == word

    play([nc3(protocol=protocol)], scene)


@pytest.mark.hazard("H09")
@every_protocol
def test_a_fault_reset_that_did_not_help_says_what_the_trip_is(protocol: str) -> None:
    """Without command priority this drive does not obey it."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        hand.simulated(1).inverter.trip(1)
        outcome = await hand.session.write(drive, planned(drive, "command", "fault_reset"))
        assert outcome.verdict is Verdict.NOT_DONE
        assert outcome.note == "still tripped, oc1: Overcurrent during acceleration"

    play([nc3(protocol=protocol)], scene)


FAULTS = (Kind.DROP, Kind.CUT, Kind.LATE, Kind.TRUNCATE, Kind.FLIP, Kind.DUPLICATE, Kind.BABBLE, Kind.ECHO)


def disturbed_write(protocol: str, chance: Random) -> Verdict | None:
    """Write to a drive on a disturbed line, and hold the verdict against what the drive holds; None: not written."""
    told: list[Verdict] = []
    value = chance.choice((7, 9))

    async def scene(hand: Hand) -> None:
        write = planned(hand.drive("d1"), "free_notes", str(value))
        try:
            outcome = await hand.session.write(hand.drive("d1"), write)
        except (NoReply, BadReply):
            assert hand.sent(write.request, "d1") == 0
            return
        told.append(outcome.verdict)
        assert hand.sent(write.request, "d1") == (outcome.verdict is not Verdict.EQUAL)
        if outcome.verdict is not Verdict.UNKNOWN:
            assert outcome.new == hand.word(1, "free_notes")
            assert (outcome.new == value) is outcome.verdict.is_good
        assert hand.wear(1).get(0x0880, 0) <= 1

    faults = [{"kind": kind.value, "probability": chance.uniform(0, 0.5)} for kind in chance.sample(FAULTS, 2)]
    late = [fault | {"value": 0.2} if fault["kind"] == "late" else fault for fault in faults]
    drive = nc3(protocol=protocol, registers={"free_notes": chance.choice((0, 7))})
    play([drive], scene, fault=late, seed=chance.randrange(1000))
    return told[0] if told else None


@pytest.mark.unmeasured
@pytest.mark.hazard("H15")
@pytest.mark.hazard("H16")
@every_protocol
def test_whatever_goes_wrong_the_verdict_is_what_the_drive_holds(protocol: str) -> None:
    """Random faults, the simulated drive as the judge; a write is sent once at the most."""
    verdicts = [disturbed_write(protocol, Random(f"{seed} {protocol}")) for seed in range(60 * FACTOR)]
    assert {Verdict.DONE, Verdict.EQUAL, Verdict.NOT_DONE} <= set(verdicts)
