"""VF-MB1 as its RS485 manual prints it: the tables typed from the pages, and the values of its examples."""

from __future__ import annotations

from decimal import Decimal

import pytest

from gateway.drives.catalogue import load
from gateway.drives.model import Model
from gateway.drives.register import Kind, Storage
from gateway.drives.scaling import OutOfRange

# Section 9, "Commands": number, name, writes go to, lowest and highest (None: of FH, LL, UL) and initial raw value.
COMMANDS = [
    (0xFA00, "command", "ram", 0, 65535, 0),
    (0xFA01, "frequency_command", "ram", None, None, 0),
    (0xFA03, "panel_frequency", "eeprom", None, None, 0),
    (0xFA08, "local_remote", "eeprom", 0, 1, 0),
    (0xFA10, "panel_key_selection", "ram", 0, 1, 0),
    (0xFA11, "external_keys", "ram", 0, 65535, 0),
    (0xFA13, "motor_speed_command", "ram", 0, 24000, 0),
    (0xFA20, "command_2", "ram", 0, 65535, 0),
    (0xFA26, "command_3", "ram", 0, 65535, 0),
    (0xFA50, "terminal_output", "ram", 0, 255, 0),
    (0xFA51, "analog_output", "ram", 0, 1000, 0),
    (0xFA65, "led_selection", "eeprom", 0, 2, 1),
    (0xFA66, "led_number", "eeprom", 0, 9999, 0),
    (0xFA67, "led_decimal_point", "eeprom", 0, 2, 0),
    (0xFA68, "led_unit_0", "eeprom", 0, 3, 0),
    (0xFA70, "led_text_1_digit_1", "eeprom", 0, 127, ord("d")),
    (0xFA71, "led_text_1_digit_2", "eeprom", 0, 255, ord("A")),
    (0xFA72, "led_text_1_digit_3", "eeprom", 0, 255, ord("t")),
    (0xFA73, "led_text_1_digit_4", "eeprom", 0, 127, ord("A")),
    (0xFA74, "led_unit_1", "eeprom", 0, 3, 0),
    (0xFA75, "led_text_2_digit_1", "eeprom", 0, 127, ord("0")),
    (0xFA76, "led_text_2_digit_2", "eeprom", 0, 255, ord("0")),
    (0xFA77, "led_text_2_digit_3", "eeprom", 0, 255, ord("0")),
    (0xFA78, "led_text_2_digit_4", "eeprom", 0, 127, ord("0")),
    (0xFA79, "led_unit_2", "eeprom", 0, 3, 0),
    (0xFA80, "block_mode", "eeprom", 0, 1, 0),
    (0xFA87, "reset_detection", "ram", 0, 255, 0),
]

