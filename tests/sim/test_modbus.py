from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.sim.modbus import crc, is_whole
from tests.sim.rig import Rig, framed

READ_FIVE = {f"block_read_{place}": place for place in range(1, 6)}
BOTH_WRITES = {"block_write_1": 1, "block_write_2": 3}


class TestSilence:
    def test_another_number_gets_no_answer(self) -> None:
        """A request to number 2 is none of drive 1's business."""
        assert Rig().ask("03 FD00 0001", number=2) is None

    def test_the_number_that_is_set_answers(self) -> None:
        """Drive 7 answers to 7."""
        assert Rig(number=7).ask("03 FB07 0001", number=7) == "03 02 00 D0"

    def test_a_broadcast_is_obeyed_without_an_answer(self) -> None:
        """Number 0 writes on every drive, and nobody answers."""
        rig = Rig()
        assert rig.ask("06 FA01 0BB8", number=0) is None
        assert rig.read("frequency_command") == 3000

    def test_a_wrong_broadcast_gets_no_answer_either(self) -> None:
        """An error to number 0 is not reported."""
        assert Rig().ask("06 FFFF 0000", number=0) is None

    def test_numbers_above_247_get_no_answer(self) -> None:
        """248 to 255 are not for users."""
        assert Rig(number=255).ask("03 FD00 0001", number=255) is None

    def test_a_drive_without_a_number_hears_only_broadcasts(self) -> None:
        """F802 = 0 as shipped: number 0 is the broadcast, which is not answered."""
        assert Rig(number=0).ask("03 FD00 0001", number=0) is None


class TestErrors:
    @pytest.mark.parametrize("body", ["01 0000 0001", "04 FD00 0001", "05 FA00 FF00", "08 0000 0000", "2B 0D 01 00"])
    def test_an_unknown_function_is_error_01(self, body: str) -> None:
        """Functions that the manual does not list, and MEI types but 14, are refused with 01."""
        assert Rig().ask(body) == f"{int(body[:2], 16) | 0x80:02X} 01"

    def test_a_read_of_no_number_is_error_02(self) -> None:
        """0131H does not exist on VF-nC3."""
        assert Rig().ask("03 0131 0001") == "83 02"

    def test_a_direct_block_from_no_number_is_error_02(self) -> None:
        """The first number of a direct block must exist."""
        assert Rig().ask("03 0131 0002") == "83 02"

    def test_a_write_to_a_monitor_is_error_02(self) -> None:
        """Read-only numbers refuse as if they did not exist."""
        assert Rig().write("output_frequency", 0) == "86 02"

    @pytest.mark.parametrize("body", ["03 FD00 0000", "03 0800 0009", "03 1875 0001", "03 1879 0005", "2B 0E 04 00"])
    def test_a_count_or_code_out_of_range_is_error_03(self, body: str) -> None:
        """No words, nine words, one word from 1875H, a start behind it, and read code 4."""
        assert Rig().ask(body) == f"{int(body[:2], 16) | 0x80:02X} 03"

    def test_a_value_out_of_range_is_error_03(self) -> None:
        """F804 goes to 2, FA01 to FH = 80.00 Hz."""
        rig = Rig()
        assert rig.write("timeout_action", 3) == "86 03"
        assert rig.write("frequency_command", 8001) == "86 03"
        assert rig.write("frequency_command", 8000) == "06 FA 01 1F 40"

    def test_a_parameter_that_needs_standstill_is_error_04_while_running(self) -> None:
        """AU1 (0000) cannot be written while the motor turns."""
        rig = Rig(running_at=10.0)
        assert rig.write("automatic_acceleration", 1) == "86 04"
        rig.drive.inverter.run_by_panel(0)
        rig.wait(10)
        assert rig.write("automatic_acceleration", 1) == "06 00 00 00 01"

    def test_write_protection_is_error_04_for_parameters_only(self) -> None:
        """F700 = 2 inhibits parameters by RS485; commands still come through."""
        rig = Rig()
        rig.drive.set_by_panel("write_protection", 2)
        assert rig.write("communication_timeout", 10) == "86 04"
        assert rig.write("command", 0x8000) == "06 FA 00 80 00"

    def test_two_words_by_10h_are_only_for_the_block(self) -> None:
        """10H writes one word, or two at 1870H."""
        assert Rig().ask("10 FA00 0002 04 C400 1770") == "90 03"


