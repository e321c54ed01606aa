from __future__ import annotations

from typing import Any

import pytest

from gateway.sim.condition import Limits
from tests.sim.rig import Rig, binary

EMERGENCY = 0x11
POINTS = ("frequency_points", "point_1_setting", "point_1_frequency", "point_2_setting", "point_2_frequency")


def slave(maximum: float = 80.0, action: int = 0, points: tuple[int, ...] = (0,), **options: Any) -> Rig:
    """Return a VF-MB1 that takes its frequency from RS485 and runs by its panel."""
    presets = {"frequency_mode_selection": 4, "master_slave": action} | dict(zip(POINTS, points, strict=False))
    return Rig("vf-mb1", protocol="toshiba", limits=Limits(maximum), presets=presets, **options)


def follow(rig: Rig, word: int, letter: str = "S") -> int:
    """Send a command as a master does, which nobody answers; return the frequency in 0.01 Hz that comes of it."""
    assert rig.send(binary(f"{letter.encode().hex()} FA01 {word:04X}")) is None
    return rig.word("frequency_command")


class TestConversion:
    @pytest.mark.parametrize(("maximum", "hertz"), [(100.0, 5000), (90.0, 4500), (80.0, 4000)])
    def test_it_is_a_share_of_fh_without_points(self, maximum: float, hertz: int) -> None:
        """The table of VF-MB1 RS485 6.1: 50 % of 100, 90 and 80 Hz."""
        assert follow(slave(maximum), 5000) == hertz

    @pytest.mark.parametrize(("second", "hertz"), [(9000, 4500), (8000, 4000)])
    def test_it_goes_by_two_points_where_they_are_enabled(self, second: int, hertz: int) -> None:
        """The table of 6.1: 0 % is 0 Hz, 100 % is 90 or 80 Hz, FH = 100 Hz."""
        assert follow(slave(100.0, points=(1, 0, 0, 100, second)), 5000) == hertz

    def test_a_line_that_does_not_begin_at_zero(self) -> None:
        """20 % is 10 Hz and 80 % is 40 Hz: 50 % is 25 Hz, 0 % is 0 Hz."""
        rig = slave(points=(1, 20, 1000, 80, 4000))
        assert follow(rig, 5000) == 2500
        assert follow(rig, 0) == 0
        assert follow(rig, 9999) == 4999

    def test_a_falling_line_and_one_that_would_fall_below_zero(self) -> None:
        """0 % is 30 Hz and 50 % is 0 Hz: 25 % is 15 Hz, and beyond 50 % it stays at 0."""
        rig = slave(points=(1, 0, 3000, 50, 0))
        assert [follow(rig, word) for word in (0, 2500, 5000, 9000)] == [3000, 1500, 0, 0]

    @pytest.mark.parametrize(("word", "hertz"), [(1, 0), (2, 1), (3333, 2666), (9999, 7999), (10000, 8000)])
    def test_fractions_are_omitted(self, word: int, hertz: int) -> None:
        """An error of 0.01 Hz at most, downwards: 33.33 % of 80 Hz is 26.66."""
        assert follow(slave(), word) == hertz
        assert follow(slave(points=(1, 0, 0, 100, 8000)), word) == hertz

    def test_nothing_is_checked_against_a_limit(self) -> None:
        """400 % is taken as it is (4.2); the motor keeps to FH."""
        rig = slave()
        assert follow(rig, 40000) == 32000
        rig.drive.inverter.run_by_panel(1.0)
        rig.wait(100)
        assert rig.tell("RFD00") == "RFD001F40"

    def test_a_frequency_beyond_a_word_becomes_the_largest(self) -> None:
        """655.35 % of 500 Hz has no place in 16 bits."""
        assert follow(slave(500.0), 0xFFFF) == 0xFFFF
        assert follow(slave(points=(1, 0, 0, 1, 60000)), 0xFFFF) == 0xFFFF

    def test_two_points_in_one_change_nothing(self) -> None:
        """F811 = F813 gives no line to go by: the frequency stays."""
        rig = slave(points=(1, 50, 1000, 50, 2000))
        rig.tell("PFA010064")
        assert follow(rig, 5000) == 100