# Section 9, "Monitor parameters": current value, trip data held (0: none), name, unit of one count.
MONITORS = [
    (0x0999, 0, "acceleration_time_unit", ""),
    (0xFB05, 0, "capacity_code", ""),
    (0xFC00, 0, "key_state", ""),
    (0xFC01, 0, "panel_keys", ""),
    (0xFC90, 0, "trip_code", ""),
    (0xFC91, 0, "alarm", ""),
    (0xFD00, 0xFE00, "output_frequency", "0.01Hz"),
    (0xFD01, 0xFE01, "status", ""),
    (0xFD02, 0xFE02, "frequency_command_value", "0.01Hz"),
    (0xFD03, 0xFE03, "output_current", "0.01%"),
    (0xFD04, 0xFE04, "input_voltage", "0.01%"),
    (0xFD05, 0xFE05, "output_voltage", "0.01%"),
    (0xFD06, 0xFE06, "input_terminals", ""),
    (0xFD07, 0xFE07, "output_terminals", ""),
    (0xFD10, 0, "past_trip_5", ""),
    (0xFD11, 0, "past_trip_6", ""),
    (0xFD12, 0, "past_trip_7", ""),
    (0xFD13, 0, "past_trip_8", ""),
    (0xFE08, 0, "cpu_version", ""),
    (0xFE10, 0, "past_trip_1", ""),
    (0xFE11, 0, "past_trip_2", ""),
    (0xFE12, 0, "past_trip_3", ""),
    (0xFE13, 0, "past_trip_4", ""),
    (0xFE14, 0, "cumulative_operation_time", "1h"),
    (0xFD15, 0xFE15, "compensated_frequency", "0.01Hz"),
    (0xFD16, 0xFE16, "estimated_speed", "0.01Hz"),
    (0xFD18, 0xFE18, "torque", "0.01%"),
    (0xFD20, 0xFE20, "torque_current", "0.01%"),
    (0xFD22, 0xFE22, "pid_feedback", "0.01Hz"),
    (0xFD23, 0xFE23, "motor_overload_factor", "0.01%"),
    (0xFD24, 0xFE24, "inverter_overload_factor", "0.01%"),
    (0xFD25, 0xFE25, "braking_resistor_cumulative_load_factor", "1%"),
    (0xFD26, 0xFE26, "motor_load_factor", "1%"),
    (0xFD27, 0xFE27, "inverter_load_factor", "1%"),
    (0xFD28, 0xFE28, "braking_resistor_load_factor", "1%"),
    (0xFD29, 0xFE29, "input_power", "0.01kW"),
    (0xFD30, 0xFE30, "output_power", "0.01kW"),
    (0xFD32, 0, "starts", ""),
    (0xFD33, 0, "forward_starts", ""),
    (0xFD34, 0, "reverse_starts", ""),
    (0xFE35, 0, "via_input", "0.01%"),
    (0xFE36, 0, "vib_input", "0.01%"),
    (0xFE37, 0, "vic_input", "0.01%"),
    (0xFE40, 0, "fm_output", "0.01%"),
    (0xFD40, 0, "pulse_train_output", "1pps"),
    (0xFD41, 0, "cumulative_fan_time", "10h"),
    (0xFD42, 0xFE42, "status_2", ""),
    (0xFD49, 0xFE49, "status_3", ""),
    (0xFE56, 0, "pulse_train_input", "1pps"),
    (0xFE70, 0, "rated_current", "0.1A"),
    (0xFE71, 0, "rated_voltage", "0.1V"),
    (0xFE73, 0, "cpu_version_2", ""),
    (0xFE76, 0, "input_energy", ""),
    (0xFE77, 0, "output_energy", ""),
    (0xFE79, 0, "replacement_alarm", ""),
    (0xFE80, 0, "cumulative_power_on_time", "10h"),
    (0xFD90, 0xFE90, "motor_speed", "1min-1"),
]

# Section 7: number, name, lowest and highest raw value (None: FH), initial raw value, after a reset only.
COMMUNICATION = [
    (0x0800, "baud_rate", 3, 5, 4, True),
    (0x0801, "parity", 0, 2, 1, True),
    (0x0802, "number", 0, 247, 0, False),
    (0x0803, "communication_timeout", 0, 1000, 0, False),
    (0x0804, "timeout_action", 0, 2, 0, False),
    (0x0805, "communication_wait_time", 0, 200, 0, False),
    (0x0806, "master_slave", 0, 4, 0, True),
    (0x0808, "timeout_detection", 0, 2, 1, False),
    (0x0810, "frequency_points", 0, 1, 0, False),
    (0x0811, "point_1_setting", 0, 100, 0, False),
    (0x0812, "point_1_frequency", None, None, 0, False),
    (0x0813, "point_2_setting", 0, 100, 100, False),
    (0x0814, "point_2_frequency", None, None, 6000, False),
    (0x0829, "protocol", 0, 1, 0, True),
    (0x0856, "motor_poles", 1, 8, 2, False),
    (0x0870, "block_write_1", 0, 6, 0, True),
    (0x0871, "block_write_2", 0, 6, 0, True),
    (0x0875, "block_read_1", 0, 14, 0, True),
    (0x0876, "block_read_2", 0, 14, 0, True),
    (0x0877, "block_read_3", 0, 14, 0, True),
    (0x0878, "block_read_4", 0, 14, 0, True),
    (0x0879, "block_read_5", 0, 14, 0, True),
    (0x0880, "free_notes", 0, 65535, 0, False),
]

