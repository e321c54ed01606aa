"""VF-nC3 as its manual E6581657 prints it: the tables typed from the pages, and the values of its examples."""

from __future__ import annotations

from decimal import Decimal

import pytest

from gateway.drives.catalogue import load
from gateway.drives.model import Model
from gateway.drives.register import Kind, Storage

# Section 8, "Commands": number, name, writes go to, lowest and highest (None: of FH, LL, UL) and initial raw value.
COMMANDS = [
    (0xFA00, "command", "ram", 0, 65535, 0),
    (0xFA01, "frequency_command", "ram", None, None, 0),
    (0xFA03, "panel_frequency", "eeprom", None, None, 0),
    (0xFA10, "panel_key_selection", "ram", 0, 1, 0),
    (0xFA11, "external_keys", "ram", 0, 65535, 0),
    (0xFA20, "command_2", "ram", 0, 65535, 0),
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

# Section 8, "Monitor parameters": current value, trip data held (0: none), name, unit of one count.
MONITORS = [
    (0xFB05, 0, "capacity_code", ""),
    (0xFB07, 0, "series_code", ""),
    (0xFC00, 0, "key_state", ""),
    (0xFC01, 0, "panel_keys", ""),
    (0xFC90, 0, "trip_code", ""),
    (0xFC91, 0, "alarm", ""),
    (0xFC92, 0, "alarm_2", ""),
    (0xFD00, 0xFE00, "output_frequency", "0.01Hz"),
    (0xFD01, 0xFE01, "status", ""),
    (0xFD02, 0xFE02, "frequency_command_value", "0.01Hz"),
    (0xFD03, 0xFE03, "output_current", "0.01%"),
    (0xFD04, 0xFE04, "input_voltage", "0.01%"),
    (0xFD05, 0xFE05, "output_voltage", "0.01%"),
    (0xFD06, 0xFE06, "input_terminals", ""),
    (0xFD07, 0xFE07, "output_terminals", ""),
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
    (0xFD26, 0xFE26, "motor_load_factor", "1%"),
    (0xFD27, 0xFE27, "inverter_load_factor", "1%"),
    (0xFD29, 0xFE29, "input_power", "0.01kW"),
    (0xFD30, 0xFE30, "output_power", "0.01kW"),
    (0xFE35, 0, "vi_input", "0.01%"),
    (0xFD42, 0xFE42, "status_2", ""),
    (0xFD45, 0xFE45, "command_mode", ""),
    (0xFD46, 0xFE46, "frequency_mode", ""),
    (0xFD49, 0xFE49, "status_3", ""),
    (0xFE70, 0, "rated_current", "0.1A"),
    (0xFE71, 0, "rated_voltage", "0.1V"),
    (0xFE73, 0, "cpu_version_2", ""),
    (0xFE79, 0, "replacement_alarm", ""),
    (0xFE80, 0, "cumulative_power_on_time", "1h"),
]

# Section 6: number, name, lowest and highest raw value, initial raw value, in force after a reset only.
COMMUNICATION = [
    (0x0800, "baud_rate", 3, 5, 4, True),
    (0x0801, "parity", 0, 2, 1, True),
    (0x0802, "number", 0, 247, 0, False),
    (0x0803, "communication_timeout", 0, 1000, 0, False),
    (0x0804, "timeout_action", 0, 2, 0, False),
    (0x0805, "communication_wait_time", 0, 200, 0, False),
    (0x0808, "timeout_detection", 0, 2, 1, False),
    (0x0829, "protocol", 0, 1, 0, True),
    (0x0870, "block_write_1", 0, 5, 0, True),
    (0x0871, "block_write_2", 0, 5, 0, True),
    (0x0875, "block_read_1", 0, 9, 0, True),
    (0x0876, "block_read_2", 0, 9, 0, True),
    (0x0877, "block_read_3", 0, 9, 0, True),
    (0x0878, "block_read_4", 0, 9, 0, True),
    (0x0879, "block_read_5", 0, 9, 0, True),
    (0x0880, "free_notes", 0, 65535, 0, False),
]

# Named in the running text: 4.2, 4.3, 4.4, 5.1.3, 7.1, 7.2, 7.3.1, 8.
MENTIONED = {
    0x0000: "automatic_acceleration",
    0x0004: "frequency_mode_selection",
    0x0009: "acceleration_time_1",
    0x0010: "deceleration_time_1",
    0x0101: "f101",
    0x0102: "f102",
    0x0109: "analog_input_selection",
    0x0110: "f110",
    0x0111: "input_function_1",
    0x0112: "input_function_2",
    0x0113: "input_function_3",
    0x0114: "input_function_4",
    0x0115: "input_function_5",
    0x0130: "output_function_1",
    0x0132: "output_function_3",
    0x0170: "f170",
    0x0171: "f171",
    0x0172: "f172",
    0x0173: "f173",
    0x0185: "oc_stall_level_2",
    0x0256: "f256",
    0x0302: "f302",
    0x0500: "acceleration_time_2",
    0x0501: "deceleration_time_2",
    0x0601: "oc_stall_level_1",
    0x0615: "f615",
    0x0619: "f619",
    0x0621: "f621",
    0x0648: "f648",
    0x0700: "write_protection",
    0x0710: "standard_monitor",
    0x0738: "password",
}

# Section 7.3.2.
KEYS = dict(enumerate(("run", "stop", "up", "down", "mode", "enter", "easy", "local_remote")))

# Section 7.2: code in hexadecimal, as the panel shows it.
TRIPS = (
    "0 nerr 1 oc1 2 oc2 3 oc3 4 ocl 5 oca 8 ephi 9 epho A op1 B op2 C op3 D ol1 E ol2 F olr 10 oh 11 e 12 eep1 "
    "13 eep2 14 eep3 15 err2 16 err3 17 err4 18 err5 1A err7 1B err8 1D uc 1E up1 20 ot 22 ef2 28 etn 29 etyp "
    "2A e-10 2D e-13 2E oh2 32 e-18 33 e-19 34 e-20 35 e-21 3A e-26 3E ol3 51 e-49 52 e-50 53 e-51 54 etn1"
)

# Appendix 3: type and form, FB05 in hexadecimal.
CAPACITIES = """
    VFnC3S-1001P C    VFnC3S-1002P D    VFnC3S-1004P E    VFnC3S-1007P F
    VFnC3S-2001PL 18  VFnC3S-2002PL 19  VFnC3S-2004PL 1A  VFnC3S-2007PL 1C  VFnC3S-2015PL 1E  VFnC3S-2022PL 1F
    VFnC3-2001P 0     VFnC3-2002P 1     VFnC3-2004P 2     VFnC3-2007P 4     VFnC3-2015P 6     VFnC3-2022P 7
    VFnC3-2037P 9
"""


@pytest.fixture(scope="module")
def nc3() -> Model:
    """Return the built-in model."""
    return load()["vf-nc3"]


def names_of_bits(model: Model, name: str) -> dict[int, str]:
    """Return a register's bits."""
    return dict(model.registers[name].bits)


def test_every_number_of_the_manual_is_there_and_no_other(nc3: Model) -> None:
    """Compare all numbers and names with the tables typed from the manual."""
    expected = {number: name for number, name, *_ in COMMANDS} | MENTIONED
    expected |= {number: name for number, name, *_ in COMMUNICATION}
    for number, held, name, _ in MONITORS:
        expected[number] = name
        if held:
            expected[held] = f"trip_{name}"
    assert {r.address: r.name for r in nc3.registers.values()} == expected
    assert len(expected) == 24 + 42 + 23 + 16 + 32


@pytest.mark.parametrize(("number", "name", "storage", "low", "high", "initial"), COMMANDS)
def test_commands_are_writable_and_stored_as_the_manual_says(
    nc3: Model, number: int, name: str, storage: str, low: int | None, high: int | None, initial: int
) -> None:
    """Compare range, initial value and the EEPROM column; all commands may be written while running."""
    register = nc3.registers[name]
    assert (register.address, register.storage.value) == (number, storage)
    assert (register.minimum, register.maximum, register.initial) == (low, high, initial)
    assert (register.kind, register.is_writable, register.writable_while_running) == (Kind.COMMAND, True, True)


@pytest.mark.parametrize(("number", "held", "name", "unit"), MONITORS)
def test_monitors_are_read_only_and_in_the_unit_of_the_table(
    nc3: Model, number: int, held: int, name: str, unit: str
) -> None:
    """Compare the unit column, for the current value and for the one held at a trip."""
    for register in [nc3.registers[name]] + ([nc3.registers[f"trip_{name}"]] if held else []):
        assert (register.is_writable, register.storage) == (False, Storage.NONE)
        shown = f"{register.scaling.scale}{register.unit}" if register.unit else ""
        assert shown == unit
    if held:
        assert nc3.registers[f"trip_{name}"].kind is Kind.TRIP_HELD
        assert nc3.registers[f"trip_{name}"].bits == nc3.registers[name].bits


@pytest.mark.parametrize(("number", "name", "low", "high", "initial", "after_reset"), COMMUNICATION)
def test_communication_parameters_have_the_range_and_default_of_the_table(
    nc3: Model, number: int, name: str, low: int, high: int, initial: int, after_reset: bool
) -> None:
    """Compare section 6; all of them are stored in the EEPROM."""
    register = nc3.registers[name]
    assert (register.address, register.minimum, register.maximum) == (number, low, high)
    assert (register.initial, register.takes_effect_after_reset) == (initial, after_reset)
    assert (register.kind, register.storage) == (Kind.PARAMETER, Storage.EEPROM)


def test_the_status_bits_are_those_of_the_manual(nc3: Model) -> None:
    """Compare FD01's table; bit 15 is undefined."""
    names = "failure_output tripped alarm undervoltage motor_2 pid_off acceleration_2 dc_braking jog reverse "
    names += "running coast emergency_stop run_standby standby"
    assert names_of_bits(nc3, "status") == dict(enumerate(names.split()))
    assert nc3.registers["status"].mask == 0x7FFF


def test_the_command_bits_are_those_of_the_manual(nc3: Model) -> None:
    """Compare FA00's table, all 16 bits."""
    names = "preset_speed_1 preset_speed_2 preset_speed_3 preset_speed_4 motor_2 pid_off acceleration_2 "
    names += "dc_braking jog reverse run coast emergency_stop fault_reset frequency_priority command_priority"
    assert names_of_bits(nc3, "command") == dict(enumerate(names.split()))


@pytest.mark.parametrize(
    ("name", "unit", "low", "high", "initial"),
    [
        ("automatic_acceleration", "", 0, 2, 0),
        ("acceleration_time_1", "0.1s", 0, 30000, 100),
        ("deceleration_time_1", "0.1s", None, None, 0),
        ("frequency_mode_selection", "", None, None, 0),
        ("input_function_1", "", None, None, 0),
        ("output_function_1", "", None, None, 0),
        ("standard_monitor", "", None, None, 0),
    ],
)
def test_other_writable_parameters_have_what_the_manual_states(
    nc3: Model, name: str, unit: str, low: int | None, high: int | None, initial: int
) -> None:
    """Range, unit and initial value are there only where the manual states them."""
    register = nc3.registers[name]
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
    ],
)
def test_what_is_written_is_in_the_unit_of_the_table(nc3: Model, name: str, unit: str) -> None:
    """Compare the unit columns of commands and communication parameters."""
    register = nc3.registers[name]
    assert f"{register.scaling.scale}{register.unit}" == unit


