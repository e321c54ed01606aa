from __future__ import annotations

from typing import Any

import pytest

from tests.sim.rig import Rig, binary

ONE_BYTE = range(256)
KNOWN = {ord(letter) for letter in "RWPGXSs"}
NUMBERS = {*range(0x40), 0xFF}


def drive(number: int = 1, model: str = "vf-nc3", **options: Any) -> Rig:
    """Return a drive that is set to TOSHIBA."""
    return Rig(model, number=number, protocol="toshiba", **options)


class TestWhoAnswers:
    @pytest.mark.parametrize("number", [0, 1, 40, 47, 63])
    def test_a_drive_answers_to_its_number_with_its_number(self, number: int) -> None:
        """One byte, 00H to 3FH; the start codes' own values too."""
        assert drive(number).tell_binary(f"{number:02X} 52 FB07") == f"{number:02X} 52 FB 07 00 D0"

    def test_a_request_without_a_number_is_answered_without_one(self) -> None:
        """Whoever hears it obeys, whatever its number."""
        for number in (0, 63, 64, 150):
            assert drive(number).tell_binary("52 FB07") == "52 FB 07 00 D0"

    def test_another_number_gets_no_answer(self) -> None:
        """The write is for number 2, and drive 1 does not do it either."""
        rig = drive()
        assert rig.tell_binary("02 50 FA01 0064") is None
        assert rig.word("frequency_command") == 0

    @pytest.mark.parametrize("number", [64, 82, 99, 247])
    def test_a_drive_above_63_has_no_number_in_binary(self, number: int) -> None:
        """Not even where its number is the code of a command (82 is R), and FFH is not for it."""
        rig = drive(number)
        assert rig.tell_binary(f"{number:02X} 50 FA01 0064") is None
        assert rig.tell_binary("FF 50 FA01 0064") is None
        assert rig.word("frequency_command") == 0

    def test_ffh_is_obeyed_by_all_and_answered_by_number_00(self) -> None:
        """The answer carries 00, not FFH."""
        for number in range(64):
            rig = drive(number)
            answer = rig.tell_binary("FF 50 FA01 0064")
            assert answer == ("00 50 FA 01 00 64" if number == 0 else None)
            assert rig.word("frequency_command") == 100

    def test_ffh_reads_and_refusals_are_answered_by_number_00_only(self) -> None:
        """Data or an error code from one drive at most."""
        assert drive(0).tell_binary("FF 52 FB07") == "00 52 FB 07 00 D0"
        assert drive(0).tell_binary("FF 57 FFFF 0000") == "00 4E 00 02"
        assert drive(0).tell_binary("FF 58 00 01") == "00 59 01 00 00 00"
        for body in ("FF 52 FB07", "FF 57 FFFF 0000", "FF 58 00 01"):
            assert drive(1).tell_binary(body) is None

    def test_the_number_acts_at_once(self) -> None:
        """The answer still comes from the old number, the next one from the new."""
        rig = drive()
        assert rig.tell_binary("01 50 0802 0005") == "01 50 08 02 00 05"
        assert rig.tell_binary("01 52 FB07") is None
        assert rig.tell_binary("05 52 FB07") == "05 52 FB 07 00 D0"


class TestSilence:
    @pytest.mark.parametrize("length", range(12))
    def test_an_unknown_command_gets_no_answer(self, length: int) -> None:
        """Whatever its length, with and without a number; r, w, p, g too."""
        rig = drive(model="vf-mb1")
        for command in sorted(set(ONE_BYTE) - KNOWN):
            body = f"{command:02X}" + "00" * length
            assert rig.tell_binary(f"01 {body}") is None
            if command not in NUMBERS:
                assert rig.tell_binary(body) is None

    @pytest.mark.parametrize(("command", "size"), [("52", 2), ("57", 4), ("50", 4), ("47", 4)])
    def test_a_wrong_length_gets_no_answer(self, command: str, size: int) -> None:
        """R has two bytes behind it, the others four, and the checksum; no more and no less."""
        rig = drive()
        data = "08800000" + "00" * 8
        for length in range(12):
            for number in ("", "01"):
                answer = rig.tell_binary(number + command + data[: 2 * length])
                assert (answer is not None) == (length == size)

    @pytest.mark.parametrize(
        "frame", [b"/", b"//", b"/R", b"", b"\x2f\x01", b"RFB07\x00", b"\x00" + binary("52 FB07")]
    )
    def test_what_is_no_frame_gets_no_answer(self, frame: bytes) -> None:
        """Nothing but a start code, none of it, or noise before it."""
        assert drive().send(frame) is None

    def test_two_frames_in_one_get_no_answer(self) -> None:
        """Without 3.5 characters between them they are one, and a wrong one."""
        assert drive().send(2 * binary("52 FB07")) is None


