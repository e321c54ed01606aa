from __future__ import annotations

import string
from typing import Any

import pytest

from tests.sim.rig import Rig, checked


def drive(number: int = 1, model: str = "vf-nc3", **options: Any) -> Rig:
    """Return a drive that is set to TOSHIBA."""
    return Rig(model, number=number, protocol="toshiba", **options)


class TestWhoAnswers:
    @pytest.mark.parametrize("number", [0, 7, 42, 99])
    def test_a_drive_answers_to_its_number_with_its_number(self, number: int) -> None:
        """Two decimal digits, 00 to 99."""
        assert drive(number).tell(f"{number:02d}RFB07") == f"{number:02d}RFB0700D0"

    def test_a_request_without_a_number_is_answered_without_one(self) -> None:
        """One-to-one communication: whoever hears it obeys, whatever its number."""
        for number in (0, 42, 99, 150):
            assert drive(number).tell("RFB07") == "RFB0700D0"

    def test_another_number_gets_no_answer(self) -> None:
        """The write is for number 2, and drive 1 does not do it either."""
        rig = drive()
        assert rig.tell("02PFA010064") is None
        assert rig.word("frequency_command") == 0

    @pytest.mark.parametrize("body", ["1RFB07", "*RFB07", "001RFB07", "A1RFB07", "1*2RFB07"])
    def test_a_number_of_other_than_two_digits_gets_no_answer(self, body: str) -> None:
        """A one-digit number is a format error (4.3)."""
        assert drive().tell(body) is None

    @pytest.mark.parametrize("number", [100, 101, 247])
    def test_a_drive_above_99_has_no_number_in_ascii(self, number: int) -> None:
        """Its two digits would be somebody else's, and groups go to 99."""
        rig = drive(number)
        for asked in (f"{number:03d}"[-2:], f"{number:03d}", "**"):
            assert rig.tell(f"{asked}PFA010064") is None
        assert rig.word("frequency_command") == 0

    @pytest.mark.parametrize("asked", ["**", "*0", "0*", "1*", "*1", "*9", "9*", "5*", "*5"])
    def test_a_group_obeys_and_its_smallest_number_answers(self, asked: str) -> None:
        """Of the hundred drives those with the digit obey; the one with 0 for the asterisk answers (4.4)."""
        obeyed, answers = [], {}
        for number in range(100):
            rig = drive(number)
            answer = rig.tell(f"{asked}PFA010064")
            if rig.word("frequency_command") == 100:
                obeyed.append(number)
            if answer is not None:
                answers[number] = answer
        tens, ones = list(asked)
        members = [n for n in range(100) if tens in ("*", f"{n:02d}"[0]) and ones in ("*", f"{n:02d}"[1])]
        assert obeyed == members
        assert answers == {members[0]: f"{members[0]:02d}PFA010064"}

    def test_a_group_read_is_answered_by_its_representative(self) -> None:
        """4.1.1 prints one, though 4.4 calls it invalid."""
        assert drive(2).tell("*2RFB07") == "02RFB0700D0"
        assert drive(12).tell("*2RFB07") is None

    def test_only_the_representative_refuses(self) -> None:
        """What a group cannot do is told once."""
        assert drive(0).tell("**WFFFF0000") == "00N0002"
        assert drive(5).tell("**WFFFF0000") is None

    def test_a_group_without_its_representative_is_silent_and_obeys(self) -> None:
        """Number 30 is not there, 31 is."""
        rig = drive(31)
        assert rig.tell("3*PFA010064") is None
        assert rig.word("frequency_command") == 100

    def test_the_number_acts_at_once(self) -> None:
        """The answer still comes from the old number, the next one from the new."""
        rig = drive()
        assert rig.tell("01W08020005") == "01W08020005"
        assert rig.tell("01RFB07") is None
        assert rig.tell("05RFB07") == "05RFB0700D0"


