from __future__ import annotations

from typing import Any

import pytest

from tests.sim.rig import Rig, binary

SELECTED = {f"block_read_{place}": place for place in range(1, 6)} | {"block_write_1": 1, "block_write_2": 3}
LED_MODE = {"block_mode": 1, "standard_monitor": 18}
DATA = "0064 0041 0074 0041 0000"  # "dAtA", as shipped


def drive(model: str = "vf-nc3", **options: Any) -> Rig:
    """Return a drive that is set to TOSHIBA."""
    return Rig(model, protocol="toshiba", **options)


def words(text: str) -> str:
    """Spell words as the rig spells bytes."""
    return bytes.fromhex(text).hex(" ").upper()


class TestForm:
    @pytest.mark.parametrize("groups", range(3))
    @pytest.mark.parametrize("count", range(6))
    def test_up_to_two_words_are_written_and_up_to_five_read(self, groups: int, count: int) -> None:
        """All eighteen combinations, each with its own length."""
        rig = drive(presets=SELECTED)
        values = ["4000", "0000", "0000", "0000", "0000"]
        answer = rig.tell_binary(f"58 {groups:02X} {count:02X}" + "".join(["C400", "1770"][:groups]))
        assert answer == words(f"59 {count:02X} 00 {''.join(values[:count])}")
        assert rig.word("command") == (0xC400 if groups > 0 else 0)
        assert rig.word("frequency_command") == (0x1770 if groups > 1 else 0)

    @pytest.mark.parametrize("groups", [3, 4, 5, 6, 128, 255])
    def test_more_than_two_words_to_write_get_no_answer(self, groups: int) -> None:
        """A format error, even with as many words behind it, whatever the checksum (4.1.3)."""
        rig = drive(presets=SELECTED)
        frame = binary(f"58 {groups:02X} 05" + "8400" * groups)
        assert rig.send(frame) is None
        assert rig.send(frame[:-1] + bytes([frame[-1] ^ 1])) is None
        assert rig.word("command") == 0

    @pytest.mark.parametrize("count", [6, 7, 128, 255])
    def test_more_than_five_words_to_read_are_answered_as_none(self, count: int) -> None:
        """The answer says 0 and carries no data; the write is done."""
        rig = drive(presets=SELECTED)
        assert rig.tell_binary(f"58 02 {count:02X} C400 1770") == "59 00 00"
        assert rig.word("command") == 0xC400

    def test_a_length_that_is_not_the_one_of_its_groups_gets_no_answer(self) -> None:
        """Two words said, one or three sent; and half a word."""
        rig = drive(presets=SELECTED)
        for data in ("C400", "C400 1770 0000", "C400 17", "C400 1770 00", ""):
            assert rig.tell_binary(f"58 02 05 {data}") is None
        assert rig.word("command") == 0


class TestWhatFailed:
    @pytest.mark.parametrize(
        ("presets", "status"),
        [
            ({}, "03"),
            ({"block_write_1": 1}, "02"),
            ({"block_write_2": 3}, "01"),
            ({"block_write_1": 1, "block_write_2": 3}, "00"),
        ],
    )
    def test_a_word_that_nothing_selects_has_failed(self, presets: dict[str, int], status: str) -> None:
        """The printed answer without selectors has both bits set; the other word is written all the same."""
        rig = drive(presets=presets)
        assert rig.tell_binary("58 02 00 8400 0BB8") == f"59 00 {status}"
        assert rig.word("command") == (0x8400 if "block_write_1" in presets else 0)
        assert rig.word("frequency_command") == (3000 if "block_write_2" in presets else 0)

    def test_only_words_that_were_sent_can_fail(self) -> None:
        """One word without a selector is bit 0, none is no bit."""
        assert drive().tell_binary("58 01 00 8400") == "59 00 01"
        assert drive().tell_binary("58 00 00") == "59 00 00"

    def test_a_word_out_of_range_fails_alone(self) -> None:
        """FA01 above FH: bit 1; the command in the same frame acts, unlike 10H of MODBUS-RTU."""
        rig = drive(presets=SELECTED)
        assert rig.tell_binary("58 02 00 8400 FFFF") == "59 00 02"
        assert (rig.word("command"), rig.word("frequency_command")) == (0x8400, 0)

    def test_one_register_in_both_places_is_written_twice(self) -> None:
        """The second word stays."""
        rig = drive(presets={"block_write_1": 3, "block_write_2": 3})
        assert rig.tell_binary("58 02 00 0064 00C8") == "59 00 00"
        assert rig.word("frequency_command") == 200

    def test_what_is_behind_a_fault_reset_in_the_frame_is_gone_with_it(self) -> None:
        """FA00 bit 13 in the first word: the second is not in RAM after the reset, nor is anything answered."""
        rig = drive(presets=SELECTED)
        assert rig.tell_binary("58 02 05 A000 0BB8") is None
        assert rig.word("frequency_command") == 0