# Named in the running text: 4.2, 4.3, 4.4, 5.1.3, 6, 8.1, 8.2, 8.3.1, 9.
MENTIONED = {
    0x0000: "automatic_acceleration",
    0x0004: "frequency_mode_selection",
    0x0009: "acceleration_time_1",
    0x0010: "deceleration_time_1",
    0x0094: "overload_characteristic",
    0x0101: "f101",
    0x0102: "f102",
    0x0109: "analog_input_selection",
    0x0110: "f110",
    0x0111: "input_function_1",
    0x0112: "input_function_2",
    0x0113: "input_function_3",
    0x0114: "input_function_4",
    0x0115: "input_function_5",
    0x0116: "input_function_6",
    0x0117: "input_function_7",
    0x0118: "input_function_8",
    0x0130: "output_function_1",
    0x0131: "output_function_2",
    0x0132: "output_function_3",
    0x0170: "f170",
    0x0171: "f171",
    0x0172: "f172",
    0x0173: "f173",
    0x0185: "oc_stall_level_2",
    0x0241: "operation_start_frequency",
    0x0242: "operation_start_hysteresis",
    0x0256: "f256",
    0x0302: "f302",
    0x0500: "acceleration_time_2",
    0x0501: "deceleration_time_2",
    0x0510: "acceleration_time_3",
    0x0511: "deceleration_time_3",
    0x0519: "acceleration_time_unit_selection",
    0x0601: "oc_stall_level_1",
    0x0603: "emergency_stop_selection",
    0x0700: "write_protection",
    0x0710: "standard_monitor",
    0x0738: "password",
    0x0749: "energy_unit",
}

# Section 8.3.2.
KEYS = dict(enumerate(("run", "stop", "up", "down", "mode", "enter", "easy", "local_remote")))

# Section 8.2: code in hexadecimal, as the panel shows it.
TRIPS = (
    "0 nerr 1 oc1 2 oc2 3 oc3 4 ocl 5 oca 8 ephi 9 epho A op1 B op2 C op3 D ol1 E ol2 F olr 10 oh 11 e 12 eep1 "
    "13 eep2 14 eep3 15 err2 16 err3 17 err4 18 err5 1A err7 1B err8 1C err9 1D uc 1E up1 20 ot 22 ef2 28 etn "
    "29 etyp 2D e-13 2E oh2 2F sout 32 e-18 33 e-19 34 e-20 35 e-21 37 e-23 3A e-26 3B prf 3E ol3 40 e-32 41 ot2 "
    "45 e-37 54 etn1 55 etn2 56 etn3"
)

# Appendix 3: type and form, FB05 in hexadecimal.
CAPACITIES = """
    VFMB1S-2002PL 19  VFMB1S-2004PL 1A  VFMB1S-2007PL 1C  VFMB1S-2015PL 1E  VFMB1S-2022PL 1F
    VFMB1-4004PL 22   VFMB1-4007PL 24   VFMB1-4015PL 26   VFMB1-4022PL 27   VFMB1-4037PL 29
    VFMB1-4055PL 2A   VFMB1-4075PL 2B   VFMB1-4110PL 2C   VFMB1-4150PL 2D
"""


@pytest.fixture(scope="module")
def mb1() -> Model:
    """Return the built-in model."""
    return load()["vf-mb1"]


def test_every_number_of_the_manual_is_there_and_no_other(mb1: Model) -> None:
    """Compare all numbers and names with the tables typed from the manual."""
    expected = {number: name for number, name, *_ in COMMANDS} | MENTIONED
    expected |= {number: name for number, name, *_ in COMMUNICATION}
    for number, held, name, _ in MONITORS:
        expected[number] = name
        if held:
            expected[held] = f"trip_{name}"
    assert {r.address: r.name for r in mb1.registers.values()} == expected
    assert len(expected) == 27 + 57 + 24 + 23 + 40


@pytest.mark.parametrize(("number", "name", "storage", "low", "high", "initial"), COMMANDS)
def test_commands_are_writable_and_stored_as_the_manual_says(
    mb1: Model, number: int, name: str, storage: str, low: int | None, high: int | None, initial: int
) -> None:
    """Compare range, initial value and the EEPROM column; all commands may be written while running."""
    register = mb1.registers[name]
    assert (register.address, register.storage.value) == (number, storage)
    assert (register.minimum, register.maximum, register.initial) == (low, high, initial)
    assert (register.kind, register.is_writable, register.writable_while_running) == (Kind.COMMAND, True, True)