class TestForm:
    def test_the_answer_has_what_the_request_had(self) -> None:
        """Number, checksum and stop code, each there or not."""
        rig = drive()
        assert rig.send(b"(RFB07\r") == b"(RFB0700D0\r"
        assert rig.send(b"(RFB07)\r") == b"(RFB0700D0)\r"
        assert rig.send(b"(RFB07&8F\r") == b"(RFB0700D0&63\r"
        assert rig.send(checked("01RFB07")) == checked("01RFB0700D0")
        assert rig.send(checked("01LFB07")) == checked("01N0003")

    @pytest.mark.parametrize(("data", "word"), [("", 0), ("7", 7), ("12", 0x12), ("123", 0x123), ("0BB8", 0x0BB8)])
    def test_data_has_up_to_four_digits_and_comes_back_with_four(self, data: str, word: int) -> None:
        """(W123412) is answered (W12340012); no digits are a 0."""
        rig = drive()
        assert rig.tell(f"P0880{data}") == f"P0880{word:04X}"
        assert rig.word("free_notes") == word

    @pytest.mark.parametrize(
        "frame",
        [
            b"(R11)\r",  # the manual's example: 11) CR is taken for the number
            b"(R110)\r",
            b"(W110)\r",
            b"(RFB0)\r",
            b"(RFB07X\r",
            b"(RFB07X)\r",
            b"(RFB07]\r",
            b"(W08800001X\r",
            b"(RFB07))\r",
            b"(RFB070000)\r",  # a read has no data: the stop code's place is behind the number
        ],
    )
    def test_a_short_number_or_another_code_for_the_stop_code_gets_no_answer(self, frame: bytes) -> None:
        """Format errors 2 and 3 of 4.3."""
        assert drive().send(frame) is None

    @pytest.mark.parametrize(
        "frame",
        [
            b"",
            b"(",
            b"(\r",
            b"()\r",
            b"(R)\r",
            b"(01)\r",
            b"(RFB07)",
            b"(RFB07)\n",
            b"(RFB07)\r\r",
            b"(RFB07)\r\n",
            b"RFB07)\r",
            b"((RFB07)\r",
            b" (RFB07)\r",
            b"(RFB07 )\r",
            b"(RFB07)\r(RFB07)\r",
            b"(RFB07&)\r",
            b"(RFB07&5)\r",
            b"(RFB07&057)\r",
            b"(RFB0757)\r",
            b"(RFB07)&57\r",
            b"(0 RFB07)\r",
            b"(-1RFB07)\r",
            b"(?FB07)\r",
            b"(\xd2FB07)\r",
        ],
    )
    def test_a_malformed_frame_gets_no_answer(self, frame: bytes) -> None:
        """CR missing or early, no start code, two frames in one, a checksum without its two digits or its "&"."""
        assert drive().send(frame) is None

    @pytest.mark.parametrize("body", ["Rfb07", "RFb07", "PFA010bb8", "R0000&6e"])
    def test_hexadecimal_digits_are_in_upper_case(self, body: str) -> None:
        """The manual prints no other, and its small letters mean something else."""
        rig = drive()
        assert rig.tell(body) is None
        assert rig.word("frequency_command") == 0


class TestErrors:
    @pytest.mark.parametrize("command", sorted(set(string.ascii_letters) - set("RWP")))
    def test_every_other_letter_is_error_0003(self, command: str) -> None:
        """Also G, S and X, which binary has, and r, w, p."""
        rig = drive(model="vf-mb1")
        assert rig.tell(f"{command}FA01") == "N0003"
        assert rig.tell(f"{command}FA010064") == "N0003"
        assert rig.word("frequency_command") == 0

    @pytest.mark.parametrize("body", ["R0131", "RFFFF", "W01310000", "P01310000"])
    def test_a_number_that_is_not_there_is_error_0002(self, body: str) -> None:
        """0131H does not exist on VF-nC3."""
        assert drive().tell(body) == "N0002"

    @pytest.mark.parametrize("letter", ["W", "P"])
    def test_a_write_to_a_monitor_is_error_0002(self, letter: str) -> None:
        """Read-only numbers refuse as if they did not exist."""
        assert drive().tell(f"{letter}FD000000") == "N0002"

    @pytest.mark.parametrize("letter", ["W", "P"])
    def test_a_value_out_of_range_is_error_0001(self, letter: str) -> None:
        """F804 goes to 2, FA01 to FH = 80.00 Hz."""
        rig = drive()
        assert rig.tell(f"{letter}08040003") == "N0001"
        assert rig.tell(f"{letter}FA011F41") == "N0001"
        assert rig.tell(f"{letter}FA011F40") == f"{letter}FA011F40"

    @pytest.mark.parametrize("data", ["00064", "000000064", "0" * 1000])
    def test_too_many_digits_are_error_0001(self, data: str) -> None:
        """Five and more, whatever they stand for."""
        rig = drive()
        assert rig.tell(f"P0880{data}") == "N0001"
        assert rig.word("free_notes") == 0

    @pytest.mark.parametrize("letter", ["W", "P"])
    def test_what_needs_standstill_is_error_0000_while_running(self, letter: str) -> None:
        """AU1 (0000) of VF-nC3."""
        assert drive(running_at=10.0).tell(f"{letter}00000001") == "N0000"
        assert drive().tell(f"{letter}00000001") == f"{letter}00000001"

    def test_write_protection_is_error_0000_for_parameters_only(self) -> None:
        """F700 = 2 inhibits parameters by RS485; commands still come through, and reads."""
        rig = drive(presets={"write_protection": 2})
        assert rig.tell("W08800001") == "N0000"
        assert rig.tell("R0880") == "R08800000"
        assert rig.tell("PFA008000") == "PFA008000"

    def test_read_protection_of_vf_mb1_is_error_0000_for_parameters_only(self) -> None:
        """F700 = 4 inhibits reading as well (VF-MB1 RS485 4.3); the other model's manual has no such code."""
        rig = drive(model="vf-mb1", presets={"write_protection": 4})
        assert rig.tell("W08800001") == "N0000"
        assert rig.tell("R0880") == "N0000"
        assert rig.tell("RFD00") == "RFD000000"
        assert drive(presets={"write_protection": 4}).tell("W08800001") == "W08800001"

    def test_a_password_that_is_set_is_not_overwritten(self) -> None:
        """F738 with a value in it refuses another with 0000 (4.3)."""
        assert drive(presets={"password": 1234}).tell("W07380000") == "N0000"

    def test_a_wrong_checksum_is_error_0004_and_nothing_is_done(self) -> None:
        """Before command, number and data are looked at, but not for a frame to another drive."""
        rig = drive()
        right = checked("01PFA010064")
        assert rig.send(right[:-4] + b"00)\r") == checked("01N0004")
        assert rig.send(b"(L0000&00)\r") == checked("N0004")
        assert rig.send(b"(02PFA010064&00)\r") is None
        assert rig.send(b"(**PFA010064&00)\r") is None
        assert rig.word("frequency_command") == 0
        assert rig.send(right) == right

    @pytest.mark.parametrize("body", ["L0000", "R0131", "W08040003", "W0880000000"])
    def test_an_error_of_a_tripped_drive_has_a_small_letter(self, body: str) -> None:
        """N becomes n."""
        rig = drive()
        rig.drive.inverter.trip(0x18)
        answer = rig.tell(body)
        assert answer is not None
        assert answer.startswith("n000")


