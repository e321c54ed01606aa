"""The proportional command on simulated VF-MB1: who is reached, and what each makes of it."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest

from gateway.commissioning import proportional
from gateway.commissioning.proportional import Followed, told
from gateway.control.writes import BadCommand, Verdict, Why
from gateway.drives.scaling import OutOfRange
from gateway.errors import BadConfig, NoReply
from gateway.sim.faults import Kind
from tests.bus.hand import Hand, gone_from, play

BINARY = "toshiba-binary"


def mb1(number: int, top: int = 6000, *, points: int = 1, **more: Any) -> dict[str, Any]:
    """Return a VF-MB1 whose second point is `top` (in 0.01 Hz) at 100 %."""
    registers = {"frequency_points": points, "point_2_frequency": top}
    return {"number": number, "model": "vf-mb1", "protocol": BINARY, "registers": registers, **more}


async def command(hand: Hand, names: list[str], percent: str, maximum: Decimal | None = None) -> list[Followed]:
    """Give the command to some drives."""
    drives, share = [hand.drive(name) for name in names], Decimal(percent)
    frames = proportional.plan(drives, hand.line.drives, share)
    expected = await proportional.expectations(hand.session, drives, share, maximum)
    return list(await proportional.command(hand.session, drives, frames, expected))


def test_one_frame_and_each_drive_follows_by_its_own_points() -> None:
    """The example of VF-MB1 6.1: 50 % is 45 Hz for one and 40 Hz for the other."""

    async def scene(hand: Hand) -> None:
        followed = await command(hand, ["d1", "d2"], "50")
        assert [item.new for item in followed] == [Decimal("45.00"), Decimal("40.00")]
        assert [item.verdict for item in followed] == [Verdict.DONE, Verdict.DONE]
        assert told(followed[0]) == "d1: 0.00 Hz -> 45.00 Hz (expected 45.00 Hz): done"
        assert [frame for frame in hand.frames if b"S" in frame] == [bytes.fromhex("2FFF53FA01138817")]
        assert hand.word(1, "frequency_command") == 4500

    play([mb1(1, 9000), mb1(2, 8000)], scene)


def test_some_of_the_drives_are_addressed_one_by_one() -> None:
    """FFH would reach the third."""

    async def scene(hand: Hand) -> None:
        followed = await command(hand, ["d1", "d2"], "50")
        assert all(item.verdict is Verdict.DONE for item in followed)
        assert hand.word(3, "frequency_command") == 0

    play([mb1(1), mb1(2), mb1(3)], scene)


def test_by_fh_where_the_points_are_off() -> None:
    """Worked out where FH is given; otherwise told as it reads."""

    async def scene(hand: Hand) -> None:
        (known,) = await command(hand, ["d1"], "50", Decimal(80))
        assert (known.new, known.expected, known.verdict) == (Decimal("40.00"), Decimal("40.00"), Verdict.DONE)
        (unknown,) = await command(hand, ["d1"], "25")
        assert (unknown.new, unknown.expected, unknown.verdict) == (Decimal("20.00"), None, None)
        assert told(unknown).endswith("or F811-F814 tell nothing): sent")

    play([mb1(1, points=0)], scene)


def test_a_drive_that_did_not_hear_it_is_told() -> None:
    """Nobody answers S: only reading back tells."""

    async def scene(hand: Hand) -> None:
        drives = [hand.drive("d1"), hand.drive("d2")]
        ((_, request),) = proportional.plan(drives, hand.line.drives, Decimal(50))
        hand.fault_at(request, "d1", Kind.CUT, drive=2)
        first, second = await command(hand, ["d1", "d2"], "50")
        assert (first.verdict, second.verdict, second.new) == (Verdict.DONE, Verdict.UNKNOWN, None)

    play([mb1(1), mb1(2)], scene)


@pytest.mark.hazard("H31")
def test_what_would_be_beyond_fh_is_not_sent() -> None:
    """The drives check nothing (VF-MB1 4.2)."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(BadCommand, match=r"d1: that is 90\.00 Hz, beyond FH, 80 Hz"):
            await command(hand, ["d1"], "100", Decimal(80))
        assert not [frame for frame in hand.frames if b"S" in frame]
        with pytest.raises(OutOfRange):
            await command(hand, ["d1"], "100.01")

    play([mb1(1, 9000)], scene)


