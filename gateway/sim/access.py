"""What communication may read and write of an inverter, by number: the register behaviour that protocols share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gateway.drives.model import BlockForms
from gateway.drives.register import Register
from gateway.sim import operation
from gateway.sim.condition import TripCode
from gateway.sim.inverter import Inverter
from gateway.sim.memory import Denial, Denied

HOLE = 0x8000  # what a direct block reads where no number is (E6581657 5.1.3)
LED_TEXT = ("led_text_1_digit_1", "led_text_1_digit_2", "led_text_1_digit_3", "led_text_1_digit_4", "led_unit_1")


class RegisterAccess:
    """Reads and writes by communication number; each may raise Denied.

    After a message `was_reset` says that it reset the drive, `wore_eeprom` that it wrote the EEPROM, and
    `set_timer` that it set F803.
    """

    def __init__(self, inverter: Inverter) -> None:
        self._inverter = inverter
        self._memory = inverter.memory
        connector = inverter.model.connector()
        self._block_read = connector.block_read if connector else ()
        self._block_write = connector.block_write if connector else ()
        self.forced: dict[int, int] = {}
        self.was_reset = self.wore_eeprom = self.set_timer = False

    def begin(self) -> None:
        """Forget what the last message did."""
        self.was_reset = self.wore_eeprom = self.set_timer = False

    @property
    def blocks(self) -> BlockForms:
        """Return which block forms the model has."""
        return self._inverter.model.blocks

    def identity(self) -> tuple[str, str]:
        """Return the device reference and the version that 2BH answers."""
        condition = self._inverter.condition
        return condition.ratings.form, f"{condition.version:04d}"

    def read(self, address: int) -> int:
        """Read one word."""
        register = self._memory.register(address)
        return self.forced[address] if address in self.forced else self._inverter.measure(register)

    def read_direct(self, first: int, count: int) -> Sequence[int]:
        """Read consecutive numbers; the first must exist, holes behind it read 8000H."""
        self._memory.register(first)
        last = first + count - 1
        is_shown = any(low <= first and last <= high for low, high in self.blocks.direct_ranges)
        if not is_shown and not self._inverter.options.accepts_direct_blocks:
            raise Denied(Denial.RANGE)
        return [self._word_or_hole(address) for address in range(first, last + 1)]

    def _word_or_hole(self, address: int) -> int:
        try:
            return self.read(address)
        except Denied:
            return HOLE

    def read_block(self, count: int) -> Sequence[int]:
        """Read what F875-F879 selected at the last reset; 0 where nothing is selected."""
        selected = self._selected(self._block_read, self._inverter.model.read_selectors)
        return [self.read(self._memory.named(name).address) if name else 0 for name in selected[:count]]

    def write_stored(self, address: int, word: int) -> None:
        """Write one word as 06H and 10H do: what has a place in the EEPROM wears it."""
        register = self._memory.register(address)
        self._check(register, word)
        self.wore_eeprom |= self._memory.write_stored(register, word)
        self._react(register, word)

    def write_block(self, words: Sequence[int]) -> None:
        """Write to RAM what F870 and F871 selected at the last reset, all of it or nothing."""
        selected = self._selected(self._block_write, self._inverter.model.write_selectors)
        writes = [(self._memory.named(name), word) for name, word in zip(selected, words, strict=False) if name]
        if not writes:
            raise Denied(Denial.UNABLE)
        for register, word in writes:
            self._check(register, word)
        for register, word in writes:
            self._memory.write_ram(register, word)
            self._react(register, word)

    def _selected(self, selectors: Sequence[str], meaning: Mapping[int, str]) -> Sequence[str]:
        """Return the names that a block carries: by selectors, or the LEDs while FA80 = 1 (7.3.1)."""
        if self._memory.word("block_mode") == 1:
            return LED_TEXT
        return [meaning.get(self._memory.word_in_force(selector), "") for selector in selectors]

    def _check(self, register: Register, word: int) -> None:
        self._memory.check_write(register, word, is_running=self._inverter.is_running)
        hertz = {
            "frequency_command": word / 100,
            "panel_frequency": word / 100,
            "motor_speed_command": operation.frequency_of_speed(self._memory, word),
        }.get(register.name, 0.0)
        if hertz > self._inverter.options.limits.maximum:
            raise Denied(Denial.RANGE)

    def _react(self, register: Register, word: int) -> None:
        """Do what a write brings about beyond its word."""
        if register.name == "command":
            self._obey(word)
        elif register.name in ("frequency_command", "motor_speed_command"):
            self._inverter.condition.is_speed_commanded = register.name == "motor_speed_command"
        elif register.name == self._inverter.role("timeout"):
            self._inverter.set_timer()
            self.set_timer = True

    def _obey(self, command: int) -> None:
        """Obey FA00 at once where it is to: a fault reset with command priority, an emergency stop always (7.1)."""
        if command & operation.FAULT_RESET and command & operation.COMMAND_PRIORITY:
            self._inverter.reset(self._inverter.condition.time)
            self.was_reset = True
        elif command & operation.EMERGENCY_STOP:
            self._inverter.trip(TripCode.EMERGENCY)
