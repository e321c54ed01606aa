from __future__ import annotations

from typing import Any

import pytest

from gateway.sim.condition import Limits
from tests.sim.rig import Rig

RUN, REVERSE, JOG, COAST = 0x0400, 0x0200, 0x0100, 0x0800
COMMAND, FREQUENCY = 0x8000, 0x4000  # priorities
BOTH = COMMAND | FREQUENCY


def started(frequency: int = 3000, bits: int = 0, model: str = "vf-nc3", **options: Any) -> Rig:
    """Return a drive that was commanded to run by communication at a frequency in 0.01 Hz."""
    rig = Rig(model, **options)
    rig.write("frequency_command", frequency)
    rig.write("command", BOTH | RUN | bits)
    return rig


class TestRunning:
    def test_the_frequency_ramps_in_the_acceleration_time(self) -> None:
        """ACC = 10.0 s from 0 to FH = 80 Hz: 8 Hz in a second, 30 Hz after 3.75 s."""
        rig = started()
        rig.wait(1.0)
        assert rig.read("output_frequency") == 800
        rig.wait(2.7)
        assert rig.read("output_frequency") == 2960
        rig.wait(0.1)
        assert rig.read("output_frequency") == 3000

    def test_it_ramps_down_in_the_deceleration_time(self) -> None:
        """DEC = 5.0 s: 16 Hz in a second."""
        rig = started(presets={"deceleration_time_1": 50})
        rig.wait(10)
        rig.write("command", BOTH)
        rig.wait(1)
        assert rig.read("output_frequency") == 1400
        assert rig.read("status") == 0x4400
        rig.wait(1)
        assert rig.read("output_frequency") == 0
        assert rig.read("status") == 0x4000

    def test_how_often_it_is_looked_at_does_not_change_where_it_is(self) -> None:
        """One long tick and a thousand short ones lead to the same frequency."""
        once, often = started(), started()
        once.wait(2.0)
        for _ in range(1000):
            often.wait(0.002)
        assert often.drive.inverter.condition.motor.frequency == pytest.approx(
            once.drive.inverter.condition.motor.frequency
        )

    def test_reverse_goes_through_standstill(self) -> None:
        """30 Hz forward to 30 Hz in reverse takes both ramps; bit 9 tells the direction it turns in."""
        rig = started()
        rig.wait(5)
        rig.write("command", BOTH | RUN | REVERSE)
        rig.wait(3.75)
        assert rig.read("output_frequency") == 0
        rig.wait(1.0)
        assert rig.read("output_frequency") == 800
        assert rig.read("status") & REVERSE

    def test_each_way_through_standstill_has_its_own_ramp(self) -> None:
        """Down at 16 Hz a second and up in reverse at 8: after 2.875 s it turns at 8 Hz."""
        rig = started(presets={"deceleration_time_1": 50})
        rig.wait(5)
        rig.write("command", BOTH | RUN | REVERSE)
        rig.wait(2.875)
        assert rig.read("output_frequency") == 800

    def test_without_command_priority_nothing_runs(self) -> None:
        """Bit 10 alone is no command."""
        rig = Rig()
        rig.write("frequency_command", 3000)
        rig.write("command", RUN)
        rig.wait(5)
        assert rig.read("output_frequency") == 0

    def test_without_frequency_priority_the_panel_s_frequency_counts(self) -> None:
        """Bit 15 without bit 14 runs at what the panel says."""
        rig = Rig()
        rig.drive.set_by_panel("panel_frequency", 1500)
        rig.write("frequency_command", 3000)
        rig.write("command", COMMAND | RUN)
        rig.wait(10)
        assert rig.read("output_frequency") == 1500

    @pytest.mark.parametrize(("model", "code"), [("vf-nc3", 3), ("vf-mb1", 4)])
    def test_the_frequency_mode_parameter_selects_communication_too(self, model: str, code: int) -> None:
        """FMOD for RS485 is 3 on VF-nC3 and 4 on VF-MB1."""
        rig = Rig(model, presets={"frequency_mode_selection": code})
        rig.write("frequency_command", 2000)
        rig.write("command", COMMAND | RUN)
        rig.wait(10)
        assert rig.read("output_frequency") == 2000

    def test_the_priorities_stay_until_they_are_released(self) -> None:
        """A panel that runs is overruled by bit 15, and rules again without it."""
        rig = Rig(running_at=20.0)
        rig.write("command", COMMAND)
        rig.wait(10)
        assert rig.read("output_frequency") == 0
        rig.write("command", 0)
        rig.wait(10)
        assert rig.read("output_frequency") == 2000

    def test_coast_cuts_the_output(self) -> None:
        """Bit 11 takes the output away at once and shows in the status."""
        rig = started()
        rig.wait(5)
        rig.write("command", BOTH | RUN | COAST)
        rig.wait(0.001)
        assert rig.read("output_frequency") == 0
        assert rig.read("output_current") == 0
        assert rig.read("status") == 0x4800

    def test_jog_runs_at_the_jog_frequency(self) -> None:
        """Bit 8 with the run bit."""
        rig = started(bits=JOG)
        rig.wait(5)
        assert rig.read("output_frequency") == 500
        assert rig.read("status") & JOG

    def test_preset_speeds_have_priority(self) -> None:
        """Bits 0 to 3 choose one of fifteen; FD46 says 255 then."""
        rig = started(bits=2, limits=Limits(presets=(10.0, 25.0)))
        rig.wait(10)
        assert rig.read("output_frequency") == 2500
        assert rig.read("frequency_mode") == 255

    def test_the_forced_stop_of_command_2_is_quick(self) -> None:
        """FA20 bit 7 stops at the greatest deceleration, whatever DEC says."""
        rig = started(presets={"deceleration_time_1": 1000})
        rig.wait(10)
        rig.write("command_2", 0x0080)
        rig.wait(0.1)
        assert rig.read("output_frequency") == 0
        assert rig.read("status_2") == 0x0080

    def test_acceleration_patterns_of_vf_mb1(self) -> None:
        """FA20 bits 8 and 9 choose among three pairs of times; F510 = 2.0 s is 40 Hz in a second."""
        rig = started(6000, model="vf-mb1", presets={"acceleration_time_3": 20})
        rig.write("command_2", 0x0200)
        rig.wait(1)
        assert rig.read("output_frequency") == 4000
        assert rig.read("status_2") == 0x0200

    def test_dc_braking_holds_the_motor(self) -> None:
        """Bit 7 stops at once and is told."""
        rig = started()
        rig.wait(5)
        rig.write("command", BOTH | 0x0080)
        rig.wait(0.001)
        assert rig.read("output_frequency") == 0
        assert rig.read("status") & 0x0080


