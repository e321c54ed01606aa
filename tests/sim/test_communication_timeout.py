from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.sim.rig import Rig, binary, framed

ERR5 = 0x18
RUNNING_BY_RS485 = 0xC400


def armed(action: int = 1, detection: int = 0, tenths: int = 10, **options: Any) -> Rig:
    """Return a drive whose F803 is one second from its power-on, with nothing heard yet."""
    presets = {"communication_timeout": tenths, "timeout_action": action, "timeout_detection": detection}
    return Rig(presets=presets, **options)


def trip_code(rig: Rig) -> int:
    """Look at the drive without sending it anything."""
    rig.drive.tick(rig.now)
    return rig.drive.inverter.condition.trip_code


class TestStart:
    def test_nothing_happens_before_the_first_message(self) -> None:
        """After power-on the timer waits for communication to be established."""
        rig = armed()
        rig.wait(1000)
        assert trip_code(rig) == 0

    def test_it_runs_from_the_first_message_on(self) -> None:
        """One message, and a second later the drive trips Err5."""
        rig = armed()
        rig.wait(50)
        rig.read("status")
        rig.wait(0.999)
        assert trip_code(rig) == 0
        rig.wait(0.002)
        assert trip_code(rig) == ERR5

    def test_the_message_that_sets_it_does_not_start_it(self) -> None:
        """Written by communication, it starts at the message after."""
        rig = Rig(presets={"timeout_action": 1, "timeout_detection": 0})
        rig.write("communication_timeout", 10)
        rig.wait(100)
        assert trip_code(rig) == 0
        rig.read("status")
        rig.wait(1.001)
        assert trip_code(rig) == ERR5

    def test_setting_it_anew_makes_it_wait_again(self) -> None:
        """A running timer that is written stands until the next message."""
        rig = armed()
        rig.read("status")
        rig.wait(0.9)
        rig.write("communication_timeout", 20)
        rig.wait(100)
        assert trip_code(rig) == 0

    def test_zero_switches_it_off(self) -> None:
        """F803 = 0.0 never runs out, whatever is sent afterwards."""
        rig = armed()
        rig.read("status")
        rig.write("communication_timeout", 0)
        rig.read("status")
        rig.wait(1000)
        assert trip_code(rig) == 0

    def test_a_reset_makes_it_wait_again(self) -> None:
        """Stored in the EEPROM, it starts at the first message after power-on."""
        rig = armed()
        rig.read("status")
        rig.power_cycle()
        rig.wait(1000)
        assert trip_code(rig) == 0


class TestWhatCounts:
    @pytest.mark.hazard("H05")
    @pytest.mark.parametrize("body", ["03 FD00 0001", "06 FA01 0000", "2B 0E 01 00", "03 0131 0001", "01 0000 0001"])
    def test_every_acknowledged_message_counts_and_reads_are_such(self, body: str) -> None:
        """Reads, writes, identification and refused requests all start the timer anew."""
        rig = armed()
        rig.read("status")
        for _ in range(20):
            rig.wait(0.9)
            assert rig.ask(body) is not None
        assert trip_code(rig) == 0
        rig.wait(1.001)
        assert trip_code(rig) == ERR5

    @pytest.mark.parametrize(
        "frame",
        [
            framed("03 FD00 0001", number=2),
            framed("03 FD00 0001")[:-1] + b"\x00",
            framed("03 FD00 00"),
            framed("06 FA01 0000", number=0),
        ],
        ids=["another number", "wrong check", "too short", "broadcast"],
    )
    def test_what_is_not_acknowledged_does_not_count(self, frame: bytes) -> None:
        """Another number, a wrong check, a wrong length and a broadcast leave the timer running."""
        rig = armed()
        rig.read("status")
        for _ in range(2):
            rig.wait(0.4)
            assert rig.send(frame) is None
        rig.wait(0.201)
        assert trip_code(rig) == ERR5

    @given(st.lists(st.floats(0.01, 2.0), min_size=1, max_size=20))
    def test_it_trips_exactly_when_two_messages_are_further_apart_than_f803(self, pauses: list[float]) -> None:
        """Whatever the pauses: the trip is there if and only if one of them reached a second."""
        rig = armed()
        rig.read("status")
        has_run_out = False
        for pause in pauses:
            rig.wait(pause)
            has_run_out |= pause >= 1.0
            assert trip_code(rig) == (ERR5 if has_run_out else 0)
            rig.read("status")