@pytest.mark.parametrize(
    ("name", "bits"),
    [
        ("command_2", {7: "maximum_deceleration_stop", 12: "oc_stall_2"}),
        ("terminal_output", {0: "data_output_1"}),
        ("status_2", {7: "maximum_deceleration_stop", 8: "acceleration_2", 12: "oc_stall_2"}),
        (
            "status_3",
            {
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
                10: "operation_time",
                13: "moff",
                14: "blackout_deceleration",
                15: "lower_limit_stop",
            },
        ),
        ("alarm_2", {2: "life_time", 3: "over_torque", 4: "overload_stall", 7: "upper_limit_frequency"}),
        (
            "replacement_alarm",
            {0: "fan_life", 1: "circuit_board_life", 2: "main_capacitor_life", 3: "operation_time"},
        ),
        ("input_terminals", {0: "f", 1: "r", 2: "s1", 3: "s2", 4: "vi"}),
        ("output_terminals", {0: "out", 2: "fl"}),
        ("panel_keys", {0: "run", 1: "stop", 2: "up", 3: "down", 4: "mode", 5: "enter", 6: "easy"}),
        ("external_keys", KEYS),
        ("key_state", KEYS | {15: "keys_normal"}),
    ],
)
def test_bits_have_the_names_of_the_manuals_table(nc3: Model, name: str, bits: dict[int, str]) -> None:
    """Compare the tables of E6581657 7.1-7.3, bit by bit."""
    assert dict(nc3.registers[name].bits) == bits