class TestErrors:
    @pytest.mark.parametrize(
        ("body", "code"),
        [
            ("52 0131", "02"),
            ("47 0131 0000", "02"),
            ("57 0131 0000", "02"),
            ("50 FD00 0000", "02"),
            ("57 0804 0003", "01"),
            ("50 FA01 1F41", "01"),
        ],
    )
    def test_refusals_have_the_manual_s_codes(self, body: str, code: str) -> None:
        """02: absent or read-only; 01: out of range."""
        assert drive().tell_binary(body) == f"4E 00 {code}"
        assert drive().tell_binary(f"01 {body}") == f"01 4E 00 {code}"

    def test_what_is_impossible_now_is_code_00(self) -> None:
        """AU1 of VF-nC3 while it runs; any parameter while F700 = 2."""
        assert drive(running_at=10.0).tell_binary("57 0000 0001") == "4E 00 00"
        assert drive(presets={"write_protection": 2}).tell_binary("57 0880 0001") == "4E 00 00"

    @pytest.mark.parametrize("body", ["52 FB07", "47 FB07 0000", "50 FA01 0064", "57 0880 0001", "58 00 05"])
    def test_every_wrong_checksum_is_code_04_and_nothing_is_done(self, body: str) -> None:
        """For R, G, P, W and X; another drive's frame is another drive's."""
        rig = drive()
        frame = binary(body)
        for wrong in set(ONE_BYTE) - {frame[-1]}:
            assert rig.send(frame[:-1] + bytes([wrong])) == binary("4E 00 04")
        other = binary(f"02 {body}")
        assert rig.send(other[:-1] + bytes([other[-1] ^ 1])) is None
        everybody = binary(f"FF {body}")
        assert rig.send(everybody[:-1] + bytes([everybody[-1] ^ 1])) is None
        assert (rig.word("frequency_command"), rig.word("free_notes")) == (0, 0)

    def test_a_tripped_drive_answers_in_lower_case(self) -> None:
        """r, g, p, w, y and n."""
        rig = drive()
        rig.drive.inverter.trip(0x18)
        bodies = ("52 FB07", "47 FB07 0000", "50 FA01 0064", "57 0880 0001", "58 00 00", "52 0131")
        answers = [rig.tell_binary(body) for body in bodies]
        assert [bytes.fromhex(answer)[:1] for answer in answers if answer] == [b"r", b"g", b"p", b"w", b"y", b"n"]


class TestWriting:
    def test_w_is_kept_and_p_is_not(self) -> None:
        """After a reset the EEPROM's word is back; only W wears it."""
        rig = drive()
        assert rig.tell_binary("57 0880 0007") == "57 08 80 00 07"
        assert rig.tell_binary("50 0880 0009") == "50 08 80 00 09"
        rig.power_cycle()
        assert rig.tell_binary("52 0880") == "52 08 80 00 07"
        assert rig.drive.inverter.memory.eeprom_writes == {0x0880: 1}

    def test_the_dummy_data_of_g_does_not_matter(self) -> None:
        """G reads, whatever stands behind the number."""
        rig = drive()
        assert rig.tell_binary("47 0880 0000") == rig.tell_binary("47 0880 FFFF") == "47 08 80 00 00"
        assert rig.word("free_notes") == 0

    def test_a_fault_reset_is_not_answered(self) -> None:
        """Bit 13 with command priority, by P, W and X; then the drive is deaf."""
        for body in ("50 FA00 A000", "57 FA00 A000", "58 01 00 A000"):
            rig = drive(presets={"block_write_1": 1})
            assert rig.tell_binary(body) is None
            assert rig.tell_binary("52 FB07") is None
            rig.wait(1.0)
            assert rig.tell_binary("52 FB07") == "52 FB 07 00 D0"


class TestStartCode:
    def test_both_modes_are_understood_frame_by_frame(self) -> None:
        """The start code of each frame says which one it is in."""
        rig = drive()
        for _ in range(3):
            assert rig.tell("PFA010064") == "PFA010064"
            assert rig.tell_binary("52 FA01") == "52 FA 01 00 64"

    def test_modbus_is_not_understood(self) -> None:
        """F829 = 0 in force: a whole MODBUS-RTU frame gets no answer, not even to drives named like start codes."""
        for number in (1, 40, 47):
            assert drive(number).ask("03 FD00 0001", number=number) is None

    def test_the_protocol_acts_after_a_reset(self) -> None:
        """F829 = 1 is answered as TOSHIBA still is; after the reset it is MODBUS-RTU only."""
        rig = drive()
        assert rig.tell("W08290001") == "W08290001"
        assert rig.tell("R0829") == "R08290001"
        rig.power_cycle()
        assert rig.tell("R0829") is None
        assert rig.tell_binary("52 0829") is None
        assert rig.ask("03 0829 0001") == "03 02 00 01"

    def test_a_model_whose_f829_is_not_known_speaks_what_it_is_told(self) -> None:
        """VF-AS3: MODBUS-RTU unless its options say TOSHIBA, and one of the two only."""
        toshiba, modbus = drive(model="vf-as3"), Rig("vf-as3")
        assert toshiba.tell("RFD00") == "RFD000000"
        assert toshiba.tell_binary("52 FD00") == "52 FD 00 00 00"
        assert toshiba.ask("03 FD00 0001") is None
        assert modbus.ask("03 FD00 0001") == "03 02 00 00"
        assert modbus.tell("RFD00") is None