class TestWhatCountsInToshiba:
    @pytest.mark.parametrize("number", [0, 1])
    @pytest.mark.parametrize(
        "frame",
        [b"(RFD00)\r", b"(PFA010000)\r", b"(R0131)\r", b"(LFD00)\r", b"(RFD00&00)\r", b"(W088000000)\r"]
        + [binary(body) for body in ("52 FD00", "58 00 05", "50 FA01 0000", "52 0131")]
        + [binary("52 FD00")[:-1] + b"\x00"],
    )
    def test_every_answer_counts_and_refusals_are_such(self, frame: bytes, number: int) -> None:
        """Reads, writes, blocks, and each error that is answered, a wrong checksum too."""
        rig = armed(protocol="toshiba", number=number)
        for _ in range(5):
            assert rig.send(frame) is not None
            rig.wait(0.9)
        assert trip_code(rig) == 0
        rig.wait(0.101)
        assert trip_code(rig) == ERR5

    @pytest.mark.parametrize(
        "frame", [b"(**PFA010000)\r", b"(0*RFD00)\r", binary("FF 50 FA01 0000"), binary("FF 58 00 05")]
    )
    def test_a_broadcast_counts_for_the_one_that_answers_it(self, frame: bytes) -> None:
        """The representative has acknowledged it; for the others of the group the timer runs on."""
        for number, code in ((0, 0), (1, ERR5)):
            rig = armed(protocol="toshiba", number=number)
            rig.tell("RFD00")
            for _ in range(2):
                rig.wait(0.6)
                assert (rig.send(frame) is None) == (number != 0)
            assert trip_code(rig) == code

    @pytest.mark.parametrize(
        "frame",
        [
            b"(02RFD00)\r",
            b"(1RFD00)\r",
            b"(RFD00",
            b"(RFD)\r",
            binary("02 52 FD00"),
            binary("59 FD00"),
            binary("52 FD00 00"),
            framed("03 FD00 0001"),
        ],
    )
    def test_what_is_not_answered_does_not_count(self, frame: bytes) -> None:
        """Another number, format errors, an unknown command in binary, MODBUS-RTU."""
        rig = armed(protocol="toshiba")
        rig.tell("RFD00")
        for _ in range(2):
            rig.wait(0.4)
            assert rig.send(frame) is None
        rig.wait(0.201)
        assert trip_code(rig) == ERR5

    @pytest.mark.parametrize(("counts", "code"), [(False, ERR5), (True, 0)])
    def test_s_does_not_count_unless_the_drive_is_set_to(self, counts: bool, code: int) -> None:
        """It is never acknowledged; yet slaves that hear nothing else are told to set F803 (VF-MB1 RS485 6)."""
        rig = armed(protocol="toshiba", model="vf-mb1", proportional_restarts_timer=counts)
        rig.tell("RFD00")
        for _ in range(5):
            rig.wait(0.4)
            assert rig.send(binary("53 FA01 1388")) is None
        assert trip_code(rig) == code

    def test_the_message_that_sets_it_does_not_start_it(self) -> None:
        """By W, by P, and of a block none can."""
        for letter in "WP":
            rig = Rig(protocol="toshiba", presets={"timeout_action": 1, "timeout_detection": 0})
            rig.tell(f"{letter}0803000A")
            rig.wait(100)
            assert trip_code(rig) == 0
            rig.tell("RFD00")
            rig.wait(1.001)
            assert trip_code(rig) == ERR5

    def test_a_time_out_set_by_p_is_gone_after_a_reset(self) -> None:
        """F803 in RAM is back at what the EEPROM holds."""
        rig = Rig(protocol="toshiba", presets={"timeout_action": 1, "timeout_detection": 0})
        rig.tell("P0803000A")
        rig.tell("RFD00")
        rig.power_cycle()
        rig.tell("RFD00")
        rig.wait(100)
        assert trip_code(rig) == 0


