"""Values written by hand: all checked first, made in order, told of one by one."""

from __future__ import annotations

from typing import Any

import pytest

from gateway.commissioning.targets import Target
from gateway.commissioning.writing import Wish, assignment, plan, write
from gateway.control.writes import Allowed, BadCommand
from gateway.drives.notation import NotUnderstood
from gateway.errors import BadConfig, LineDown, NoReply
from gateway.sim.faults import Kind
from tests.bus.hand import Hand, gone_from, play
from tests.drives.files import written

STORED = Allowed(stored=True)
NC3 = {"number": 1, "model": "vf-nc3"}


def wish(*texts: str, allowed: Allowed = STORED, **more: Any) -> Wish:
    """Return a call's wish."""
    return Wish(tuple(assignment(text) for text in texts), allowed, **more)


async def said(hand: Hand, wanted: Wish, *names: str) -> tuple[bool, list[str]]:
    """Write to drives of the line, together where there are several; return success and what was said."""
    drives = tuple(hand.drive(name) for name in names or ("d1",))
    lines: list[str] = []
    target = Target(hand.line, drives, is_group=len(drives) > 1)
    is_good = await write(hand.session, target, wanted, lines.append, lines.append)
    return is_good, lines


def test_what_was_used_the_old_value_and_the_new_one_are_said() -> None:
    """In units, and raw."""

    async def scene(hand: Hand) -> None:
        assert await said(hand, wish("frequency_command=30.0", "FA00=run+command_priority")) == (
            True,
            [
                "writing frequency_command (FA01) = 30.00 Hz (0BB8H): 06H, RAM only",
                "  d1: 0.00 Hz (0000H) -> 30.00 Hz (0BB8H): done",
                "writing command (FA00) = run, command_priority (8400H): 06H, RAM only",
                "  d1: none (0000H) -> run, command_priority (8400H): done",
            ],
        )
        assert (await said(hand, wish("FA01=0x0100", is_raw=True)))[0]
        assert hand.word(1, "frequency_command") == 0x0100

    play([NC3], scene)


@pytest.mark.hazard("H22")
@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        ("status=1", BadCommand),
        ("F803=100.1", BadCommand),
        ("F803=soon", NotUnderstood),
        ("nothing=1", NotUnderstood),
    ],
)
def test_nothing_is_sent_where_any_part_is_wrong(wrong: str, error: type[Exception]) -> None:
    """The first part would have been right."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(error):
            await said(hand, wish("frequency_command=30.0", wrong))
        assert hand.frames == []

    play([NC3], scene)


@pytest.mark.hazard("H22")
def test_what_comes_behind_a_failure_is_not_written_and_said() -> None:
    """The drive refuses 90 Hz: no run command follows."""

    async def scene(hand: Hand) -> None:
        is_good, lines = await said(hand, wish("frequency_command=90", "command=run", "free_notes=1"))
        assert not is_good
        assert lines[1].endswith("0.00 Hz (0000H): refused; data range error")
        assert lines[2:] == ["not written any more: command (FA00), free_notes (0880)"]
        assert (hand.word(1, "command"), hand.word(1, "free_notes")) == (0, 0)

    play([NC3], scene)


@pytest.mark.hazard("H08")
def test_an_equal_stored_value_is_told_with_the_way_to_write_it_again() -> None:
    """P may have put it into the RAM only."""

    async def scene(hand: Hand) -> None:
        is_good, lines = await said(hand, wish("free_notes=7"))
        assert is_good
        assert lines[1].endswith("not written: reads so already; if only the RAM has it, --again writes it to the"
                                 " EEPROM all the same")  # fmt: skip
        assert (await said(hand, wish("free_notes=7", again=True)))[1][1].endswith("done")
        assert dict(hand.wear(1)) == {0x0880: 1}

    play([{**NC3, "registers": {"free_notes": 7}}], scene)


@pytest.mark.hazard("H07")
def test_another_model_than_the_one_given_is_not_written_to() -> None:
    """Its numbers may mean something else."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(BadConfig, match="vf-nc3 is configured, 'VFMB1"):
            await said(hand, wish("free_notes=7"))
        assert hand.word(1, "free_notes") == 0

    play([{**NC3, "is": "vf-mb1"}], scene)


