"""The machine behind the registers: how it runs in time, times out, trips and is reset (E6581657 6.3, 7)."""

from __future__ import annotations

import math
from random import Random

from gateway.drives.model import Model
from gateway.drives.register import Kind, Register
from gateway.sim import operation
from gateway.sim.condition import Condition, Counters, TripCode
from gateway.sim.memory import Memory
from gateway.sim.monitors import HOUR, READINGS
from gateway.sim.motor import Motor
from gateway.sim.operation import Operation
from gateway.sim.options import DriveOptions, as_set_up, roles
from gateway.sim.ratings import of_capacity
from gateway.sim.timeout import CommunicationTimer

ALARM_ONLY, TRIP_AND_COAST, STOP_AND_TRIP = range(3)  # F804
ALWAYS, IN_COMMUNICATION, COMMUNICATION_AND_RUNNING = range(3)  # F808
OVERLOAD_RATE = 80.0 / 60.0  # % a second for each unit of excess heat: 150 % of torque fills it in a minute
KEYS = ("key_state", "panel_keys")  # their spare bits are not called undefined


class Inverter:
    """One inverter with its motor. Time only moves forwards; `tick` may be called as seldom as one likes."""

    def __init__(self, model: Model, options: DriveOptions, rng: Random, now: float) -> None:
        self.model = model
        self.options = options
        self._rng = rng
        self._roles = roles(model)
        self.memory = Memory(model, as_set_up(model, options))
        self.condition = Condition(
            memory=self.memory,
            motor=Motor(rng, options.load),
            ratings=of_capacity(model, options.capacity),
            limits=options.limits,
            counters=Counters(options.hours * HOUR, 2.5 * options.hours * HOUR),
            version=options.version,
            time=now,
        )
        self._operation: tuple[tuple[object, ...], Operation] | None = None
        self.timer = CommunicationTimer()
        self.set_timer()
        self._held: dict[str, int] = {}
        self._stops_to_trip = False
        self.deaf_until = now
        if options.running_at:
            self.run_by_panel(options.running_at)
            self.condition.motor.frequency = options.running_at

    @property
    def operation(self) -> Operation:
        """Return what it is told to do; worked out anew when one of its sources has changed."""
        condition, panel = self.condition, self.condition.panel
        sources = (
            self.memory.changes,
            panel.is_running,
            panel.is_reverse,
            panel.frequency,
            condition.is_speed_commanded,
        )
        if self._operation is None or self._operation[0] != sources:
            self._operation = (sources, operation.operation(condition))
        return self._operation[1]

    @property
    def is_running(self) -> bool:
        """Say whether the output is on: the motor turns, or is told to."""
        return self.condition.motor.frequency != 0 or (self.operation.is_running and not self.condition.is_tripped)

    def role(self, role: str) -> str:
        """Return the name of the communication parameter with that role, "" where the model has none."""
        return self._roles.get(role, "")

    def set_timer(self) -> None:
        """Take F803 as it is now: the timer stands until the next message."""
        self.timer.set(self.memory.word(self.role("timeout")) / 10)
        self.condition.is_timed_out = False

    def acknowledge(self, now: float) -> None:
        """Note that a message was acknowledged."""
        self.condition.is_timed_out = False
        self.timer.acknowledge(now)

    # -- time -----------------------------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """Let time pass until now: the motor ramps, the communication timer may run out."""
        deadline = self.timer.deadline
        if deadline is not None and deadline <= now and not self.condition.is_timed_out:
            self._advance(deadline)
            if self._detects_timeout:
                self._time_out()
        if self._stops_to_trip:
            standstill = self.condition.time + self.condition.motor.time_to_stop(self.operation.ramp)
            if standstill <= now:
                self._advance(standstill)
                self.trip(TripCode.COMMUNICATION)
        self._advance(now)

    def _advance(self, until: float) -> None:
        seconds = until - self.condition.time
        if seconds <= 0:
            return
        motor = self.condition.motor
        command = self.operation
        was_standing = motor.frequency == 0
        if self.condition.is_tripped or command.is_coasting or command.is_dc_braking:
            motor.cut()
        else:
            motor.advance(0.0 if self._stops_to_trip else command.target, command.ramp, seconds)
        self.condition.time = until
        self._count(seconds, was_standing=was_standing)

    def _count(self, seconds: float, *, was_standing: bool) -> None:
        counters, motor = self.condition.counters, self.condition.motor
        counters.powered += seconds
        counters.running += seconds if motor.frequency else 0.0
        counters.forward_starts += was_standing and motor.frequency > 0
        counters.reverse_starts += was_standing and motor.frequency < 0
        kilowatts, hours = self.condition.ratings.kilowatts, seconds / HOUR
        counters.input_energy += motor.input_power(kilowatts) * hours
        counters.output_energy += max(0.0, motor.output_power(kilowatts)) * hours
        heat = ((motor.torque / 100) ** 2 - 1) * OVERLOAD_RATE * seconds
        self.condition.overload = min(100.0, max(0.0, self.condition.overload + heat))

    @property
    def _detects_timeout(self) -> bool:
        when = self.memory.word(self.role("timeout_detection"), ALWAYS)
        if when == ALWAYS:
            return True
        return self.operation.is_by_communication and (when == IN_COMMUNICATION or self.is_running)

    def _time_out(self) -> None:
        self.condition.is_timed_out = True
        action = self.memory.word(self.role("timeout_action"), ALARM_ONLY)
        if action == TRIP_AND_COAST:
            self.trip(TripCode.COMMUNICATION)
        elif action == STOP_AND_TRIP and not self.condition.is_tripped:
            self._stops_to_trip = True

    # -- commands, trips and resets -------------------------------------------------------------------------

    def trip(self, code: int) -> None:
        """Trip: keep what was, cut the output, remember the code; a drive that is tripped stays as it is."""
        if self.condition.is_tripped:
            return
        held = [r for r in self.model.registers.values() if r.kind is Kind.TRIP_HELD]
        self._held = {register.name: self.measure(register) for register in held}
        self._stops_to_trip = False
        self.condition.trip_code = code
        self.condition.add_to_history(code)
        self.condition.motor.cut()

    def reset(self, now: float, off: float = 0.0) -> None:
        """Reset, or switch the power off for so long: RAM is gone, and it is deaf until it has started up."""
        self.tick(now)
        self.memory.reset()
        condition = self.condition
        condition.motor.cut()
        condition.panel.is_running = condition.panel.is_reverse = False
        condition.trip_code = TripCode.NONE
        condition.is_speed_commanded = condition.is_master_tripped = False
        condition.overload = 0.0
        self._held = {}
        self._stops_to_trip = False
        self.set_timer()
        self.deaf_until = now + off + self.model.times.start_up

    def switch_off(self, now: float) -> None:
        """Cut the power until `reset` brings it back."""
        self.reset(now, math.inf)

    def run_by_panel(self, frequency: float, *, is_reverse: bool = False) -> None:
        """Press RUN with the panel's frequency at so many Hz; 0 presses STOP."""
        panel = self.condition.panel
        panel.is_running, panel.is_reverse, panel.frequency = frequency > 0, is_reverse, frequency
        if frequency > 0 and self.memory.has("panel_frequency"):
            self.memory.set_by_panel("panel_frequency", round(frequency * 100))

    # -- what it measures -----------------------------------------------------------------------------------

    def measure(self, register: Register) -> int:
        """Return the word of a register; those that are held keep what was before a trip."""
        if register.kind is Kind.TRIP_HELD:
            if register.name in self._held:
                return self._held[register.name]
            return self.measure(self.memory.named(register.name.removeprefix("trip_")))
        reading = READINGS.get(register.name)
        if reading is None:
            return self.memory.word(register.name)
        raw = round(reading(self.condition, self.operation) / float(register.scaling.scale))
        low, high = register.scaling.limits
        word = min(high, max(low, raw)) & 0xFFFF
        is_bit_field = register.kind is Kind.STATUS and bool(register.bits) and register.name not in KEYS
        return self._unstable(word, register.mask) if is_bit_field else word

    def _unstable(self, word: int, mask: int) -> int:
        """Put chance into the undefined bits: the manual calls them unstable."""
        noise = 0 if self.options.stable_bits else self._rng.getrandbits(16)
        return (word & mask) | (noise & ~mask & 0xFFFF)