@pytest.mark.parametrize(("number", "held", "name", "unit"), MONITORS)
def test_monitors_are_read_only_and_in_the_unit_of_the_table(
    mb1: Model, number: int, held: int, name: str, unit: str
) -> None:
    """Compare the unit column, for the current value and for the one held at a trip."""
    for register in [mb1.registers[name]] + ([mb1.registers[f"trip_{name}"]] if held else []):
        assert (register.is_writable, register.storage) == (False, Storage.NONE)
        shown = f"{register.scaling.scale}{register.unit}" if register.unit else ""
        assert shown == unit
    if held:
        assert mb1.registers[f"trip_{name}"].kind is Kind.TRIP_HELD
        assert mb1.registers[f"trip_{name}"].bits == mb1.registers[name].bits


@pytest.mark.parametrize(("number", "name", "low", "high", "initial", "after_reset"), COMMUNICATION)
def test_communication_parameters_have_the_range_and_default_of_the_table(
    mb1: Model, number: int, name: str, low: int | None, high: int | None, initial: int, after_reset: bool
) -> None:
    """Compare section 7; all of them are stored in the EEPROM."""
    register = mb1.registers[name]
    assert (register.address, register.minimum, register.maximum) == (number, low, high)
    assert (register.initial, register.takes_effect_after_reset) == (initial, after_reset)
    assert (register.kind, register.storage) == (Kind.PARAMETER, Storage.EEPROM)


def test_status_and_command_bits_are_those_of_the_manual(mb1: Model) -> None:
    """Compare the tables of FD01 and FA00."""
    status = "failure_output tripped alarm undervoltage motor_2 pid_off acceleration_2 dc_braking jog reverse "
    status += "running coast emergency_stop run_standby standby"
    command = "preset_speed_1 preset_speed_2 preset_speed_3 preset_speed_4 motor_2 pid_off acceleration_2 "
    command += "dc_braking jog reverse run coast emergency_stop fault_reset frequency_priority command_priority"
    assert dict(mb1.registers["status"].bits) == dict(enumerate(status.split()))
    assert dict(mb1.registers["command"].bits) == dict(enumerate(command.split()))


@pytest.mark.parametrize(
    ("name", "unit", "low", "high", "initial"),
    [
        ("automatic_acceleration", "", 0, 2, 0),
        ("overload_characteristic", "", 0, 2, 0),
        ("acceleration_time_1", "0.1s", 0, 36000, 100),
        ("deceleration_time_1", "0.1s", 1, 36000, 1),
        ("acceleration_time_2", "0.1s", 1, 36000, 1),
        ("deceleration_time_2", "0.1s", 1, 36000, 1),
        ("acceleration_time_3", "0.1s", 1, 36000, 1),
        ("deceleration_time_3", "0.1s", 1, 36000, 1),
        ("frequency_mode_selection", "", None, None, 0),
        ("input_function_1", "", None, None, 0),
        ("output_function_1", "", None, None, 0),
        ("standard_monitor", "", None, None, 0),
    ],
)
def test_other_writable_parameters_have_what_the_manual_states(
    mb1: Model, name: str, unit: str, low: int | None, high: int | None, initial: int
) -> None:
    """Range, unit and initial value are there only where the manual states them."""
    register = mb1.registers[name]
    shown = f"{register.scaling.scale}{register.unit}" if register.unit else ""
    assert (shown, register.minimum, register.maximum, register.initial) == (unit, low, high, initial)
    assert (register.kind, register.storage) == (Kind.PARAMETER, Storage.EEPROM)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("communication_timeout", "0.1s"),
        ("communication_wait_time", "0.01s"),
        ("analog_output", "0.1%"),
        ("frequency_command", "0.01Hz"),
        ("panel_frequency", "0.01Hz"),
        ("motor_speed_command", "1min-1"),
        ("point_1_setting", "1%"),
        ("point_2_setting", "1%"),
        ("point_1_frequency", "0.01Hz"),
        ("point_2_frequency", "0.01Hz"),
    ],
)
def test_what_is_written_is_in_the_unit_of_the_table(mb1: Model, name: str, unit: str) -> None:
    """Compare the unit columns of commands and communication parameters."""
    register = mb1.registers[name]
    assert f"{register.scaling.scale}{register.unit}" == unit