@pytest.mark.hazard("H20")
@pytest.mark.parametrize(
    ("name", "mask"),
    [
        ("command_2", 0x1080),
        ("terminal_output", 0x0001),
        ("status_2", 0x1180),
        ("status_3", 0xFC00),
        ("alarm", 0xE4FF),
        ("alarm_2", 0x009C),
        ("replacement_alarm", 0x000F),
        ("input_terminals", 0x001F),
        ("output_terminals", 0x0005),
        ("external_keys", 0x00FF),
        ("key_state", 0x80FF),
        ("panel_keys", 0x007F),
    ],
)
def test_undefined_bits_are_masked(nc3: Model, name: str, mask: int) -> None:
    """Undefined bits are unstable (E6581657 7.2): the mask keeps the defined ones."""
    register = nc3.registers[name]
    assert register.mask == mask
    assert register.decode(0xFFFF) == mask


def test_trip_codes_are_those_of_the_manual(nc3: Model) -> None:
    """Compare codes and short names; FC90 and FE10-FE13 share them."""
    words = TRIPS.split()
    expected = {int(code, 16): name for code, name in zip(words[::2], words[1::2], strict=True)}
    for name in ("trip_code", "past_trip_1", "past_trip_2", "past_trip_3", "past_trip_4"):
        enumeration = nc3.registers[name].enumeration
        assert enumeration is not None
        assert dict(enumeration.names) == expected
        assert all(enumeration.texts.values())
    assert len(expected) == 44


