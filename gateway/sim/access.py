"""What communication may read and write of an inverter, by number: the register behaviour that protocols share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gateway.drives.model import BlockForms
from gateway.drives.register import Register
from gateway.sim import display, operation, proportional
from gateway.sim.condition import TripCode
from gateway.sim.inverter import Inverter
from gateway.sim.memory import Denial, Denied

MOST_GROUPS = 2  # words that X writes (4.1.3)
HOLE = 0x8000  # what a direct block reads where no number is (E6581657 5.1.3)
LED_MODE = 1  # FA80


@dataclass(slots=True)
class Effects:
    """What a message did to a drive, beyond its answer; nothing, if it was not for it."""

    used_registers: bool = False
    reset_drive: bool = False
    wore_eeprom: bool = False
    set_timer: bool = False  # F803
    was_proportional: bool = False  # S or s


class RegisterAccess:
    """Reads and writes by communication number; each may raise Denied."""

    def __init__(self, inverter: Inverter) -> None:
        self._inverter = inverter
        self._memory = inverter.memory
        connector = inverter.model.connector()
        self._block_read = connector.block_read if connector else ()
        self._block_write = connector.block_write if connector else ()
        self.forced: dict[int, int] = {}
        self.effects = Effects()

    def begin(self) -> Effects:
        """Begin a message, and return where its effects are entered."""
        self.effects = Effects()
        return self.effects

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
        return len(display.TEXT_1) if self._is_for_leds else MOST_GROUPS

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
        self.effects.used_registers = True
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
        """Read what F875-F879 selected at the last reset, or the display; 0 where nothing is selected."""
        if self._is_for_leds:
            return display.shown(self._memory)[:count]
        selected = self._selected(self._block_read, self._inverter.model.read_selectors)
        names = [*selected, *[""] * count][:count]
        return [self.read(self._memory.named(name).address) if name else 0 for name in names]

    def write_stored(self, address: int, word: int) -> None:
        """Write one word as W, 06H and 10H do: what has a place in the EEPROM wears it."""
        register = self._memory.register(address)
        self._check(register, word)
        self.effects.wore_eeprom |= self._memory.write_stored(register, word)
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
        selected = self._selected_writes()
        writes = [(self._memory.named(name), word) for name, word in zip(selected, words, strict=False) if name]
        if not writes:
            raise Denied(Denial.UNABLE)
        for register, word in writes:
            self._check(register, word)
        for register, word in writes:
            self._write_ram(register, word)
            if self.effects.reset_drive:
                return

    def write_groups(self, words: Sequence[int]) -> Sequence[int]:
        """Write to RAM as X does, each word by itself; return the places of those that were not written."""
        names = [*self._selected_writes(), *[""] * len(words)]
        return [place for place, word in enumerate(words) if not self._is_group_written(names[place], word)]

    def _is_group_written(self, name: str, word: int) -> bool:
        """Write one word of X and say whether that was possible; a word that nothing selects was not written."""
        if not name or self.effects.reset_drive:
            return False
        try:
            self._write_ram(self._memory.named(name), word)
        except Denied:
            return False
        return True

    def write_proportional(self, address: int, word: int, *, is_master_tripped: bool) -> None:
        """Take a frequency in 0.01 % to RAM as S does, unchecked; s does what F806 says (VF-MB1 RS485 4.2, 6)."""
        self.effects.used_registers = self.effects.was_proportional = True
        register = self._memory.register(address)
        if register.name != "frequency_command":
            raise Denied(Denial.NUMBER)
        self._inverter.condition.is_master_tripped = is_master_tripped
        action = self._memory.word_in_force(self._inverter.role("master_slave"))
        counts: int | None = 0
        if is_master_tripped and action == proportional.TRIP:
            self._inverter.trip(TripCode.EMERGENCY)
            return
        if not is_master_tripped or action != proportional.ZERO:
            counts = proportional.counts_of_hertz(self._memory, word, self._inverter.options.limits.maximum)
        if counts is not None:
            self._memory.write_ram(register, counts)
            self._react(register, counts)

    @property
    def _is_for_leds(self) -> bool:
        """Say whether the block is for the display, FA80 = 1 (7.3.1)."""
        return self._memory.word("block_mode") == LED_MODE

    def _selected_writes(self) -> Sequence[str]:
        """Return the names that a block writes."""
        if self._is_for_leds:
            return display.TEXT_1
        return self._selected(self._block_write, self._inverter.model.write_selectors)

    def _selected(self, selectors: Sequence[str], meaning: Mapping[int, str]) -> Sequence[str]:
        """Return the names that selectors stand for, "" for none."""
        return [meaning.get(self._memory.word_in_force(selector), "") for selector in selectors]

    def _check(self, register: Register, word: int) -> None:
        self.effects.used_registers = True
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
            self.effects.set_timer = True

    def _obey(self, command: int) -> None:
        """Obey FA00 at once where it is to: a fault reset with command priority, an emergency stop always (7.1)."""
        if command & operation.FAULT_RESET and command & operation.COMMAND_PRIORITY:
            self._inverter.reset(self._inverter.condition.time)
            self.effects.reset_drive = True
        elif command & operation.EMERGENCY_STOP:
            self._inverter.trip(TripCode.EMERGENCY)