@pytest.mark.parametrize(
    ("name", "bits"),
    [
        (
            "command_2",
            {
                1: "energy_reset",
                7: "maximum_deceleration_stop",
                8: "acceleration_select_1",
                9: "acceleration_select_2",
                12: "oc_stall_2",
            },
        ),
        ("command_3", {0: "ry_hold", 1: "out_hold"}),
        ("terminal_output", {0: "data_output_1", 1: "data_output_2"}),
        (
            "status_3",
            {
                0: "ry_hold",
                1: "out_hold",
                10: "constant_speed",
                11: "healthy",
                12: "speed_reached",
                13: "specified_speed_reached",
                14: "accelerating",
                15: "decelerating",
            },
        ),
        (
            "alarm",
            {
                0: "overcurrent",
                1: "inverter_overload",
                2: "motor_overload",
                3: "overheat",
                4: "overvoltage",
                5: "undervoltage",
                6: "device_overheat",
                7: "low_current",
                8: "over_torque",
                9: "braking_resistor_overload",
                10: "operation_time",
                13: "moff",
                14: "blackout_deceleration",
                15: "lower_limit_stop",
            },
        ),
        (
            "replacement_alarm",
            {0: "fan_life", 1: "circuit_board_life", 2: "main_capacitor_life", 3: "user_set"},
        ),
        ("input_terminals", {0: "f", 1: "r", 2: "res", 3: "s1", 4: "s2", 5: "s3", 6: "vib", 7: "via"}),
        ("output_terminals", {0: "ry", 1: "out", 2: "fl"}),
        (
            "status_2",
            {
                7: "maximum_deceleration_stop",
                8: "acceleration_select_1",
                9: "acceleration_select_2",
                12: "oc_stall_2",
            },
        ),
        ("panel_keys", {0: "run", 1: "stop", 2: "up", 3: "down", 4: "mode", 5: "enter", 6: "easy"}),
        ("external_keys", KEYS),
        ("key_state", KEYS),
    ],
)
def test_bits_have_the_names_of_the_manuals_table(mb1: Model, name: str, bits: dict[int, str]) -> None:
    """Compare the tables of VF-MB1 RS485 8.1-8.2, bit by bit."""
    assert dict(mb1.registers[name].bits) == bits


@pytest.mark.hazard("H20")
@pytest.mark.parametrize(
    ("name", "mask"),
    [
        ("status", 0x7FFF),
        ("command_2", 0x1382),
        ("command_3", 0x0003),
        ("terminal_output", 0x0003),
        ("status_2", 0x1380),
        ("status_3", 0xFC03),
        ("alarm", 0xE7FF),
        ("replacement_alarm", 0x000F),
        ("input_terminals", 0x00FF),
        ("output_terminals", 0x0007),
        ("external_keys", 0x00FF),
        ("key_state", 0x00FF),
        ("panel_keys", 0x007F),
    ],
)
def test_undefined_bits_are_masked(mb1: Model, name: str, mask: int) -> None:
    """Undefined bits are unstable (VF-MB1 RS485 8.2): the mask keeps the defined ones."""
    assert mb1.registers[name].mask == mask
    assert mb1.registers[name].decode(0xFFFF) == mask


def test_terminals_have_the_names_on_the_terminal_board(mb1: Model) -> None:
    """FE06 = 0005H says F and RES, FE07 = 0005H says RY and FL (8.2)."""
    assert mb1.registers["trip_input_terminals"].text(0x0005) == "f, res"
    assert mb1.registers["trip_output_terminals"].text(0x0005) == "ry, fl"


def test_trip_codes_are_those_of_the_manual(mb1: Model) -> None:
    """Compare codes and short names; FC90, FE10-FE13 and FD10-FD13 share them."""
    words = TRIPS.split()
    expected = {int(code, 16): name for code, name in zip(words[::2], words[1::2], strict=True)}
    for name in ("trip_code", *(f"past_trip_{i}" for i in range(1, 9))):
        enumeration = mb1.registers[name].enumeration
        assert enumeration is not None
        assert dict(enumeration.names) == expected
        assert all(enumeration.texts.values())
    assert len(expected) == 49


def test_capacities_are_those_of_the_manual(mb1: Model) -> None:
    """Compare Appendix 3."""
    words = CAPACITIES.split()
    expected = {int(code, 16): form for form, code in zip(words[::2], words[1::2], strict=True)}
    assert dict(mb1.capacities) == expected
    assert len(expected) == 14