class TestBlocks:
    def test_holes_of_a_direct_block_read_8000h(self) -> None:
        """0806H and 0807H do not exist on VF-nC3."""
        assert Rig().ask("03 0805 0004") == "03 08 00 00 80 00 80 00 00 01"

    def test_direct_blocks_of_monitors_can_be_allowed(self) -> None:
        """With the option FD00-FD01 come as a block, as some readings of the manual have it."""
        assert Rig(accepts_direct_blocks=True).ask("03 FD00 0002") == "03 04 00 00 40 00"

    def test_17h_reads_and_writes_in_one_frame(self) -> None:
        """The answer carries the values from before the write, as the manual's Y does for a standing motor."""
        rig = Rig(presets=READ_FIVE | BOTH_WRITES)
        assert rig.ask("17 1875 0002 1870 0002 04 C400 1770") == "17 04 40 00 00 00"
        assert rig.read("frequency_command") == 6000
        assert rig.read("status") == 0x6400

    @pytest.mark.parametrize(
        "body",
        [
            "17 1875 0001 1870 0002 04 C400 1770",
            "17 1875 0006 1870 0002 04 C400 1770",
            "17 1876 0002 1870 0002 04 C400 1770",
            "17 1875 0002 1871 0002 04 C400 1770",
            "17 1875 0002 1870 0001 04 C400 1770",
            "17 1875 0002 1870 0001 02 C400",
        ],
    )
    def test_17h_with_other_numbers_or_counts_is_error_03(self, body: str) -> None:
        """It has one form: 2 to 5 words from 1875H, two words to 1870H."""
        assert Rig(presets=READ_FIVE | BOTH_WRITES).ask(body) == "97 03"

    def test_17h_with_nothing_selected_is_error_04(self) -> None:
        """As for the block write: F870 = F871 = 0."""
        assert Rig().ask("17 1875 0002 1870 0002 04 C400 1770") == "97 04"

    def test_a_block_write_out_of_range_writes_nothing(self) -> None:
        """FA01 above FH refuses the command in the same frame too."""
        rig = Rig(presets=BOTH_WRITES)
        assert rig.ask("10 1870 0002 04 C400 FFFF") == "90 03"
        assert rig.read("command") == 0

    @pytest.mark.parametrize("body", ["10 1870 0002 04 A000 1770", "17 1875 0002 1870 0002 04 A000 1770"])
    def test_what_is_behind_a_fault_reset_in_the_frame_is_gone_with_it(self, body: str) -> None:
        """FA00 bit 13 in the first word: the second is not in RAM after the reset, nor is anything answered."""
        rig = Rig(presets=READ_FIVE | BOTH_WRITES)
        assert rig.ask(body) is None
        assert rig.word("frequency_command") == 0

    def test_led_mode_takes_the_block_for_the_display(self) -> None:
        """FA80 = 1: 1875H reads the text that stood there, 1870H sets its first two digits."""
        rig = Rig(presets=READ_FIVE | BOTH_WRITES)
        rig.write("block_mode", 1)
        assert rig.ask("17 1875 0005 1870 0002 04 0030 0031") == "17 0A 00 64 00 41 00 74 00 41 00 00"
        assert rig.ask("03 1875 0002") == "03 04 00 30 00 31"
        assert rig.read("command") == 0

    @pytest.mark.parametrize("code", range(4))
    def test_identification_answers_to_every_read_code(self, code: int) -> None:
        """Codes 0 to 3 bring all three objects."""
        answer = Rig().ask(f"2B 0E {code:02X} 00")
        assert answer is not None
        assert bytes.fromhex(answer)[1:7] == bytes([0x0E, code, 1, 0, 0, 3])


class TestAnyBytes:
    @given(st.binary(max_size=40))
    @settings(max_examples=500)
    def test_random_bytes_get_no_answer(self, data: bytes) -> None:
        """Nothing is answered unless CRC and number are right, and nothing raises."""
        answer = Rig().send(data)
        assert answer is None or (is_whole(data) and data[0] == 1)

    @given(st.integers(0, 255), st.binary(max_size=24))
    @settings(max_examples=1000)
    def test_any_request_with_a_right_check_is_answered_well_or_not_at_all(self, number: int, body: bytes) -> None:
        """The answer is whole, comes from the number asked, and has the function or its error."""
        data = bytes([number]) + body
        answer = Rig(number=5).send(data + crc(data))
        if answer is not None:
            assert number == 5
            assert is_whole(answer)
            assert answer[0] == 5
            assert answer[1] & 0x7F == body[0] & 0x7F
            assert len(answer) == 5 or answer[1] == body[0]

    @given(st.integers(0, 0xFFFF), st.integers(0, 0xFFFF))
    @settings(max_examples=500)
    def test_what_was_written_reads_back(self, address: int, word: int) -> None:
        """A write that is acknowledged is read back from the same number, and one refused changes nothing."""
        rig = Rig()
        before = rig.ask(f"03 {address:04X} 0001")
        answer = rig.ask(f"06 {address:04X} {word:04X}")
        if answer is None:  # a fault reset
            assert (address, word >> 13 & 1) == (0xFA00, 1)
        elif answer.startswith("06"):
            assert rig.ask(f"03 {address:04X} 0001") == f"03 02 {word >> 8:02X} {word & 255:02X}"
        elif before is not None and address < 0x1000:
            assert rig.ask(f"03 {address:04X} 0001") == before


def test_the_rig_frames_as_the_manual_does() -> None:
    """The test's own frames carry the printed check."""
    assert framed("03 FD00 0001") == bytes.fromhex("01 03 FD 00 00 01 B5 A6")