class TestMotorSpeed:
    def test_a_speed_becomes_a_frequency(self) -> None:
        """1800 min-1 with 4 poles is 60 Hz (VF-MB1 8.1), and reads back as a speed."""
        rig = Rig("vf-mb1")
        rig.write("motor_speed_command", 1800)
        rig.write("command", BOTH | RUN)
        rig.wait(10)
        assert rig.read("output_frequency") == 6000
        assert rig.read("motor_speed") == 1800

    def test_the_last_one_of_speed_and_frequency_counts(self) -> None:
        """FA01 written after FA13 takes over."""
        rig = started(3000, model="vf-mb1")
        rig.write("motor_speed_command", 600)
        rig.wait(10)
        assert rig.read("output_frequency") == 2000
        rig.write("frequency_command", 1000)
        rig.wait(10)
        assert rig.read("output_frequency") == 1000

    def test_a_speed_above_the_maximum_frequency_is_refused(self) -> None:
        """2401 min-1 with 4 poles is more than 80 Hz."""
        rig = Rig("vf-mb1")
        assert rig.write("motor_speed_command", 2401) == "86 03"
        assert rig.write("motor_speed_command", 2400) == "06 FA 13 09 60"


class TestTrips:
    def test_the_emergency_stop_always_acts(self) -> None:
        """Bit 12 without any priority trips E, even while the panel runs the motor."""
        rig = Rig(running_at=30.0)
        assert rig.write("command", 0x1000) == "06 FA 00 10 00"
        assert rig.read("trip_code") == 0x11
        assert rig.read("status") == 0x1003
        assert rig.read("output_frequency") == 0

    def test_a_trip_keeps_what_was_before_it(self) -> None:
        """FE00 and its like hold; FD00 and its like go on."""
        rig = Rig(running_at=30.0)
        rig.write("command", 0x1000)
        rig.wait(5)
        assert rig.read("trip_output_frequency") == 3000
        assert rig.read("trip_status") == 0x6400
        assert 3000 < rig.read("trip_output_current") < 5000
        assert rig.read("output_current") == 0

    def test_a_tripped_drive_does_not_run(self) -> None:
        """A run command to a tripped drive is acknowledged and moves nothing."""
        rig = started()
        rig.write("command", 0x9000)
        rig.write("command", BOTH | RUN)
        rig.wait(5)
        assert rig.read("output_frequency") == 0
        assert rig.read("trip_code") == 0x11
        assert rig.write("automatic_acceleration", 1) == "06 00 00 00 01"  # not while running, but it does not run

    @pytest.mark.parametrize(("model", "places"), [("vf-nc3", 4), ("vf-mb1", 8)])
    def test_past_trips_shift_and_outlive_the_power(self, model: str, places: int) -> None:
        """The latest stands first; VF-nC3 shows four, VF-MB1 eight."""
        rig = Rig(model)
        for code in range(1, 11):
            rig.drive.inverter.trip(code)
            rig.power_cycle()
        shown = [rig.read(f"past_trip_{place}") for place in range(1, places + 1)]
        assert shown == list(range(10, 10 - places, -1))
        assert rig.read("trip_code") == 0

    def test_a_second_trip_does_not_replace_the_first(self) -> None:
        """What tripped first is what the operator needs to know."""
        rig = Rig()
        rig.drive.inverter.trip(0x0D)
        rig.write("command", 0x1000)
        assert rig.read("trip_code") == 0x0D
        assert rig.read("past_trip_2") == 0


