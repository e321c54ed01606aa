"""Texts and numbers on a simulated drive's panel: how they get there, and what is put back afterwards."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from gateway.commissioning import display
from gateway.control.writes import NOTHING, Allowed, BadCommand, Verdict, Why
from gateway.drives import panel
from gateway.drives.panel import CannotShow
from gateway.errors import GatewayError, Refusal, Refused
from gateway.protocol.pdu import Exchange, WriteRam
from gateway.sim.faults import Kind
from tests.bus.hand import Hand, play

STORED = Allowed(stored=True)
ASCII, BINARY, MODBUS = "toshiba-ascii", "toshiba-binary", "modbus-rtu"
BLOCK_MODE, SELECTION = 0xFA80, 0xFA65
WORDS = (0x20, 0x36, 0xB0, 0x30, 1)  # " 60.0", Hz
X = Exchange(1, 0x1875, 5, 0x1870, WORDS)


def drive(protocol: str, **registers: int) -> list[dict[str, Any]]:
    """Return a drive that shows what it is sent (F710 = 18)."""
    settings = {"standard_monitor": 18, **registers}
    return [{"number": 1, "model": "vf-nc3", "protocol": protocol, "registers": settings}]


def shown(hand: Hand) -> str:
    """Return the text that the simulated panel shows, by FA65."""
    which = hand.word(1, "led_selection")
    return panel.text_of([hand.word(1, f"led_text_{which}_digit_{place}") for place in (1, 2, 3, 4)])


async def show(hand: Hand, text: str = "60.0", unit: int = 1, allowed: Allowed = NOTHING) -> display.Shown:
    """Show a text on the only drive."""
    only = hand.drive("d1")
    return await display.show_text(hand.session, only, display.text_words(only, text, unit), allowed)


def test_a_text_goes_in_one_frame_and_the_block_is_given_back() -> None:
    """X with FA80 = 1, all in RAM; what was shown before is told."""

    async def scene(hand: Hand) -> None:
        done = await show(hand)
        assert done.is_good
        assert done.notes == ("shown before: 'dAtA'",)
        assert shown(hand) == " 60.0"
        assert hand.word(1, "led_unit_1") == 1
        assert hand.sent(X, "d1") == 1
        assert hand.word(1, "block_mode") == 0
        assert not hand.wear(1)

    play(drive(BINARY), scene)


def test_the_panel_is_switched_to_the_text_last() -> None:
    """It showed a number until then."""

    async def scene(hand: Hand) -> None:
        assert (await show(hand)).is_good
        assert shown(hand) == " 60.0"
        order = [frame for frame in hand.frames if frame[2:3] in (b"X", b"P")]
        assert order[-1] == hand.drive("d1").codec.encode(WriteRam(1, SELECTION, 1))

    play(drive(BINARY, led_selection=0), scene)


@pytest.mark.parametrize("protocol", [ASCII, BINARY])
def test_a_block_mode_that_was_left_behind_is_set_to_0(protocol: str) -> None:
    """By a display that was killed; it is said."""

    async def scene(hand: Hand) -> None:
        done = await show(hand)
        assert done.is_good
        assert any(note.startswith("block_mode (FA80) was 1, left behind") for note in done.notes)
        assert hand.word(1, "block_mode") == 0
        assert not any("left behind" in note for note in (await show(hand)).notes)

    play(drive(protocol, block_mode=1), scene)


def test_a_number_gives_a_block_back_too() -> None:
    """Whoever displays next ends what was left behind."""

    async def scene(hand: Hand) -> None:
        done = await display.show_number(hand.session, hand.drive("d1"), panel.number_of("12.3"), 2, NOTHING)
        assert any("left behind" in note for note in done.notes)
        assert hand.word(1, "block_mode") == 0

    play(drive(BINARY, block_mode=1), scene)


def test_the_block_is_given_back_however_often_and_whenever_it_is_broken_off() -> None:
    """Cancelled with every frame from FA80 = 1 on, again and again while it is given back."""

    async def scene(hand: Hand) -> None:
        for place in range(1, 30):
            hand.frames.clear()
            task = asyncio.create_task(show(hand))
            while len(hand.frames) < place and not task.done():
                await asyncio.sleep(0.001)
            while not task.done():
                task.cancel()
                await asyncio.sleep(0.002)
            assert hand.word(1, "block_mode") == 0, place
            if not task.cancelled():
                assert task.result().is_good
                return
        raise AssertionError("it never came to its end")

    play(drive(BINARY), scene)


@pytest.mark.parametrize("kind", [Kind.DROP, Kind.CUT])
def test_the_block_is_given_back_after_a_lost_frame(kind: Kind) -> None:
    """Reading back says whether the text is there all the same."""

    async def scene(hand: Hand) -> None:
        hand.fault_at(X, "d1", kind, count=1)
        done = await show(hand)
        assert done.is_good is (kind is Kind.DROP)
        assert done.notes[0].startswith("the block was not acknowledged")
        assert hand.word(1, "block_mode") == 0

    play(drive(BINARY), scene)


def test_the_block_is_given_back_after_a_refusal() -> None:
    """The refusal itself is told; N with error 0003 here, made of the drive's answer."""

    async def scene(hand: Hand) -> None:
        only = hand.drive("d1")
        send = hand.session.send

        async def refusing(codec: Any, request: Any, processing: float) -> Any:
            if isinstance(request, Exchange):
                raise Refused("number 1: error 0003", Refusal.COMMAND)
            return await send(codec, request, processing)

        hand.session.send = refusing  # type: ignore[method-assign]
        with pytest.raises(Refused):
            await display.show_text(hand.session, only, WORDS, NOTHING)
        assert hand.word(1, "block_mode") == 0

    play(drive(BINARY), scene)