class TestAction:
    def test_alarm_only_shows_in_the_status_until_the_next_message(self) -> None:
        """F804 = 0: the motor turns on; bit 2 of FD01 tells, and the next message ends it."""
        rig = armed(action=0, running_at=30.0)
        rig.read("status")
        rig.wait(1.5)
        assert rig.drive.inverter.condition.is_timed_out
        assert rig.drive.inverter.condition.motor.frequency == 30.0
        assert rig.drive.registers.read(0xFD01) == 0x6404
        rig.read("status")
        assert rig.read("status") == 0x6400

    def test_a_coasting_trip_holds_what_was_at_the_time_out(self) -> None:
        """F804 = 1 while the motor ramps: what is held is the frequency of that moment, however late one looks."""
        rig = armed()
        rig.write("frequency_command", 6000)
        rig.write("command", RUNNING_BY_RS485)
        rig.wait(100)
        assert rig.read("trip_code") == ERR5
        assert rig.read("trip_output_frequency") == 800
        assert rig.read("status") == 0x0003

    def test_stop_and_trip_slows_down_first(self) -> None:
        """F804 = 2: at 8 Hz a second from 30 Hz the trip comes 3.75 s after the time-out."""
        rig = armed(action=2, running_at=30.0)
        rig.read("status")
        rig.wait(1.0 + 3.7)
        assert trip_code(rig) == 0
        assert rig.drive.inverter.condition.motor.frequency == pytest.approx(0.4)
        rig.wait(0.1)
        assert trip_code(rig) == ERR5

    def test_stop_and_trip_of_a_standing_drive_trips_at_once(self) -> None:
        """Nothing is to be slowed down."""
        rig = armed(action=2)
        rig.read("status")
        rig.wait(1.0)
        assert trip_code(rig) == ERR5


class TestDetection:
    def test_in_communication_mode_a_drive_run_by_its_panel_is_left_alone(self) -> None:
        """F808 = 1 as shipped: no priority bit and no FMOD for RS485, no time-out."""
        rig = armed(detection=1, running_at=30.0)
        rig.read("status")
        rig.wait(100)
        assert trip_code(rig) == 0

    @pytest.mark.parametrize("command", [0x8000, 0x4000])
    def test_in_communication_mode_either_priority_is_enough(self, command: int) -> None:
        """Bit 15 or bit 14 of FA00."""
        rig = armed(detection=1)
        rig.write("command", command)
        rig.wait(1.0)
        assert trip_code(rig) == ERR5

    def test_communication_and_running_needs_both(self) -> None:
        """F808 = 2: a commanded drive that stands is left alone, one that runs trips."""
        rig = armed(detection=2)
        rig.write("command", 0xC000)
        rig.wait(100)
        assert trip_code(rig) == 0
        rig.write("frequency_command", 3000)
        rig.write("command", RUNNING_BY_RS485)
        rig.wait(1.0)
        assert trip_code(rig) == ERR5

    def test_as_shipped_nothing_ever_stops_the_motor(self) -> None:
        """F803 = 0.0, F804 = 0, F808 = 1: an hour without a message changes nothing."""
        rig = Rig()
        rig.write("frequency_command", 3000)
        rig.write("command", RUNNING_BY_RS485)
        rig.wait(3600)
        assert trip_code(rig) == 0
        assert rig.drive.inverter.condition.motor.frequency == 30.0