@pytest.mark.hazard("H31")
def test_a_frequency_that_no_drive_has_is_not_sent() -> None:
    """Points that stand close together lead to hundreds of hertz."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(BadCommand, match=r"d1: F810-F814 make 600\.00 Hz of that, beyond 500 Hz: put them right"):
            await command(hand, ["d1"], "100")
        assert not [frame for frame in hand.frames if b"S" in frame]

    steep = mb1(1)
    steep["registers"] = {"frequency_points": 1, "point_2_setting": 10, "point_2_frequency": 6000}
    play([steep], scene)


def test_a_silent_only_drive_ends_it_and_one_of_several_does_not() -> None:
    """Before anything is sent."""

    async def scene(hand: Hand) -> None:
        hand.fault(Kind.CUT, 1)
        with pytest.raises(NoReply):
            await command(hand, ["d1"], "50")
        assert not [frame for frame in hand.frames if b"S" in frame]
        first, second = await command(hand, ["d1", "d2"], "50")
        assert (first.verdict, second.verdict) == (Verdict.UNKNOWN, Verdict.DONE)

    play([mb1(1), mb1(2)], scene)


def test_a_drive_of_which_nothing_is_known_and_nothing_moved_is_unknown() -> None:
    """It may not have heard it; once it moved, it has."""

    async def scene(hand: Hand) -> None:
        (moved,) = await command(hand, ["d1"], "50")
        (still,) = await command(hand, ["d1"], "50")
        assert (moved.verdict, still.verdict) == (None, Verdict.UNKNOWN)

    play([mb1(1, points=0)], scene)


@pytest.mark.hazard("H15")
def test_a_port_that_goes_leaves_what_was_sent_unknown_and_the_rest_not_written() -> None:
    """Two of three drives, addressed one by one."""

    async def scene(hand: Hand) -> None:
        drives, share = [hand.drive("d1"), hand.drive("d2")], Decimal(50)
        frames = proportional.plan(drives, hand.line.drives, share)
        expected = await proportional.expectations(hand.session, drives, share, None)
        for place, verdicts in ((2, [Verdict.UNKNOWN, Verdict.NOT_WRITTEN]), (4, [Verdict.UNKNOWN] * 2)):
            gone_from(hand, place)
            followed = await proportional.command(hand.session, drives, frames, expected)
            assert [item.verdict for item in followed] == verdicts

    play([mb1(1), mb1(2), mb1(3)], scene)


def test_fh_is_a_frequency() -> None:
    """Not infinite, nor nothing."""
    assert proportional.maximum_of("80.5") == Decimal("80.5")
    for text in ("nan", "inf", "0", "-10", "x", "500.01", "\u0665"):
        with pytest.raises(BadConfig, match=r"--fh .*: give FH in Hz, above 0 and up to 500"):
            proportional.maximum_of(text)


@pytest.mark.parametrize(
    ("drive", "said"),
    [
        ({"number": 1, "model": "vf-mb1"}, "d1: MODBUS-RTU has no proportional command"),
        ({"number": 1, "model": "vf-nc3", "protocol": BINARY}, "d1: vf-nc3 is not known to have the proportional"),
        ({"number": 70, "model": "vf-mb1", "protocol": "toshiba-ascii"}, "d70: toshiba-binary: .*inverter number"),
    ],
)
def test_who_does_not_take_it_is_told_before_anything_is_sent(drive: dict[str, Any], said: str) -> None:
    """Protocol, model, number."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(BadCommand, match=said) as caught:
            proportional.plan(hand.line.drives, hand.line.drives, Decimal(50))
        assert caught.value.why is Why.NO_FORM
        assert hand.frames == []

    play([drive], scene)
