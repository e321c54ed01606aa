"""What the monitor and status registers of a drive read, computed from its condition (E6581657 7.2, 8)."""

from __future__ import annotations

from collections.abc import Callable

from gateway.sim.condition import Condition, TripCode
from gateway.sim.operation import (
    COAST,
    DC_BRAKING,
    EMERGENCY_STOP,
    JOG,
    MOTOR_2,
    PID_OFF,
    REVERSE,
    RUN,
    Operation,
    Source,
    poles,
)

FL_OUTPUT = 1 << 0
TRIPPED = 1 << 1
ALARM = 1 << 2
PATTERN_2 = 1 << 6
READY_AND_RUNNING = 1 << 13
READY = 1 << 14
STATUS_OF_COMMAND = MOTOR_2 | PID_OFF | DC_BRAKING | JOG  # bits that stand at the same place in FA00 and FD01

CONSTANT_SPEED = 1 << 10
HEALTHY = 1 << 11
RAMP_COMPLETE = 1 << 12
ACCELERATING = 1 << 14
DECELERATING = 1 << 15

KEYS_NORMAL = 1 << 15  # FC00 (E6581657 7.3.2)
FL_TERMINAL = 1 << 2
TERMINAL_FUNCTIONS = {92: (0, 0), 93: (0, 1), 94: (1, 0), 95: (1, 1)}  # F130, F131: bit of FA50, inversion
FREQUENCY_BY_PANEL, FREQUENCY_BY_RS485, FREQUENCY_BY_PRESET = 2, 3, 255  # FD46
HOUR = 3600.0

Reading = Callable[[Condition, Operation], float]


def status(condition: Condition, command: Operation) -> int:
    """Return FD01 without its undefined bit: 4000H ready, 6400H running, 0003H tripped."""
    if condition.is_tripped:
        emergency = EMERGENCY_STOP if condition.trip_code == TripCode.EMERGENCY else 0
        return FL_OUTPUT | TRIPPED | emergency | _alarm_bit(condition) | (command.bits & COAST)
    word = READY | _alarm_bit(condition) | (command.bits & STATUS_OF_COMMAND)
    frequency = condition.motor.frequency
    if frequency < 0 or (frequency == 0 and command.is_reverse):
        word |= REVERSE
    if command.pattern == 2:
        word |= PATTERN_2
    if command.is_coasting:
        return word | COAST
    if command.is_running or frequency != 0:
        word |= RUN
    if command.is_running:
        word |= READY_AND_RUNNING
    return word


def _alarm_bit(condition: Condition) -> int:
    is_alarm_t = condition.is_timed_out or condition.is_master_tripped
    return ALARM if condition.alarm or is_alarm_t else 0


def status_2(_condition: Condition, command: Operation) -> int:
    """Return FD42: forced stop and acceleration pattern."""
    return (1 << 7 if command.is_forced_stop else 0) | (command.pattern - 1) << 8


def status_3(condition: Condition, command: Operation) -> int:
    """Return FD49: how the ramp stands; the healthy bit turns over every second (VF-MB1 8.2)."""
    word = (HEALTHY if int(condition.time) & 1 else 0) | (condition.memory.word("command_3") & 3)
    motor = condition.motor
    if motor.acceleration > 0:
        word |= ACCELERATING
    elif motor.acceleration < 0:
        word |= DECELERATING
    elif command.is_running and motor.frequency != 0:
        word |= CONSTANT_SPEED | RAMP_COMPLETE
    return word


def output_terminals(condition: Condition, _command: Operation) -> int:
    """Return FD07: what FA50 sets through functions 92 to 95, and FL while tripped."""
    memory = condition.memory
    word = FL_TERMINAL if condition.is_tripped else 0
    for terminal, function in enumerate(("output_function_1", "output_function_2")):
        if chosen := TERMINAL_FUNCTIONS.get(memory.word(function)):
            bit, inversion = chosen
            word |= ((memory.word("terminal_output") >> bit & 1) ^ inversion) << terminal
    return word


def key_state(condition: Condition, _command: Operation) -> int:
    """Return FC00: the keys in force, from outside while FA10 = 1."""
    memory = condition.memory
    return KEYS_NORMAL | (memory.word("external_keys") & 0xFF if memory.word("panel_key_selection") else 0)


def frequency_mode(_condition: Condition, command: Operation) -> int:
    """Return FD46: where the frequency command comes from."""
    if command.is_preset:
        return FREQUENCY_BY_PRESET
    return FREQUENCY_BY_RS485 if command.is_frequency_by_rs485 else FREQUENCY_BY_PANEL


def _speed(condition: Condition) -> float:
    return abs(condition.motor.frequency) * 120 / poles(condition.memory)


READINGS: dict[str, Reading] = {
    "status": status,
    "status_2": status_2,
    "status_3": status_3,
    "output_terminals": output_terminals,
    "key_state": key_state,
    "frequency_mode": frequency_mode,
    "command_mode": lambda _, o: Source(o.source),
    "trip_code": lambda c, _: c.trip_code,
    "alarm": lambda c, _: c.alarm,
    "output_frequency": lambda c, _: abs(c.motor.frequency),
    "compensated_frequency": lambda c, _: abs(c.motor.frequency),
    "estimated_speed": lambda c, _: max(0.0, abs(c.motor.frequency) - c.motor.slip),
    "frequency_command_value": lambda _, o: o.setpoint,
    "output_current": lambda c, _: c.motor.current(),
    "output_voltage": lambda c, _: c.motor.voltage,
    "input_voltage": lambda c, _: c.motor.bus_voltage(),
    "torque": lambda c, _: c.motor.torque,
    "torque_current": lambda c, _: c.motor.torque,
    "motor_overload_factor": lambda c, _: c.overload,
    "inverter_overload_factor": lambda c, _: c.overload,
    "motor_load_factor": lambda c, _: c.motor.current(),
    "inverter_load_factor": lambda c, _: c.motor.current(),
    "input_power": lambda c, _: c.motor.input_power(c.ratings.kilowatts),
    "output_power": lambda c, _: max(0.0, c.motor.output_power(c.ratings.kilowatts)),
    "motor_speed": lambda c, _: _speed(c),
    "starts": lambda c, _: c.counters.forward_starts + c.counters.reverse_starts,
    "forward_starts": lambda c, _: c.counters.forward_starts,
    "reverse_starts": lambda c, _: c.counters.reverse_starts,
    "cumulative_operation_time": lambda c, _: c.counters.running / HOUR,
    "cumulative_power_on_time": lambda c, _: c.counters.powered / HOUR,
    "cumulative_fan_time": lambda c, _: c.counters.powered / HOUR,
    "input_energy": lambda c, _: c.counters.input_energy * 10,  # F749 = 0: 0.1 kWh a count
    "output_energy": lambda c, _: c.counters.output_energy * 10,
    "capacity_code": lambda c, _: c.ratings.code,
    "rated_current": lambda c, _: c.ratings.amperes,
    "rated_voltage": lambda c, _: c.ratings.volts,
    "cpu_version": lambda c, _: c.version,
    "cpu_version_2": lambda c, _: c.version,
} | {f"past_trip_{n + 1}": (lambda c, _, n=n: c.past_trips[n]) for n in range(8)}
