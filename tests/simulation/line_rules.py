"""What must hold at every step, whatever goes wrong: looked at where the gateway writes to the line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from gateway.bus.trial import COMMAND_WORD, FREQUENCY_WORDS
from gateway.control.command import Verb
from gateway.control.composing import COMMAND, FREQUENCY, runs
from gateway.drives.model import Model
from tests.simulation import recorder
from tests.simulation.oracle import Oracle
from tests.simulation.orders import Order
from tests.simulation.recorder import Written
from tests.simulation.setup import HUNDREDTHS, Setup
from tests.simulation.world import World

if TYPE_CHECKING:
    from gateway.sim.drive import SimulatedDrive

WATCHDOG = ("timeout", "timeout_action", "timeout_detection")  # roles: F803, F804, F808
MARK_FRESH = 0.25  # seconds for which a look at FA87 is believed: a reset within them may be overlooked
ROUNDING = 1e-6  # seconds


@dataclass(slots=True)
class Known:
    """What the rules know of one drive."""

    name: str
    drive: SimulatedDrive
    is_commanded: bool = False  # something has reached this process of the gateway
    asked: dict[int, Order] = field(default_factory=dict)  # by setpoint: who asked for it last
    stopped: float = float("-inf")  # when the last stop reached it
    armed: float = float("-inf")
    reset: float = float("-inf")  # when the drive has forgotten what it was told, or was not to be reached
    quiet: float | None = None  # since when it is to be left alone
    held: set[int] = field(default_factory=set)  # FA01 before trials of the exchange, which are to put it back


@dataclass(slots=True)
class LineRules:
    """Judges every frame in the moment in which the gateway writes it. `tell` takes what must not be."""

    world: World
    setup: Setup
    oracle: Oracle
    tell: Callable[[str], None]
    known: dict[int, Known] = field(default_factory=dict)
    unaware: int = 0  # frames that were written by a process that could not know that it had stood still

    def know(self, name: str, drive: SimulatedDrive) -> None:
        """Know a drive from now on."""
        self.known[drive.number] = Known(name, drive)

    def of(self, name: str) -> Known | None:
        """Return what is known of a drive by its name."""
        return next((known for known in self.known.values() if known.name == name), None)

    # ---- what the frames are judged by

    def started(self) -> None:
        """Take note that a process of the gateway begins: it has heard nothing yet."""
        for known in self.known.values():
            known.asked.clear()
            known.is_commanded, known.armed, known.quiet = False, float("-inf"), None

    def forgotten(self, name: str | None = None) -> None:
        """Take note that a drive, or every one, was reset, or could not be reached."""
        for known in self.known.values():
            if name in (None, known.name):
                known.reset = self.world.now

    def heard(self, order: Order) -> None:
        """Take a command that has reached the gateway."""
        known = self.of(order.drive)
        if known is None:
            return
        known.is_commanded = True
        if order.value is not None:
            known.asked[int(order.value * HUNDREDTHS)] = order
        if order.verb.is_stopping:
            known.stopped = self.world.now
        elif order.verb is Verb.ARM:
            known.armed = self.world.now

    def event(self, drive: str, event: str) -> None:
        """Take what the gateway says of itself: since when it leaves a drive alone."""
        known = self.of(drive)
        if known is not None and event in ("quiesced", "awake"):
            known.quiet = self.world.now if event == "quiesced" else None

    # ---- the frames

    @property
    def gap(self) -> float:
        """Return the silence before a frame, in which it is no longer called back."""
        return 3.5 * 11 / self.setup.baud

    def frame(self, data: bytes) -> None:
        """Judge a frame."""
        first = next(iter(self.known.values()))
        is_toshiba = self.setup.protocol != "modbus-rtu"
        reading = recorder.read(data, tuple(self.known), first.drive.model.blocks, is_toshiba=is_toshiba)
        for number in reading.numbers:
            known = self.known[number]
            if known.quiet is not None and self.world.now > known.quiet + self.gap + ROUNDING:
                self.tell(f"{known.name} is left alone since {known.quiet:.3f}, and yet sent {data.hex(' ')}")
        if not self.world.looks_at_write:
            self.unaware += 1
            return  # it was on its way to the port when the process was stopped: nobody could call it back
        block = [write for write in reading.writes if write.address == recorder.SELECTED]
        if block:
            self._block(self.known[block[0].number], tuple(write.word for write in block))
        for write in reading.writes:
            if write not in block:
                self._write(self.known[write.number], write)

    def _block(self, known: Known, words: tuple[int, ...]) -> None:
        """Judge what is written where F870 and F871 select: a trial while the motor stands, or a command."""
        registers, memory = known.drive.model.registers, known.drive.inverter.memory
        names = (COMMAND, FREQUENCY)[: 2 if self.setup.protocol == "modbus-rtu" else 1]
        given = dict(zip(names, words, strict=False))
        self.world.note("block", known.name, *(f"{word:04X}" for word in words))
        if given[COMMAND] == COMMAND_WORD and given.get(FREQUENCY, FREQUENCY_WORDS[0]) in FREQUENCY_WORDS:
            if known.drive.inverter.is_running or memory.word(COMMAND) not in (0, COMMAND_WORD):
                self.tell(f"{known.name}: the exchange was tried while it runs, or is commanded")
            known.held.add(memory.word(FREQUENCY))  # also what a process has left that was killed within its trial
            return
        for name, word in given.items():
            self._write(known, Written(known.drive.number, registers[name].address, word, is_stored=False))

    def _write(self, known: Known, write: Written) -> None:
        self.world.note("write", known.name, f"{write.address:04X}", f"{write.word:04X}", write.is_stored)
        model = known.drive.model
        if known.held and self._puts_right(known, write):
            return
        if not known.is_commanded and write.address not in _watchdog(model):
            self.tell(f"{known.name}: {write.address:04X}H = {write.word:04X}H was written before any command")
        command = model.registers[COMMAND]
        if write.address == command.address and runs(command, write.word):
            known.held.clear()  # whatever was to be put right
            self._run(known)
        if write.address == model.registers[FREQUENCY].address:
            self._setpoint(known, write.word)

    def _puts_right(self, known: Known, write: Written) -> bool:
        """Say whether a write is what a trial of the exchange owes: FA00 is 0 again, FA01 as it was, once."""
        registers, memory = known.drive.model.registers, known.drive.inverter.memory
        if write.address == registers[COMMAND].address:
            return write.word == 0 and memory.word(COMMAND) in (0, COMMAND_WORD)
        if write.address != registers[FREQUENCY].address or write.word not in known.held:
            return False
        if memory.word(FREQUENCY) not in {*FREQUENCY_WORDS, *known.held}:
            return False
        if known.drive.inverter.is_running:
            self.tell(f"{known.name}: FA01 is put right after a trial, and it runs")
        return True

    def _run(self, known: Known) -> None:
        """Judge a command word that runs the motor: lease, owner, arming, and no stop since."""
        now, permission = self.world.now, self.oracle.watched[known.name].permission
        begun = now - self.gap - ROUNDING
        if permission.until < begun:
            self.tell(f"{known.name}: run was written {now - permission.until:.3f} s after the lease of the owner")
        elif not permission.runs and known.stopped < begun:
            self.tell(f"{known.name}: run was written after a stop, though nobody has run it since")
        if known.armed == float("-inf"):
            self.tell(f"{known.name}: run was written, and it was never armed")
        late = MARK_FRESH + 2 * self.setup.exchange
        if known.armed < known.reset < now - late:
            since = now - known.reset
            self.tell(f"{known.name}: run was written {since:.3f} s after a reset, and it was not armed since")

    def _setpoint(self, known: Known, word: int) -> None:
        """Judge a setpoint: each value is asked for by one command only."""
        order, text, now = known.asked.get(word), f"{known.name}: {word / HUNDREDTHS} Hz", self.world.now
        if order is None or order.delivered is None:
            self.tell(f"{text} was written, and nobody has asked for it")
            return
        order.written += 1
        if order.written > 1:
            self.tell(f"{text} was written {order.written} times for one command")
        if not order.is_owners:
            self.tell(f"{text} was written for {order.source}, who did not own the drive")
        begun = now - self.gap - ROUNDING
        if order.delivered < known.stopped < begun:
            self.tell(f"{text} was written, and is older than the last stop")
        if order.delivered + self.setup.command_timeout < begun:
            self.tell(f"{text} was written {now - order.delivered:.3f} s after it was asked for")


def _watchdog(model: Model) -> set[int]:
    connector = model.connector()
    roles = connector.parameters if connector else {}
    return {model.registers[roles[role]].address for role in WATCHDOG if role in roles}
