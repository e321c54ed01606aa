from __future__ import annotations

import pytest

from tests.sim.rig import Rig


class TestUndefinedBits:
    @pytest.mark.hazard("H20")
    def test_the_undefined_bit_of_the_status_is_unstable(self) -> None:
        """Bit 15 of FD01 comes and goes, the defined ones stand."""
        rig = Rig(stable_bits=False, running_at=30.0)
        words = {rig.read("status") for _ in range(50)}
        assert words == {0x6400, 0xE400}

    def test_the_same_seed_gives_the_same_bits(self) -> None:
        """A run can be repeated bit by bit."""
        runs = [[Rig(stable_bits=False, seed=seed).read("alarm_2")] for seed in (5, 5)]
        assert runs[0] == runs[1]

    def test_the_keys_are_normal(self) -> None:
        """Bit 15 of FC00 is defined: 1 while the keys are sound."""
        assert Rig(stable_bits=False).read("key_state") == 0x8000


class TestMeasurements:
    def test_a_standing_motor_has_neither_current_nor_voltage(self) -> None:
        """Only the DC voltage is there."""
        rig = Rig()
        assert [rig.read(name) for name in ("output_current", "output_voltage", "torque", "output_power")] == [0] * 4
        assert rig.read("input_voltage") == pytest.approx(10_000, abs=60)

    def test_voltage_follows_frequency_up_to_the_base_frequency(self) -> None:
        """V/f: half the voltage at 30 Hz, full at 60 Hz and not more at 80 Hz."""
        volts = [Rig(running_at=hertz).read("output_voltage") for hertz in (15.0, 30.0, 45.0, 60.0, 80.0)]
        assert volts == sorted(volts)
        assert volts[1] == pytest.approx(5000, abs=300)
        assert volts[3:] == [10_000, 10_000]

    def test_current_grows_with_load_and_speed_and_is_never_still(self) -> None:
        """A pump's load rises with speed; readings scatter by some tenths of a per cent."""
        light, heavy = Rig(running_at=60.0, load=0.2), Rig(running_at=60.0, load=0.9)
        slow = Rig(running_at=20.0, load=0.9)
        assert light.read("output_current") < heavy.read("output_current")
        assert slow.read("output_current") < heavy.read("output_current") < 12_000
        readings = [heavy.read("output_current") for _ in range(50)]
        assert len(set(readings)) > 10
        assert max(readings) - min(readings) < 300

    def test_a_braking_motor_has_negative_torque_and_lifts_the_dc_voltage(self) -> None:
        """A quick stop drives energy back: FD18 is negative, FD04 above 100 %."""
        rig = Rig(running_at=60.0, load=0.1, presets={"deceleration_time_1": 10})
        rig.drive.inverter.run_by_panel(0)
        rig.wait(0.3)
        assert rig.read("torque") > 0x8000
        assert rig.read("input_voltage") > 10_100

    def test_powers_fit_the_size(self) -> None:
        """A 2.2 kW drive at 60 Hz and 60 % load gives 1.3 kW and takes more."""
        rig = Rig(capacity="VFnC3-2022P", running_at=60.0)
        assert rig.read("output_power") == 132
        assert 140 < rig.read("input_power") < 170

    def test_hours_are_counted(self) -> None:
        """Running and power-on time grow, each by what was so."""
        rig = Rig(running_at=10.0, hours=100.0)
        rig.wait(5 * 3600)
        rig.drive.inverter.run_by_panel(0)
        rig.wait(5 * 3600)
        assert rig.read("cumulative_operation_time") == 105
        assert rig.read("cumulative_power_on_time") == 260

    def test_vf_mb1_counts_in_tens_of_hours_and_thousands_of_starts(self) -> None:
        """FE80 is in 10 h, FD32 in 1000 starts."""
        rig = Rig("vf-mb1", hours=100.0)
        rig.drive.inverter.condition.counters.forward_starts = 2600
        assert rig.read("cumulative_power_on_time") == 25
        assert rig.read("starts") == 3
        rig.drive.inverter.run_by_panel(10.0, is_reverse=True)
        rig.wait(1)
        assert rig.drive.inverter.condition.counters.reverse_starts == 1

    def test_vf_mb1_counts_energy(self) -> None:
        """FE77 in 0.1 kWh: 0.75 kW at 60 % for ten hours."""
        rig = Rig("vf-mb1", running_at=60.0)
        rig.wait(36_000)
        assert rig.read("output_energy") == 45
        assert rig.read("input_energy") > 50

    def test_an_overloaded_motor_fills_the_overload_factor(self) -> None:
        """150 % of torque reach 100 % in a minute; it falls again without load."""
        rig = Rig(running_at=60.0, load=1.5)
        rig.wait(30)
        assert rig.read("motor_overload_factor") == pytest.approx(5000, abs=10)
        rig.wait(60)
        assert rig.read("motor_overload_factor") == 10_000
        rig.drive.inverter.run_by_panel(0)
        rig.wait(30)
        assert 0 < rig.read("motor_overload_factor") < 10_000
        rig.power_cycle()
        assert rig.read("motor_overload_factor") == 0