class TestFaultReset:
    @pytest.mark.hazard("H09")
    def test_a_fault_reset_gets_no_answer_and_a_deaf_second(self) -> None:
        """Bit 13 is not answered; for about a second nothing else is either."""
        rig = Rig()
        rig.write("command", 0x9000)
        assert rig.write("command", 0xA000) is None
        rig.wait(0.99)
        assert rig.ask("03 FC90 0001") is None
        rig.wait(0.02)
        assert rig.read("trip_code") == 0

    def test_a_fault_reset_clears_ram_and_keeps_the_eeprom(self) -> None:
        """FA00, FA01 and FA87 are 0 again; F803 written by 06H is still there."""
        rig = started(presets={"block_write_1": 3})
        rig.write("reset_detection", 1)
        rig.write("communication_timeout", 50)
        rig.ask("10 1870 0002 04 0BB8 0000")
        rig.write("command", 0xA000)
        rig.wait(1)
        names = ("command", "frequency_command", "reset_detection", "communication_timeout")
        assert [rig.read(name) for name in names] == [0, 0, 0, 50]

    def test_without_command_priority_there_is_no_fault_reset(self) -> None:
        """Only the emergency stop is said to act without bit 15."""
        rig = Rig()
        rig.write("command", 0x1000)
        assert rig.write("command", 0x2000) == "06 FA 00 20 00"
        assert rig.read("trip_code") == 0x11

    def test_a_reset_by_broadcast_acts(self) -> None:
        """Number 0 resets every drive."""
        rig = Rig()
        rig.drive.inverter.trip(0x0D)
        assert rig.ask("06 FA00 A000", number=0) is None
        rig.wait(1)
        assert rig.read("trip_code") == 0

    def test_a_running_drive_stands_after_a_power_cycle(self) -> None:
        """Neither the panel's RUN nor FA00 survives the power."""
        rig = Rig(running_at=30.0)
        rig.power_cycle()
        rig.wait(10)
        assert rig.read("output_frequency") == 0
        assert rig.read("status") == 0x4000