@pytest.mark.hazard("H31")
def test_a_limit_that_the_catalogue_knows_is_read_and_kept(tmp_path: Any) -> None:
    """FH of a file that extends the model; the drive itself would have taken it."""
    text = """
extend = "vf-nc3"
[[register]]
name = "maximum_frequency"
address = 0x0011
kind = "parameter"
unit = "Hz"
scale = "0.01"
initial = 5000
access = "rw"
storage = "eeprom"
source = "x"
[[register]]
name = "frequency_command"
replaces = true
address = 0xFA01
kind = "command"
unit = "Hz"
scale = "0.01"
maximum_from = "maximum_frequency"
access = "rw"
storage = "ram"
source = "x"
"""

    async def scene(hand: Hand) -> None:
        assert (await said(hand, wish("frequency_command=50")))[0]
        hand.frames.clear()
        with pytest.raises(BadCommand, match=r"50\.01 is beyond maximum_frequency \(0011\), 50\.00 Hz"):
            await said(hand, wish("frequency_command=50.01"))
        assert all(frame[1] in (0x03, 0x2B) for frame in hand.frames), "nothing but reads"

    play([NC3], scene, files=[str(written(tmp_path, text))])


def test_a_group_is_told_with_its_frames_and_each_of_its_drives() -> None:
    """A silent one does not hold up the others."""

    async def scene(hand: Hand) -> None:
        hand.fault(Kind.CUT, 2)
        is_good, lines = await said(hand, wish("frequency_command=30.0"), "d1", "d2")
        assert not is_good
        assert lines == [
            "writing frequency_command (FA01) = 30.00 Hz (0BB8H): 06H, RAM only",
            "  to 0 (modbus-rtu): d1, d2; nobody answers",
            "  d1: 0.00 Hz (0000H) -> 30.00 Hz (0BB8H): done",
            "  d2: unknown; silent",
        ]

    play([NC3, {**NC3, "number": 2}], scene)


def test_a_single_silent_drive_ends_it() -> None:
    """Before anything is written."""

    async def scene(hand: Hand) -> None:
        hand.fault(Kind.CUT)
        with pytest.raises(NoReply):
            await said(hand, wish("frequency_command=30.0"))

    play([NC3], scene)


@pytest.mark.hazard("H15")
@pytest.mark.parametrize("names", [("d1",), ("d1", "d2")])
def test_a_port_that_goes_never_leaves_a_write_without_a_word(names: tuple[str, ...]) -> None:
    """Whichever frame it goes at: 0 before anything was written, and after that every write has its line."""

    async def scene(hand: Hand) -> None:
        for place in range(30):
            gone_from(hand, place)
            lines: list[str] = []
            target = Target(hand.line, tuple(map(hand.drive, names)), is_group=len(names) > 1)
            try:
                is_good = await write(hand.session, target, wish("FA01=30.0", f"F880={place}"), lines.append, print)
            except LineDown:
                assert all(frame[1] in (0x03, 0x2B) for frame in hand.frames), "nothing but reads"
                assert not any("done" in line for line in lines)
                continue
            if is_good:
                assert place > 5
                return
            assert any("it may have been done (pulled out)" in line or "not written" in line for line in lines)
            if not any("free_notes" in line and "writing" in line for line in lines):
                assert lines[-1] == "not written any more: free_notes (0880)"
        raise AssertionError("the port was never there long enough")

    play([NC3, {**NC3, "number": 2}], scene)


def test_assignments_have_a_form() -> None:
    """A name, =, a value."""
    assert (assignment("a = 1 ").name, assignment("a = 1 ").value) == ("a", "1")
    for text in ("a", "=1", ""):
        with pytest.raises(NotUnderstood, match=r"give NAME=VALUE, such as frequency_command=30\.0"):
            assignment(text)


def test_the_words_of_a_plan_are_those_that_were_given() -> None:
    """Each assignment for every drive, in order."""

    async def scene(hand: Hand) -> None:
        planned = plan(hand.line.drives, wish("free_notes=1", "frequency_command=2"))
        assert [[(d.name, write.word) for d, write in writes] for writes in planned] == [
            [("d1", 1), ("d2", 1)],
            [("d1", 200), ("d2", 200)],
        ]

    play([NC3, {**NC3, "number": 2}], scene)