def test_capacities_are_those_of_the_manual(nc3: Model) -> None:
    """Compare Appendix 3."""
    words = CAPACITIES.split()
    expected = {int(code, 16): form for form, code in zip(words[::2], words[1::2], strict=True)}
    assert dict(nc3.capacities) == expected
    assert len(expected) == 17


def test_selectors_name_the_numbers_of_the_manual(nc3: Model) -> None:
    """F875-F879 take 0-9 (9 is FE35, not the misprinted FE36), F870 and F871 take 0-5."""
    read = [0, 0xFD01, 0xFD00, 0xFD03, 0xFD05, 0xFC91, 0xFD22, 0xFD06, 0xFD07, 0xFE35]
    write = [0, 0xFA00, 0xFA20, 0xFA01, 0xFA50, 0xFA51]
    for selectors, numbers in ((nc3.read_selectors, read), (nc3.write_selectors, write)):
        found = {code: nc3.registers[name].address if name else 0 for code, name in selectors.items()}
        assert found == dict(enumerate(numbers))
    assert nc3.at(0xFE36) is None


def test_modes_and_parameters_have_the_codes_of_the_manual(nc3: Model) -> None:
    """Compare FD45, FD46, F804, F808, FMOD; RS485 is 3 in FMOD of this family."""
    codes = {name: nc3.registers[name].enumeration for name in nc3.registers}
    expected = {
        "command_mode": [0, 1, 2],
        "frequency_mode": [0, 1, 2, 3, 5, 255],
        "timeout_action": [0, 1, 2],
        "timeout_detection": [0, 1, 2],
        "baud_rate": [3, 4, 5],
        "frequency_mode_selection": [3],
        "input_function_1": [0, 20, 21, 48, 49],
        "output_function_3": [10, 92, 93],
    }
    for name, numbers in expected.items():
        enumeration = codes[name]
        assert enumeration is not None
        assert sorted(enumeration.texts) == numbers
    assert nc3.registers["frequency_mode_selection"].text(3) == "RS485 communication"
    assert nc3.registers["timeout_action"].text(2) == "Trip, slow-down stop"


def test_the_block_forms_and_times_are_those_of_the_manual(nc3: Model) -> None:
    """Compare 4.1.3, 5.1.2-5.1.6 and Appendix 2: 15 ms, 50 ms for the EEPROM, deaf for a second."""
    blocks = nc3.blocks
    assert (blocks.indirect_read_address, blocks.indirect_write_address) == (0x1875, 0x1870)
    assert (blocks.indirect_read_minimum, blocks.indirect_read_maximum) == (2, 5)
    assert (blocks.indirect_write_words, blocks.direct_read_maximum, blocks.has_exchange) == (2, 8, True)
    assert blocks.direct_ranges == ((0x0000, 0x0999),)
    assert (nc3.times.processing, nc3.times.eeprom, nc3.times.start_up) == (0.015, 0.050, 1.0)
    assert (nc3.identity, nc3.series_code) == ("VFnC3", 208)


def test_the_connector_names_its_parameters(nc3: Model) -> None:
    """Roles lead to the numbers of section 6."""
    connector = nc3.connector()
    assert connector is not None
    numbers = {role: nc3.registers[name].address for role, name in connector.parameters.items()}
    assert numbers == {
        "baud_rate": 0x0800,
        "parity": 0x0801,
        "number": 0x0802,
        "timeout": 0x0803,
        "timeout_action": 0x0804,
        "wait_time": 0x0805,
        "timeout_detection": 0x0808,
        "protocol": 0x0829,
    }
    assert [nc3.registers[name].address for name in connector.block_write] == [0x0870, 0x0871]
    assert [nc3.registers[name].address for name in connector.block_read] == [*range(0x0875, 0x087A)]