def test_the_block_is_given_back_when_the_command_is_broken_off() -> None:
    """Ctrl-C while the frame is on the line."""

    async def scene(hand: Hand) -> None:
        hand.fault_at(X, "d1", Kind.CUT, count=1)
        task = asyncio.create_task(show(hand))
        while not hand.sent(X, "d1"):
            await asyncio.sleep(0.001)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert hand.word(1, "block_mode") == 0

    play(drive(BINARY), scene)


def test_a_block_that_could_not_be_given_back_is_told() -> None:
    """The drive falls silent; it is tried three times."""

    async def scene(hand: Hand) -> None:
        hand.fault_at(X, "d1", Kind.CUT)
        with pytest.raises(GatewayError, match=r"block_mode \(FA80\) could not be set back to 0 .*no answer"):
            await show(hand)

    play(drive(BINARY), scene)


def test_without_the_block_the_text_is_put_where_it_is_not_shown_and_switched_to() -> None:
    """ASCII: text 2 while text 1 is shown, then the other way round; FA65 comes last."""

    async def scene(hand: Hand) -> None:
        assert (await show(hand)).is_good
        assert (hand.word(1, "led_selection"), shown(hand)) == (2, " 60.0")
        assert panel.text_of([hand.word(1, f"led_text_1_digit_{place}") for place in (1, 2, 3, 4)]) == "dAtA"
        assert (await show(hand, "Ab")).is_good
        assert (hand.word(1, "led_selection"), shown(hand)) == (1, "  Ab")
        assert not hand.wear(1)

    play(drive(ASCII), scene)


@pytest.mark.hazard("H08")
def test_modbus_shows_nothing_without_leave_to_wear_the_eeprom() -> None:
    """With it, only digits that differ are written, in the place that is shown."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(BadCommand) as caught:
            await show(hand, "dAb")
        assert caught.value.why is Why.STORED
        assert hand.frames == []
        done = await show(hand, "dAtb", 0, STORED)
        assert done.is_good
        assert dict(hand.wear(1)) == {0xFA73: 1}
        assert done.used == "one by one, led_selection (FA65) last: 06H, RAM and EEPROM: wears it"

    play(drive(MODBUS), scene)


@pytest.mark.parametrize("protocol", [ASCII, BINARY])
def test_a_number_has_its_digits_its_point_and_its_unit(protocol: str) -> None:
    """FA66-FA68, then FA65 = 0."""

    async def scene(hand: Hand) -> None:
        done = await display.show_number(hand.session, hand.drive("d1"), panel.number_of("12.3"), 2, NOTHING)
        assert done.is_good
        names = ("led_number", "led_decimal_point", "led_unit_0", "led_selection")
        assert [hand.word(1, name) for name in names] == [123, 1, 2, 0]
        assert [outcome.write.register.name for outcome in done.outcomes] == list(names)

    play(drive(protocol), scene)


def test_a_drive_that_refuses_is_left_at_the_first_refusal() -> None:
    """FA65 is not switched to half a number."""

    async def scene(hand: Hand) -> None:
        wrong = panel.Number(12345, 0)
        with pytest.raises(BadCommand, match="outside 0 to 9999"):
            await display.show_number(hand.session, hand.drive("d1"), wrong, 0, NOTHING)
        hand.fault_at(WriteRam(1, 0xFA67, 1), "d1", Kind.CUT, count=1)
        done = await display.show_number(hand.session, hand.drive("d1"), panel.number_of("12.3"), 0, NOTHING)
        assert [outcome.verdict for outcome in done.outcomes] == [Verdict.DONE, Verdict.NOT_DONE]
        assert hand.word(1, "led_selection") == 1

    play(drive(ASCII), scene)


def test_a_panel_that_is_set_to_show_something_else_is_told_of() -> None:
    """F710 is not written: that is for whoever set it."""

    async def scene(hand: Hand) -> None:
        done = await show(hand)
        assert done.notes[-1] == "the panel shows it only while standard_monitor (0710) is 18; it is 0"

    play(drive(BINARY, standard_monitor=0), scene)


def test_what_this_drive_cannot_show_is_refused_before_anything_is_sent() -> None:
    """By the ranges that the catalogue has for the digits."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(CannotShow, match="digit 1 has no dot"):
            display.text_words(hand.drive("d1"), "1.234", 0)
        assert hand.frames == []

    play(drive(BINARY), scene)


def test_a_model_without_display_registers_says_so() -> None:
    """The VF-AS3 of the catalogue."""

    async def scene(hand: Hand) -> None:
        with pytest.raises(BadCommand, match="vf-as3: the catalogue knows no led_text_1_digit_1"):
            display.text_words(hand.drive("d1"), "1", 0)

    play([{"number": 1, "model": "vf-as3"}], scene)