class TestReading:
    def test_it_reads_what_stood_before_the_write(self) -> None:
        """A start is answered with a standing motor, the next frame with a running one."""
        rig = drive(presets=SELECTED)
        assert rig.tell_binary("58 02 02 C400 1770") == "59 02 00 40 00 00 00"
        assert rig.tell_binary("58 02 02 C400 1770") == "59 02 00 64 00 00 00"

    def test_a_deselected_word_reads_0000(self) -> None:
        """Dummy data."""
        rig = drive(running_at=60.0, presets={"block_read_2": 2})
        assert rig.tell_binary("58 00 03") == "59 03 00 00 00 17 70 00 00"

    def test_selectors_act_after_a_reset(self) -> None:
        """Until then the block is as it was."""
        rig = drive()
        rig.tell("W08750001")
        rig.tell("W08700003")
        assert rig.tell_binary("58 01 01 0064") == "59 01 01 00 00"
        rig.power_cycle()
        assert rig.tell_binary("58 01 01 0064") == "59 01 00 40 00"

    def test_it_writes_ram_only(self) -> None:
        """Nothing is worn, and nothing outlasts a reset."""
        rig = drive(presets=SELECTED | LED_MODE)
        rig.tell_binary("58 05 00 0030 0031 0032 0033 0003")
        assert rig.drive.inverter.memory.eeprom_writes == {}
        rig.power_cycle()
        assert rig.tell_binary("58 00 05") == words(f"59 05 00 {DATA}")

    def test_a_model_without_known_selectors_has_an_empty_block(self) -> None:
        """VF-AS3: both words fail, and zeros are read."""
        assert drive("vf-as3").tell_binary("58 02 05 8400 0064") == words(f"59 05 03 {'0000' * 5}")

    @pytest.mark.parametrize("model", ["vf-nc3", "vf-mb1"])
    def test_every_selector_reads_its_register(self, model: str) -> None:
        """Each selection gives the word that R gives."""
        rig = drive(model)
        for code, name in rig.drive.model.read_selectors.items():
            rig = drive(model, presets={"block_read_1": code}, seed=code)
            rig.drive.force(name or "output_frequency", 0x1234)
            assert rig.tell_binary("58 00 01") == ("59 01 00 12 34" if name else "59 01 00 00 00")


class TestDisplay:
    def test_up_to_five_words_are_written_and_the_display_before_is_read(self) -> None:
        """FA80 = 1: the selectors do not count, FA70-FA74 are written, and what was shown comes back."""
        rig = drive(presets=LED_MODE | SELECTED)
        assert rig.tell_binary("58 05 05 0030 0031 0032 0033 0003") == words(f"59 05 00 {DATA}")
        assert rig.tell_binary("58 02 05 0034 0035") == words("59 05 00 0030 0031 0032 0033 0003")
        assert rig.tell_binary("58 00 05") == words("59 05 00 0034 0035 0032 0033 0003")
        assert rig.word("command") == 0

    def test_more_than_five_words_get_no_answer(self) -> None:
        """The range of the writes is 0 to 5 (7.3.1)."""
        assert drive(presets=LED_MODE).tell_binary(f"58 06 05 {'0030' * 6}") is None

    def test_a_digit_out_of_range_is_not_shown_and_told_of_the_first_two(self) -> None:
        """FA70 and FA73 go to 7FH, FA71 and FA72 to FFH, FA74 to 3; the status goes from 00H to 03H (4.1.3)."""
        rig = drive(presets=LED_MODE)
        assert rig.tell_binary("58 05 00 0080 00FF 0100 0080 0004") == "59 00 01"
        assert rig.tell_binary("58 05 00 0030 0100 0031 0032 0004") == "59 00 02"
        assert rig.tell_binary("58 00 05") == words("59 05 00 0030 00FF 0031 0032 0000")

    @pytest.mark.parametrize(
        ("shown", "expected"),
        [
            ({"led_selection": 1}, DATA),
            ({"led_selection": 2, "led_unit_2": 3}, "0030 0030 0030 0030 0003"),
            ({"led_selection": 0}, "0020 0020 0020 0030 0000"),
            (
                {"led_selection": 0, "led_number": 600, "led_decimal_point": 1, "led_unit_0": 1},
                "0020 0036 00B0 0030 0001",
            ),
            ({"led_selection": 0, "led_number": 5, "led_decimal_point": 2}, "0020 00B0 0030 0035 0000"),
            ({"led_selection": 0, "led_number": 9999, "led_decimal_point": 2}, "0039 00B9 0039 0039 0000"),
        ],
    )
    def test_what_is_shown_goes_by_fa65(self, shown: dict[str, int], expected: str) -> None:
        """Number, first text or second text; a point is bit 7 of the digit before it."""
        rig = drive(presets=LED_MODE | shown)
        assert rig.tell_binary("58 00 05") == words(f"59 05 00 {expected}")

    def test_writes_go_to_the_first_text_whatever_is_shown(self) -> None:
        """FA65 = 2 shows the second text; FA70-FA74 are written all the same."""
        rig = drive(presets=LED_MODE | {"led_selection": 2})
        assert rig.tell_binary("58 01 05 0055") == words("59 05 00 0030 0030 0030 0030 0000")
        assert rig.word("led_text_1_digit_1") == 0x55