@pytest.mark.parametrize(
    ("name", "word", "text"),
    [
        ("output_frequency", 0x1770, "60.00"),
        ("output_frequency", 0x1F40, "80.00"),
        ("trip_output_current", 0x077B, "19.15"),
        ("output_current", 0x1388, "50.00"),
        ("output_current", 0x2328, "90.00"),
        ("output_current", 0x1A8A, "67.94"),
        ("output_voltage", 0x24FD, "94.69"),
        ("output_voltage", 0x26FF, "99.83"),
        ("vi_input", 0x2710, "100.00"),
        ("frequency_command", 0x1F40, "80.00"),
        ("deceleration_time_1", 0x0064, "10.0"),
        ("communication_timeout", 0x03E8, "100.0"),
        ("cumulative_operation_time", 0x0100, "256"),
    ],
)
def test_the_values_of_the_examples_decode_as_the_manual_says(nc3: Model, name: str, word: int, text: str) -> None:
    """Decode the words of the worked examples, and encode them back."""
    register = nc3.registers[name]
    assert register.format(word) == text
    assert register.encode(Decimal(text)) == word


@pytest.mark.hazard("H20")
def test_a_status_with_an_undefined_bit_is_the_one_without(nc3: Model) -> None:
    """E404H and 6400H are printed for the same 60 Hz: bit 15 is undefined."""
    status = nc3.registers["status"]
    assert status.decode(0xE404) == 0x6404
    assert status.text(0xE404) == "alarm, running, run_standby, standby"
    assert status.text(0x6400) == "running, run_standby, standby"
    assert status.text(0x0003) == "failure_output, tripped"


def test_the_example_commands_say_what_they_do(nc3: Model) -> None:
    """C400H, 8600H, 9000H of 7.1 and 4.2 in words."""
    command = nc3.registers["command"]
    assert command.text(0xC400) == "run, frequency_priority, command_priority"
    assert command.text(0x8600) == "reverse, run, command_priority"
    assert command.text(0x9000) == "emergency_stop, command_priority"


def test_trip_code_18_is_the_communication_time_out(nc3: Model) -> None:
    """4.5 reads 0018H when the drive is tripped by Err5."""
    assert nc3.registers["trip_code"].text(0x0018) == "err5: Communication time-out error"
    assert nc3.registers["trip_code"].text(0x0007) == "unknown code 7"


@pytest.mark.parametrize("name", ["torque", "torque_current", "trip_torque", "trip_torque_current"])
def test_a_braking_torque_is_negative(nc3: Model, name: str) -> None:
    """Negative numbers are two's complement, whatever the manual calls them."""
    assert nc3.registers[name].format(0xFC18) == "-10.00"


def test_amperes_and_volts_are_derived_from_the_ratings(nc3: Model) -> None:
    """The example of 7.2: 50 % of 4.8 A are 2.4 A."""
    derived = {d.name: d for d in nc3.derived}
    bases = {name: (d.of, d.base, d.unit) for name, d in derived.items()}
    assert bases["output_current_amps"] == ("output_current", "rated_current", "A")
    assert bases["output_voltage_volts"] == ("output_voltage", "rated_voltage", "V")
    assert bases["input_voltage_volts"] == ("input_voltage", "rated_voltage", "V")
    assert bases["trip_output_current_amps"] == ("trip_output_current", "rated_current", "A")
    assert len(bases) == 6
    percent, rated = nc3.registers["output_current"].decode(0x1388), nc3.registers["rated_current"].decode(48)
    assert percent * rated / 100 == Decimal("2.4")


def test_the_fast_group_of_the_profile_fits_the_block_selectors(nc3: Model) -> None:
    """Five values that selectors can carry, so one exchange reads them all."""
    fast, every = nc3.profile[0]
    assert every == "200ms"
    assert list(fast) == ["status", "output_frequency", "output_current", "output_voltage", "alarm"]
    assert len(fast) == nc3.blocks.indirect_read_maximum
    assert set(fast) <= set(nc3.read_selectors.values())


def test_every_entry_cites_the_manual(nc3: Model) -> None:
    """The source says which section an entry was written from, and the title what it is."""
    assert all(r.source.startswith("E6581657 ") for r in nc3.registers.values())
    assert all(r.title for r in nc3.registers.values())