def test_selectors_name_the_numbers_of_the_manual(mb1: Model) -> None:
    """F875-F879 take 0-14, F870 and F871 take 0-6."""
    read = [0, 0xFD01, 0xFD00, 0xFD03, 0xFD05, 0xFC91, 0xFD22, 0xFD06, 0xFD07]
    read += [0xFE35, 0xFE36, 0xFE37, 0xFD04, 0xFE90, 0xFD18]
    write = [0, 0xFA00, 0xFA20, 0xFA01, 0xFA50, 0xFA51, 0xFA13]
    for selectors, numbers in ((mb1.read_selectors, read), (mb1.write_selectors, write)):
        found = {code: mb1.registers[name].address if name else 0 for code, name in selectors.items()}
        assert found == dict(enumerate(numbers))


def test_the_block_forms_and_times_are_those_of_the_manual(mb1: Model) -> None:
    """Compare 4.1.3, 5.1.2-5.1.6 and Appendix 2: 10 ms, 50 ms for the EEPROM, deaf for a second."""
    blocks = mb1.blocks
    assert (blocks.indirect_read_address, blocks.indirect_write_address) == (0x1875, 0x1870)
    assert (blocks.indirect_read_minimum, blocks.indirect_read_maximum) == (2, 5)
    assert (blocks.indirect_write_words, blocks.direct_read_maximum, blocks.has_exchange) == (2, 8, True)
    assert blocks.direct_ranges == ((0x0000, 0x0999),)
    assert (mb1.times.processing, mb1.times.eeprom, mb1.times.start_up) == (0.010, 0.050, 1.0)
    assert (mb1.identity, mb1.series_code) == ("VFMB1", None)


def test_the_connector_names_its_parameters(mb1: Model) -> None:
    """Roles lead to the numbers of section 7."""
    connector = mb1.connector("rs485")
    assert connector is not None
    numbers = {role: mb1.registers[name].address for role, name in connector.parameters.items()}
    assert numbers == {
        "baud_rate": 0x0800,
        "parity": 0x0801,
        "number": 0x0802,
        "timeout": 0x0803,
        "timeout_action": 0x0804,
        "wait_time": 0x0805,
        "master_slave": 0x0806,
        "timeout_detection": 0x0808,
        "protocol": 0x0829,
    }
    assert [mb1.registers[name].address for name in connector.block_write] == [0x0870, 0x0871]
    assert [mb1.registers[name].address for name in connector.block_read] == [*range(0x0875, 0x087A)]


@pytest.mark.parametrize(
    ("name", "word", "text"),
    [
        ("output_frequency", 0x1770, "60.00"),
        ("trip_output_current", 0x077B, "19.15"),
        ("output_voltage", 0x26FF, "99.83"),
        ("vib_input", 0xD8F0, "-100.00"),
        ("vib_input", 0x2710, "100.00"),
        ("vib_input", 0xFFFF, "-0.01"),
        ("via_input", 0x2710, "100.00"),
        ("motor_speed", 0x0708, "1800"),
        ("motor_speed_command", 0x0708, "1800"),
        ("acceleration_time_1", 0x0064, "10.0"),
        ("cumulative_power_on_time", 0x0003, "30"),
        ("cumulative_fan_time", 0x0003, "30"),
        ("starts", 0x0002, "2000"),
        ("point_2_frequency", 0x1770, "60.00"),
    ],
)
def test_the_values_of_the_examples_decode_as_the_manual_says(mb1: Model, name: str, word: int, text: str) -> None:
    """Decode the words of the worked examples, and encode them back."""
    register = mb1.registers[name]
    assert register.format(word) == text
    assert register.encode(Decimal(text)) == word


def test_the_analog_inputs_differ_in_sign(mb1: Model) -> None:
    """VIB reaches from -100 to 100 %, VIA and VIC from 0 (8.2)."""
    limits = {name: (mb1.registers[name].minimum, mb1.registers[name].maximum) for name in mb1.registers}
    assert limits["vib_input"] == (-10000, 10000)
    assert limits["via_input"] == limits["vic_input"] == (0, 10000)
    assert not mb1.registers["via_input"].scaling.signed


