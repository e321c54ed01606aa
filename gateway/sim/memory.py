"""A drive's stored words: RAM and EEPROM apart, what may be written when, and what a reset brings back."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from gateway.drives.model import Model
from gateway.drives.register import Kind, Register, Storage

WRITES_INHIBITED, WRITES_AND_READS_INHIBITED = 2, 4  # F700, by RS485 (E6581657 5.3, VF-MB1 RS485 5.3)


class Denial(Enum):
    """Why an access is refused, whatever the protocol; E6581657 4.3 and 5.3."""

    COMMAND = "no such command"
    NUMBER = "no such communication number, or a write to a read-only one"
    RANGE = "data outside its range"
    UNABLE = "impossible now"
    CHECKSUM = "wrong checksum"


class Denied(Exception):
    """The drive refuses an access and says why."""

    def __init__(self, denial: Denial) -> None:
        super().__init__(denial.value)
        self.denial = denial


class Memory:
    """The words that a drive keeps, by communication number.

    `in_force` holds the parameters as they were at the last reset: F875-F879 and their like act from there,
    whatever their number reads back (E6581657 6).
    """

    def __init__(self, model: Model, presets: Mapping[str, int] | None = None) -> None:
        self._by_address = {register.address: register for register in model.registers.values()}
        self._by_name = model.registers
        self._ram: dict[int, int] = {}
        self._eeprom = {
            register.address: register.initial & 0xFFFF
            for register in model.registers.values()
            if register.storage is Storage.EEPROM or register.kind is Kind.PARAMETER
        }
        self._in_force: dict[int, int] = {}
        self.eeprom_writes: dict[int, int] = {}
        self.changes = 0  # how often any word was written
        for name, word in (presets or {}).items():
            self._eeprom[model.registers[name].address] = word & 0xFFFF
        self.reset()

    def reset(self) -> None:
        """Do what power-on and the fault reset do: RAM anew, parameters from the EEPROM, all in force."""
        self._ram = {
            address: self._eeprom.get(address, register.initial & 0xFFFF)
            for address, register in self._by_address.items()
        }
        self._in_force = dict(self._ram)
        self.changes += 1

    def register(self, address: int) -> Register:
        """Return what stands under a communication number; denied where nothing does."""
        if (register := self._by_address.get(address)) is None:
            raise Denied(Denial.NUMBER)
        return register

    def has_address(self, address: int) -> bool:
        """Say whether something stands under a communication number."""
        return address in self._by_address

    def has(self, name: str) -> bool:
        """Say whether this model has a register of that name."""
        return name in self._by_name

    def named(self, name: str) -> Register:
        """Return the register of that name."""
        return self._by_name[name]

    def word(self, name: str, absent: int = 0) -> int:
        """Return the word of a register by name; `absent` where this model has none."""
        register = self._by_name.get(name)
        return absent if register is None else self._ram[register.address]

    def word_in_force(self, name: str, absent: int = 0) -> int:
        """Return the word that acts until the next reset."""
        register = self._by_name.get(name)
        return absent if register is None else self._in_force[register.address]

    def check_write(self, register: Register, word: int, *, is_running: bool) -> None:
        """Deny a write as a drive does: a password that is set, read-only, then out of range, then protected."""
        if register.name == "password" and self.word("password"):
            raise Denied(Denial.UNABLE)
        if not register.is_writable:
            raise Denied(Denial.NUMBER)
        raw = register.scaling.raw(word)
        low, high = self._limits(register)
        if not low <= raw <= high:
            raise Denied(Denial.RANGE)
        if register.kind is Kind.PARAMETER and self._inhibits(WRITES_INHIBITED, WRITES_AND_READS_INHIBITED):
            raise Denied(Denial.UNABLE)
        if is_running and not register.writable_while_running:
            raise Denied(Denial.UNABLE)

    def check_read(self, register: Register) -> None:
        """Deny the reading of a parameter where F700 does; a model whose manual has no such code allows it."""
        if register.kind is Kind.PARAMETER and self._inhibits(WRITES_AND_READS_INHIBITED):
            raise Denied(Denial.UNABLE)

    def _inhibits(self, *codes: int) -> bool:
        """Say whether F700 is one of those codes, as far as the model has them."""
        protection = self._by_name.get("write_protection")
        if protection is None or protection.enumeration is None:
            return False
        return self._ram[protection.address] in protection.enumeration.texts.keys() & codes

    def _limits(self, register: Register) -> tuple[int, int]:
        low, high = register.scaling.limits
        low = low if register.minimum is None else register.minimum
        high = high if register.maximum is None else register.maximum
        low = max(low, self.word(register.minimum_from, low))
        high = min(high, self.word(register.maximum_from, high))
        return low, high

    def write_ram(self, register: Register, word: int) -> None:
        """Write the word that is in use; the EEPROM keeps its own."""
        self._ram[register.address] = word
        self.changes += 1

    def write_stored(self, register: Register, word: int) -> bool:
        """Write as W and MODBUS 06H and 10H do; say whether that wore the EEPROM."""
        self.write_ram(register, word)
        if register.storage is not Storage.EEPROM:
            return False
        self._eeprom[register.address] = word
        self.eeprom_writes[register.address] = self.eeprom_writes.get(register.address, 0) + 1
        return True

    def set_by_panel(self, name: str, word: int) -> None:
        """Set a register at the drive itself: no protection applies, and no wear is counted."""
        register = self._by_name[name]
        self.write_ram(register, word & 0xFFFF)
        if register.address in self._eeprom:
            self._eeprom[register.address] = word & 0xFFFF