class TestStatus:
    def test_the_ramp_shows_in_status_3(self) -> None:
        """FD49: accelerating, constant, decelerating."""
        rig = Rig()
        rig.drive.inverter.run_by_panel(8.0)
        rig.wait(0.5)
        assert rig.read("status_3") & 0xD400 == 0x4000
        rig.wait(2)
        assert rig.read("status_3") & 0xD400 == 0x1400
        rig.drive.inverter.run_by_panel(0)
        rig.wait(0.5)
        assert rig.read("status_3") & 0xD400 == 0x8000

    def test_the_healthy_bit_turns_over_every_second(self) -> None:
        """FD49 bit 11."""
        rig = Rig()
        seen = []
        for _ in range(4):
            seen.append(rig.read("status_3") >> 11 & 1)
            rig.wait(1)
        assert seen == [0, 1, 0, 1]

    def test_who_commands_shows(self) -> None:
        """FD45 and FD46: panel, then RS485."""
        rig = Rig()
        assert (rig.read("command_mode"), rig.read("frequency_mode")) == (1, 2)
        rig.write("command", 0xC000)
        assert (rig.read("command_mode"), rig.read("frequency_mode")) == (2, 3)

    def test_terminals_follow_their_functions(self) -> None:
        """F130 = 92 puts bit 0 of FA50 out, 93 its opposite; FL shows the trip."""
        rig = Rig(presets={"output_function_1": 92})
        rig.write("terminal_output", 1)
        assert rig.read("output_terminals") == 1
        rig.drive.set_by_panel("output_function_1", 93)
        assert rig.read("output_terminals") == 0
        rig.drive.inverter.trip(0x0D)
        assert rig.read("output_terminals") == 4

    def test_the_command_s_bits_show_in_the_status(self) -> None:
        """Motor 2, PID off and pattern 2 stand at the same place in FD01."""
        rig = Rig()
        rig.write("command", 0x8070)
        assert rig.read("status") == 0x4070

    def test_alarms_and_keys_from_outside_show(self) -> None:
        """FC91 as set, bit 2 of FD01 with it; FA11 shows in FC00 while FA10 = 1."""
        rig = Rig()
        rig.drive.inverter.condition.alarm = 0x0080
        assert rig.read("alarm") == 0x0080
        assert rig.read("status") == 0x4004
        rig.write("external_keys", 0x0002)
        assert rig.read("key_state") == 0x8000
        rig.write("panel_key_selection", 1)
        assert rig.read("key_state") == 0x8002

    def test_a_forced_register_reads_what_it_was_told(self) -> None:
        """A test can pin any monitor, and let it go."""
        rig = Rig()
        rig.drive.force("output_frequency", 1234)
        assert rig.read("output_frequency") == 1234
        rig.drive.force("output_frequency", None)
        assert rig.read("output_frequency") == 0
