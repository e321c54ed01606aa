"""Values read by hand, as they are shown."""

from __future__ import annotations

import pytest

from gateway.commissioning.reading import as_lines, as_objects, in_words, read, wanted
from gateway.drives.catalogue import load
from gateway.drives.notation import NotUnderstood
from gateway.drives.register import Derived, Register
from gateway.errors import NoReply
from gateway.sim.faults import Kind
from tests.bus.hand import Hand, play

NC3 = load()["vf-nc3"]
ALL = ["output_frequency", "FD01", "F803", "trip_code", "0x0123", "output_voltage_volts"]


def test_what_can_be_asked_for() -> None:
    """Names, numbers, derived values; a number that the catalogue does not know is read as it is."""
    assert wanted(NC3, "F803") is NC3.registers["communication_timeout"]
    assert isinstance(wanted(NC3, "output_current_amps"), Derived)
    unknown = wanted(NC3, "0123")
    assert isinstance(unknown, Register)
    assert (unknown.name, unknown.address) == ("", 0x0123)
    with pytest.raises(NotUnderstood, match="did you mean 'output_frequency'"):
        wanted(NC3, "output_frequenzy")


@pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])
def test_every_kind_of_value_is_laid_out_in_columns(protocol: str) -> None:
    """Number, raw word twice, value with its unit or in words; a refusal in its own line."""

    async def scene(hand: Hand) -> None:
        drive = hand.drive("d1")
        found = await read(hand.session, drive, [wanted(drive.model, name) for name in ALL])
        lines = as_lines(found)
        assert lines[0] == "output_frequency       FD00  0BB8H  3000   30.00 Hz"
        assert lines[1].startswith("status                 FD01  ")
        assert "running" in lines[1]
        assert lines[2] == "communication_timeout  0803  0000H  0      0.0 s"
        assert lines[3] == "trip_code              FC90  0000H  0      nerr: No error"
        assert "communication number not known" in lines[4]
        assert lines[5].endswith(" V")
        objects = as_objects(found)
        assert objects[0] == {
            "drive": "d1",
            "name": "output_frequency",
            "number": "FD00",
            "raw": 3000,
            "value": 30.0,
            "unit": "Hz",
        }
        assert "running" in str(objects[1]["text"])
        assert "value" not in objects[1]
        assert objects[3]["text"] == "nerr: No error"
        assert set(objects[4]) == {"drive", "number", "problem"}
        assert set(objects[5]) == {"drive", "name", "value", "unit"}

    play([{"number": 1, "model": "vf-nc3", "protocol": protocol, "running_at": 30.0, "stable_bits": True}], scene)


def test_silence_ends_a_reading() -> None:
    """What comes behind would take as long each."""

    async def scene(hand: Hand) -> None:
        hand.fault(Kind.CUT)
        with pytest.raises(NoReply):
            await read(hand.session, hand.drive("d1"), [wanted(NC3, name) for name in ALL])

    play([{"number": 1, "model": "vf-nc3"}], scene)


def test_several_drives_are_named_in_front() -> None:
    """One drive is not."""

    async def scene(hand: Hand) -> None:
        found = [item for d in hand.line.drives for item in await read(hand.session, d, [wanted(NC3, "trip_code")])]
        assert [line.split()[0] for line in as_lines(found)] == ["d1", "d2"]
        assert as_lines([]) == []

    play([{"number": 1, "model": "vf-nc3"}, {"number": 2, "model": "vf-nc3"}], scene)


def test_values_in_a_sentence() -> None:
    """With the raw word behind; a question mark where it is not known."""
    assert in_words(NC3.registers["frequency_command"], 3000) == "30.00 Hz (0BB8H)"
    assert in_words(NC3.registers["command"], 0x8400) == "run, command_priority (8400H)"
    assert in_words(NC3.registers["command"], 0) == "none (0000H)"
    assert in_words(NC3.registers["timeout_action"], 1) == "Trip, coast stop (0001H)"
    assert in_words(NC3.registers["free_notes"], 7) == "7 (0007H)"
    assert in_words(NC3.registers["free_notes"], None) == "?"
