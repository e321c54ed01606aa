"""What communication may read and write of an inverter, by number: the register behaviour that protocols share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

from gateway.drives.model import BlockForms
from gateway.drives.register import Register
from gateway.sim import operation
from gateway.sim.condition import TripCode
from gateway.sim.inverter import Inverter
from gateway.sim.memory import Denial, Denied

MOST_GROUPS = 2  # words that X writes (4.1.3)
HUNDRED_PERCENT = 10_000  # of the S command
HOLE = 0x8000  # what a direct block reads where no number is (E6581657 5.1.3)
LED_MODE = 1  # FA80
ZERO, GO_ON, TRIP = range(3)  # F806: what a slave does when its master trips; 3 and 4 are masters
LED_TEXT = ("led_text_1_digit_1", "led_text_1_digit_2", "led_text_1_digit_3", "led_text_1_digit_4", "led_unit_1")


class RegisterAccess:
    """Reads and writes by communication number; each may raise Denied.

    After a message `was_reset` says that it reset the drive, `wore_eeprom` that it wrote the EEPROM,
    `set_timer` that it set F803, and `was_proportional` that it was S or s.
    """

    def __init__(self, inverter: Inverter) -> None:
        self._inverter = inverter
        self._memory = inverter.memory
        connector = inverter.model.connector()
        self._block_read = connector.block_read if connector else ()
        self._block_write = connector.block_write if connector else ()
        self.forced: dict[int, int] = {}
        self.was_reset = self.wore_eeprom = self.set_timer = self.was_proportional = False

    def begin(self) -> None:
        """Forget what the last message did."""
        self.was_reset = self.wore_eeprom = self.set_timer = self.was_proportional = False

    @property
    def blocks(self) -> BlockForms:
        """Return which block forms the model has."""
        return self._inverter.model.blocks

    @property
    def is_tripped(self) -> bool:
        """Say whether a trip is held."""
        return self._inverter.condition.is_tripped

    @property
    def most_groups(self) -> int:
        """Return how many words X may write: two, or five to the display while FA80 = 1 (7.3.1)."""
        return len(LED_TEXT) if self._is_for_leds else MOST_GROUPS

    @property
    def has_proportional(self) -> bool:
        """Say whether the model has S: VF-nC3 lists neither the command nor F810 (4.2)."""
        return self._memory.has("frequency_points")

    def identity(self) -> tuple[str, str]:
        """Return the device reference and the version that 2BH answers."""
        condition = self._inverter.condition
        return condition.ratings.form, f"{condition.version:04d}"

    def read(self, address: int) -> int:
        """Read one word."""
        register = self._memory.register(address)
        self._memory.check_read(register)
        return self.forced[address] if address in self.forced else self._inverter.measure(register)

    def read_direct(self, first: int, count: int) -> Sequence[int]:
        """Read consecutive numbers; the first must exist, holes behind it read 8000H."""
        self._memory.register(first)
        last = first + count - 1
        is_shown = any(low <= first and last <= high for low, high in self.blocks.direct_ranges)
        if not is_shown and not self._inverter.options.accepts_direct_blocks:
            raise Denied(Denial.RANGE)
        return [self.read(a) if self._memory.has_address(a) else HOLE for a in range(first, last + 1)]

    def read_block(self, count: int) -> Sequence[int]:
        """Read what F875-F879 selected at the last reset; 0 where nothing is selected."""
        selected = self._selected(self._block_read, self._inverter.model.read_selectors)
        names = [*selected, *[""] * count][:count]
        return [self.read(self._memory.named(name).address) if name else 0 for name in names]

    def write_stored(self, address: int, word: int) -> None:
        """Write one word as W, 06H and 10H do: what has a place in the EEPROM wears it."""
        register = self._memory.register(address)
        self._check(register, word)
        self.wore_eeprom |= self._memory.write_stored(register, word)
        self._react(register, word)

    def write_ram(self, address: int, word: int) -> None:
        """Write one word as P does: the EEPROM keeps its own."""
        self._write_ram(self._memory.register(address), word)

    def _write_ram(self, register: Register, word: int) -> None:
        self._check(register, word)
        self._memory.write_ram(register, word)
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
            self._write_ram(register, word)
            if self.was_reset:
                return

    def write_groups(self, words: Sequence[int]) -> Sequence[int]:
        """Write to RAM as X does, each word by itself; return the places of those that were not written."""
        selected = self._selected(self._block_write, self._inverter.model.write_selectors)
        names = [*selected, *[""] * len(words)]
        return [place for place, word in enumerate(words) if not self._is_group_written(names[place], word)]

    def _is_group_written(self, name: str, word: int) -> bool:
        """Write one word of X and say whether that was possible; a word that nothing selects was not written."""
        if not name or self.was_reset:
            return False
        try:
            self._write_ram(self._memory.named(name), word)
        except Denied:
            return False
        return True

    def write_proportional(self, address: int, word: int, *, is_master_tripped: bool) -> None:
        """Take a frequency in 0.01 % to RAM as S does, unchecked; s does what F806 says (VF-MB1 RS485 4.2, 6)."""
        self.was_proportional = True
        register = self._memory.register(address)
        if register.name != "frequency_command":
            raise Denied(Denial.NUMBER)
        self._inverter.condition.is_master_tripped = is_master_tripped
        action = self._memory.word_in_force(self._inverter.role("master_slave")) if is_master_tripped else GO_ON
        if action == TRIP:
            self._inverter.trip(TripCode.EMERGENCY)
            return
        hertz = 0 if action == ZERO else self._converted(word)
        if hertz is not None:
            self._memory.write_ram(register, hertz)
            self._react(register, hertz)

    def _converted(self, word: int) -> int | None:
        """Return the counts of 0.01 Hz for counts of 0.01 %; None where F811 = F813 gives no line to go by."""
        memory = self._memory
        if not memory.word("frequency_points"):
            return min(0xFFFF, word * round(self._inverter.options.limits.maximum * 100) // HUNDRED_PERCENT)
        first, second = (memory.word(f"point_{n}_setting") * 100 for n in (1, 2))
        low, high = (memory.word(f"point_{n}_frequency") for n in (1, 2))
        if first == second:
            return None
        hertz = Fraction((high - low) * (word - first), second - first) + low
        return min(0xFFFF, max(0, int(hertz)))

    @property
    def _is_for_leds(self) -> bool:
        return self._memory.word("block_mode") == LED_MODE

    def _selected(self, selectors: Sequence[str], meaning: Mapping[int, str]) -> Sequence[str]:
        """Return the names that a block carries: by selectors, or the LEDs while FA80 = 1 (7.3.1)."""
        if self._is_for_leds:
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
