"""What a drive is told to do: the bits of FA00, FA20 and the panel taken together (E6581657 7.1)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from gateway.sim.condition import Condition, Limits, Panel
from gateway.sim.memory import Memory
from gateway.sim.motor import Ramp

PRESETS = 0x000F
MOTOR_2 = 1 << 4
PID_OFF = 1 << 5
PATTERN_2 = 1 << 6
DC_BRAKING = 1 << 7
JOG = 1 << 8
REVERSE = 1 << 9
RUN = 1 << 10
COAST = 1 << 11
EMERGENCY_STOP = 1 << 12
FAULT_RESET = 1 << 13
FREQUENCY_PRIORITY = 1 << 14
COMMAND_PRIORITY = 1 << 15

FORCED_STOP = 1 << 7  # FA20: stop at the greatest deceleration
PATTERN_SHIFT = 8  # FA20 bits 8 and 9: acceleration pattern, on VF-MB1 (8.1)
HUNDREDTHS = 1  # 0999: times are in 0.01 s, not in 0.1 s
QUICKEST = 0.05  # seconds from standstill to FH; nothing ramps faster


class Source(IntEnum):
    """Who gives the run command, as FD45 says it."""

    PANEL = 1
    RS485 = 2


@dataclass(frozen=True, slots=True)
class Operation:
    """The command in force. `setpoint` is the frequency in Hz if it runs, `target` the signed one to go to now."""

    source: Source
    is_frequency_by_rs485: bool
    is_preset: bool
    bits: int  # of FA00 as far as they are in force
    is_running: bool
    setpoint: float
    ramp: Ramp
    pattern: int
    is_forced_stop: bool = False

    @property
    def is_coasting(self) -> bool:
        """Say whether the output is switched off."""
        return bool(self.bits & COAST)

    @property
    def is_dc_braking(self) -> bool:
        """Say whether direct current holds the motor."""
        return bool(self.bits & DC_BRAKING)

    @property
    def is_reverse(self) -> bool:
        """Say whether the motor is to turn in reverse."""
        return bool(self.bits & REVERSE)

    @property
    def target(self) -> float:
        """Return the frequency to ramp to, negative in reverse."""
        if not self.is_running or self.is_forced_stop:
            return 0.0
        return -self.setpoint if self.is_reverse else self.setpoint

    @property
    def is_by_communication(self) -> bool:
        """Say whether command or frequency comes from RS485: what F808 = 1 asks for."""
        return self.source is Source.RS485 or self.is_frequency_by_rs485


def operation(condition: Condition) -> Operation:
    """Return what the drive is told to do now; who has priority decides."""
    memory = condition.memory
    command = memory.word("command")
    has_priority = bool(command & COMMAND_PRIORITY)
    bits = command if has_priority else _panel_bits(condition.panel)
    command_2 = memory.word("command_2") if has_priority else 0
    by_rs485 = bool(command & FREQUENCY_PRIORITY) or _is_rs485_selected(memory)
    pattern = _pattern(memory, bits, command_2)
    preset = bits & PRESETS
    is_forced_stop = bool(command_2 & FORCED_STOP)
    setpoint = _setpoint(condition, bits, by_rs485=by_rs485)
    return Operation(
        source=Source.RS485 if has_priority else Source.PANEL,
        is_frequency_by_rs485=by_rs485,
        is_preset=bool(preset),
        bits=bits,
        is_running=bool(bits & RUN),
        setpoint=min(setpoint, condition.limits.maximum),
        ramp=_ramp(memory, condition.limits, pattern, is_forced_stop=is_forced_stop),
        pattern=pattern,
        is_forced_stop=is_forced_stop,
    )


def _panel_bits(panel: Panel) -> int:
    return (RUN if panel.is_running else 0) | (REVERSE if panel.is_reverse else 0)


def _is_rs485_selected(memory: Memory) -> bool:
    """Say whether FMOD selects communication: 3 on VF-nC3, 4 on VF-MB1, as the catalogue has it."""
    if not memory.has("frequency_mode_selection"):
        return False
    text = memory.named("frequency_mode_selection").text(memory.word("frequency_mode_selection"))
    return text is not None and text.startswith("RS485")


def _setpoint(condition: Condition, bits: int, *, by_rs485: bool) -> float:
    limits = condition.limits
    if bits & JOG:
        return limits.jog
    if preset := bits & PRESETS:
        return limits.presets[preset - 1] if preset <= len(limits.presets) else 0.0
    if not by_rs485:
        return condition.memory.word("panel_frequency", round(condition.panel.frequency * 100)) / 100
    if condition.is_speed_commanded:
        return frequency_of_speed(condition.memory, condition.memory.word("motor_speed_command"))
    return condition.memory.word("frequency_command") / 100


def poles(memory: Memory) -> int:
    """Return the number of poles: twice the code of F856 (VF-MB1 7, 8.1)."""
    return 2 * memory.word("motor_poles", 2)


def frequency_of_speed(memory: Memory, speed: int) -> float:
    """Return the Hz for a speed in min-1: 1800 with 4 poles is 60 Hz."""
    return speed * poles(memory) / 120


def _pattern(memory: Memory, bits: int, command_2: int) -> int:
    if bits & PATTERN_2:
        return 2
    if not memory.has("acceleration_time_3"):
        return 1
    return min(3, 1 + (command_2 >> PATTERN_SHIFT & 3))


def _ramp(memory: Memory, limits: Limits, pattern: int, *, is_forced_stop: bool) -> Ramp:
    """ACC and DEC are the seconds between standstill and FH."""
    up = _time(memory, "acceleration_time", pattern)
    down = QUICKEST if is_forced_stop else _time(memory, "deceleration_time", pattern)
    return Ramp(limits.maximum / up, limits.maximum / down)


def _time(memory: Memory, name: str, pattern: int) -> float:
    unit = 0.01 if memory.word("acceleration_time_unit") == HUNDREDTHS else 0.1
    count = memory.word(f"{name}_{pattern}") or memory.word(f"{name}_1", 100)
    return max(QUICKEST, count * unit)