class TestWriting:
    def test_w_is_kept_and_p_is_not(self) -> None:
        """After a reset the EEPROM's word is back; only W wears it."""
        rig = drive()
        assert rig.tell("W08800007") == "W08800007"
        assert rig.tell("P08800009") == "P08800009"
        assert rig.tell("R0880") == "R08800009"
        rig.power_cycle()
        assert rig.tell("R0880") == "R08800007"
        assert rig.drive.inverter.memory.eeprom_writes == {0x0880: 1}

    def test_w_to_a_register_without_a_place_in_the_eeprom_is_ram_only(self) -> None:
        """FA01 by W wears nothing, and is gone after a reset."""
        rig = drive()
        assert rig.tell("WFA010064") == "WFA010064"
        rig.power_cycle()
        assert rig.tell("RFA01") == "RFA010000"
        assert rig.drive.inverter.memory.eeprom_writes == {}

    def test_only_w_takes_the_time_of_the_eeprom(self) -> None:
        """50 ms at most; P is as quick as a read."""
        rig = drive()
        rig.tell("W08800001")
        assert rig.delay == 0.050
        rig.tell("P08800001")
        assert rig.delay == 0.005

    def test_a_selector_by_p_never_acts(self) -> None:
        """F875-F879 act after a reset, and a reset brings the EEPROM's word back."""
        rig = drive()
        assert rig.tell("P08750001") == "P08750001"
        assert rig.tell_binary("58 00 01") == "59 01 00 00 00"
        rig.power_cycle()
        assert rig.tell_binary("58 00 01") == "59 01 00 00 00"
        assert rig.tell("R0875") == "R08750000"

    def test_a_fault_reset_is_not_answered_and_leaves_the_drive_deaf_and_empty(self) -> None:
        """A second of silence; RAM is gone, and FA87 = 0 tells of it (7.1)."""
        rig = drive()
        rig.tell("PFA870001")
        rig.tell("P08030064")
        rig.tell("PFA009000")
        assert rig.tell("RFC90") == "rFC900011"
        assert rig.tell("PFA00A000") is None
        rig.wait(0.9)
        assert rig.tell("RFC90") is None
        rig.wait(0.2)
        assert rig.tell("RFC90") == "RFC900000"
        assert [rig.tell(f"R{name}") for name in ("FA87", "0803", "FA00")] == ["RFA870000", "R08030000", "RFA000000"]

    def test_the_motor_runs_by_it(self) -> None:
        """60 Hz and forward run, as in the examples of 4.5."""
        rig = drive()
        rig.tell("PFA011770")
        rig.tell("PFA00C400")
        rig.wait(10)
        assert rig.tell("RFD00") == "RFD001770"
        assert rig.tell("RFD01") == "RFD016400"