@pytest.mark.hazard("H31")
@pytest.mark.parametrize("speed", ["24001", "-1", "0.5"])
def test_a_motor_speed_outside_its_range_is_refused(mb1: Model, speed: str) -> None:
    """FA13 takes 0 to 24000 min-1, whole ones."""
    with pytest.raises(OutOfRange):
        mb1.registers["motor_speed_command"].encode(Decimal(speed))


def test_fmod_for_rs485_is_4_here(mb1: Model) -> None:
    """Sections 6 and 8.1 say 4; the 3 in 8.1 is that of the VF-nC3."""
    assert mb1.registers["frequency_mode_selection"].text(4) == "RS485 communication"
    assert mb1.registers["frequency_mode_selection"].text(3) == "unknown code 3"


def test_motor_poles_are_coded(mb1: Model) -> None:
    """F856 = 2 stands for 4 poles, 8 for 16."""
    assert [mb1.registers["motor_poles"].text(code) for code in range(1, 9)] == [
        f"{2 * i} poles" for i in range(1, 9)
    ]


@pytest.mark.parametrize(
    ("name", "codes"),
    [
        ("input_function_8", [0, 20, 21, 48, 49, 52, 53]),
        ("output_function_2", [10, 92, 93, 94, 95]),
        ("write_protection", [2, 4]),
        ("energy_unit", [0, 1, 2, 3]),
        ("timeout_action", [0, 1, 2]),
        ("timeout_detection", [0, 1, 2]),
        ("master_slave", [0, 1, 2, 3, 4]),
    ],
)
def test_parameters_have_the_codes_of_the_manual(mb1: Model, name: str, codes: list[int]) -> None:
    """The codes that the manual names, and no other."""
    enumeration = mb1.registers[name].enumeration
    assert enumeration is not None
    assert sorted(enumeration.texts) == codes


def test_the_time_unit_0999_is_never_written(mb1: Model) -> None:
    """The manual forbids to write 0999; F519 sets it."""
    assert not mb1.registers["acceleration_time_unit"].is_writable
    assert mb1.registers["acceleration_time_unit"].text(2) == "0.1 s"


@pytest.mark.parametrize("name", ["input_energy", "output_energy"])
def test_an_energy_whose_unit_is_a_setting_is_shown_in_counts(mb1: Model, name: str) -> None:
    """FE76 and FE77 count 0.1 to 100 kWh as F749 says: no unit is claimed for them."""
    assert mb1.registers[name].unit == ""
    assert mb1.registers[name].format(0x0010) == "16"
    assert mb1.registers["energy_unit"].text(0) == "0.1 kWh"


def test_trip_codes_of_this_model_have_their_texts(mb1: Model) -> None:
    """Err5 as in all models, Err9 only here."""
    assert mb1.registers["trip_code"].text(0x18) == "err5: Communication time-out error"
    assert mb1.registers["past_trip_8"].text(0x1C) == "err9: Remote keypad disconnected"


def test_amperes_and_volts_are_derived_from_the_ratings(mb1: Model) -> None:
    """Percentages of FE70 and FE71, now and at a trip."""
    assert {d.name: (d.of, d.base, d.unit) for d in mb1.derived} == {
        "output_current_amps": ("output_current", "rated_current", "A"),
        "output_voltage_volts": ("output_voltage", "rated_voltage", "V"),
        "input_voltage_volts": ("input_voltage", "rated_voltage", "V"),
        "trip_output_current_amps": ("trip_output_current", "rated_current", "A"),
        "trip_output_voltage_volts": ("trip_output_voltage", "rated_voltage", "V"),
        "trip_input_voltage_volts": ("trip_input_voltage", "rated_voltage", "V"),
    }


def test_the_fast_group_of_the_profile_fits_the_block_selectors(mb1: Model) -> None:
    """Five values that selectors can carry, so one exchange reads them all."""
    fast, every = mb1.profile[0]
    assert every == "200ms"
    assert list(fast) == ["status", "output_frequency", "output_current", "output_voltage", "alarm"]
    assert set(fast) <= set(mb1.read_selectors.values())


def test_every_entry_cites_the_manual(mb1: Model) -> None:
    """The source says which section an entry was written from, and the title what it is."""
    assert all(r.source.startswith("VF-MB1 RS485 ") for r in mb1.registers.values())
    assert all(r.title for r in mb1.registers.values())