class TestWhoFollows:
    def test_a_number_makes_it_one_drive_s(self) -> None:
        """Without one all follow, and with FFH; with one, only that drive (6.2)."""
        for number, words in ((1, [100, 100, 100]), (2, [0, 100, 100])):
            rig = slave(100.0, number=number)
            heard = []
            for target in ("01", "FF", ""):
                assert rig.tell_binary(f"{target} 53 FA01 0064") is None
                heard.append(rig.word("frequency_command"))
            assert heard == words

    def test_it_runs_where_the_frequency_comes_from_rs485(self) -> None:
        """FMOD = 4 or FA00 bit 14, as for FA01 (6, 8.1)."""
        for presets, command in (({"frequency_mode_selection": 4}, "8400"), ({}, "C400")):
            rig = Rig("vf-mb1", protocol="toshiba", presets=presets)
            follow(rig, 5000)
            rig.tell(f"PFA00{command}")
            rig.wait(20)
            assert rig.tell("RFD00") == "RFD000FA0"

    def test_it_takes_over_from_a_speed_command(self) -> None:
        """The last of FA13 and FA01 counts, and S writes FA01."""
        rig = slave()
        rig.tell("PFA13012C")
        rig.drive.inverter.run_by_panel(1.0)
        follow(rig, 5000)
        rig.wait(20)
        assert rig.tell("RFD00") == "RFD000FA0"

    @pytest.mark.parametrize("address", ["FA00", "FA13", "FD00", "FFFF", "0880"])
    def test_no_other_number_can_be_written(self, address: str) -> None:
        """FA01 only; the error is not told, for S is never answered."""
        rig = slave()
        before = rig.drive.inverter.memory.changes
        assert rig.tell_binary(f"53 {address} 0064") is None
        assert rig.drive.inverter.memory.changes == before

    def test_a_wrong_checksum_is_silence_and_nothing_is_done(self) -> None:
        """No N either: who sends S listens to nobody."""
        rig = slave()
        frame = binary("53 FA01 1388")
        assert rig.send(frame[:-1] + b"\x00") is None
        assert rig.word("frequency_command") == 0

    def test_vf_nc3_does_not_know_it(self) -> None:
        """Its list of commands has none, nor has it F806 and F810."""
        rig = Rig(protocol="toshiba")
        assert follow(rig, 5000) == 0
        assert follow(rig, 5000, "s") == 0
        assert rig.drive.inverter.condition.is_master_tripped is False

    def test_vf_as3_knows_it_and_has_nothing_to_write_it_to(self) -> None:
        """FA01 is not in its catalogue: the number is refused, silently."""
        rig = Rig("vf-as3", protocol="toshiba")
        assert rig.send(binary("53 FA01 1388")) is None

    def test_a_modbus_drive_does_not_follow(self) -> None:
        """Inter-drive communication is of the TOSHIBA protocol (6)."""
        assert follow(Rig("vf-mb1"), 5000) == 0


class TestTrippedMaster:
    def test_0_makes_the_slave_stop(self) -> None:
        """F806 = 0: 0 Hz until S comes again."""
        rig = slave(action=0)
        follow(rig, 5000)
        assert follow(rig, 5000, "s") == 0
        assert follow(rig, 5000, "S") == 4000

    def test_1_makes_the_slave_go_on(self) -> None:
        """F806 = 1: by what the master still sends, which is 0 where it sends its output frequency."""
        rig = slave(action=1)
        follow(rig, 5000)
        assert follow(rig, 5000, "s") == 4000
        assert follow(rig, 0, "s") == 0

    def test_2_makes_the_slave_trip(self) -> None:
        """F806 = 2: emergency stop, trip E, held until the slave is reset."""
        rig = slave(action=2)
        follow(rig, 5000)
        assert follow(rig, 0, "s") == 4000
        follow(rig, 5000)
        assert rig.tell("RFC90") == f"rFC90{EMERGENCY:04X}"

    @pytest.mark.parametrize("action", [0, 1])
    def test_the_alarm_stands_until_the_master_is_back(self, action: int) -> None:
        """It blinks "t": bit 2 of FD01."""
        rig = slave(action=action)
        follow(rig, 0, "s")
        assert rig.tell("RFD01") == "RFD014004"
        follow(rig, 5000)
        assert rig.tell("RFD01") == "RFD014000"

    def test_a_reset_ends_it_too(self) -> None:
        """The alarm is not kept over a power cycle."""
        rig = slave()
        follow(rig, 0, "s")
        rig.power_cycle()
        assert rig.tell("RFD01") == "RFD014000"

    def test_f806_acts_after_a_reset(self) -> None:
        """Written, it reads back 2, and the slave still stops as by 0."""
        rig = slave(action=0)
        rig.tell("W08060002")
        follow(rig, 0, "s")
        assert rig.tell("RFC90") == "RFC900000"
        rig.power_cycle()
        follow(rig, 0, "s")
        assert rig.tell("RFC90") == f"rFC90{EMERGENCY:04X}"
