"""A simulated drive as the line meets it: requests in, answers out, and what can be done to it by hand."""

from __future__ import annotations

from random import Random

from gateway.drives.model import Model
from gateway.sim import frames
from gateway.sim.access import Effects, RegisterAccess
from gateway.sim.inverter import Inverter
from gateway.sim.options import PROTOCOLS, DriveOptions

BAUD_CODES = {9600: 3, 19200: 4, 38400: 5}  # F800
PARITY_CODES = {"none": 0, "even": 1, "odd": 2}  # F801


class SimulatedDrive:
    """One drive on a line; it knows no clock, each call says what time it is."""

    def __init__(self, model: Model, options: DriveOptions, rng: Random, now: float = 0.0) -> None:
        self.inverter = Inverter(model, options, rng, now)
        self.registers = RegisterAccess(self.inverter)
        self.acknowledged: float | None = None  # when the last message was
        self.messages_acknowledged = 0
        self.frames_heard = 0  # whole or not, for it or for others

    @property
    def number(self) -> int:
        """Return the inverter number F802, which acts at once."""
        return self.inverter.memory.word(self.inverter.role("number"), self.inverter.options.number)

    @property
    def model(self) -> Model:
        """Return the drive's model."""
        return self.inverter.model

    def hears(self, baud: int, parity: str) -> bool:
        """Say whether its line settings in force, if it has any, are those of the line."""
        inverter, baud_code, parity_code = self.inverter, BAUD_CODES[baud], PARITY_CODES[parity]
        return (
            inverter.memory.word_in_force(inverter.role("baud_rate"), baud_code) == baud_code
            and inverter.memory.word_in_force(inverter.role("parity"), parity_code) == parity_code
        )

    def tick(self, now: float) -> None:
        """Let time pass until now."""
        self.inverter.tick(now)

    def handle(self, frame: bytes, now: float) -> tuple[bytes | None, float]:
        """Take a frame whose end was recognised now; return the answer, or None, and the seconds until it begins.

        Without an answer the seconds are those for which the drive works on the frame and hears no other.
        """
        self.tick(now)
        self.frames_heard += now >= self.inverter.deaf_until
        if now < self.inverter.deaf_until:
            return None, 0.0
        effects = self.registers.begin()
        answer = frames.answer(self.protocol, frame, self.number, self.registers)
        if effects.reset_drive:  # FA00 bit 13 returns no data (E6581657 7.1)
            return None, 0.0
        if answer is not None or (effects.was_proportional and self._counts_proportional):
            self._acknowledge(now, effects)
        if answer is None:
            return None, self._processing(effects) if effects.used_registers else 0.0
        return answer, max(self._processing(effects), self._wait_time)

    def _acknowledge(self, now: float, effects: Effects) -> None:
        """Start the timer of F803, but by the message after the one that set it (6.3)."""
        self.acknowledged = now
        self.messages_acknowledged += 1
        if not effects.set_timer:
            self.inverter.acknowledge(now)

    @property
    def protocol(self) -> int:
        """Return F829 in force; a model whose codes for it are not known speaks what its options say."""
        memory, name = self.inverter.memory, self.inverter.role("protocol")
        if not memory.has(name) or not memory.named(name).is_writable:
            return PROTOCOLS[self.inverter.options.protocol]
        return memory.word_in_force(name)

    @property
    def _counts_proportional(self) -> bool:
        return self.inverter.options.proportional_restarts_timer

    def _processing(self, effects: Effects) -> float:
        """Return the seconds for which it works on a message."""
        options = self.inverter.options
        if not effects.wore_eeprom:
            return options.processing
        return self.model.times.eeprom if options.eeprom is None else options.eeprom

    @property
    def _wait_time(self) -> float:
        """Return F805: an answer begins no sooner (6.5)."""
        return self.inverter.memory.word(self.inverter.role("wait_time")) / 100

    # -- at the drive itself --------------------------------------------------------------------------------

    def set_by_panel(self, name: str, word: int) -> None:
        """Set a register by name at the panel; KeyError where the model has none."""
        self.inverter.memory.set_by_panel(name, word)
        if name == self.inverter.role("timeout"):
            self.inverter.set_timer()

    def force(self, name: str, word: int | None) -> None:
        """Make a register read that word, whatever is true; None ends it. KeyError where the model has none."""
        address = self.inverter.memory.named(name).address
        if word is None:
            self.registers.forced.pop(address, None)
        else:
            self.registers.forced[address] = word & 0xFFFF
