"""What holds in every protocol, over the line: refusals while running, what a power cut leaves, a new number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from gateway.drives.register import Register
from gateway.sim.settings import SimulatedLineConfig, install
from tests.sim.rig import binary, framed, models
from tests.sim.test_wire import heard

AU1, NOTES, NUMBER, FREQUENCY = 0x0000, 0x0880, 0x0802, 0xFA01
START_UP = 1.0  # seconds from power-on until a drive hears, by its model


@dataclass(frozen=True)
class Family:
    """How a protocol asks for a word and answers, by number, address and word; a write is its own answer."""

    protocol: str
    read: Callable[[int, int], bytes]
    value: Callable[[int, int, int], bytes]
    write: Callable[[int, int, int], bytes]
    unable: Callable[[int], bytes]


MODBUS = Family(
    "modbus-rtu",
    lambda number, address: framed(f"03 {address:04X} 0001", number),
    lambda number, address, word: framed(f"03 02 {word:04X}", number),
    lambda number, address, word: framed(f"06 {address:04X} {word:04X}", number),
    lambda number: framed("86 04", number),
)
ASCII = Family(
    "toshiba",
    lambda number, address: f"({number:02d}R{address:04X})\r".encode(),
    lambda number, address, word: f"({number:02d}R{address:04X}{word:04X})\r".encode(),
    lambda number, address, word: f"({number:02d}W{address:04X}{word:04X})\r".encode(),
    lambda number: f"({number:02d}N0000)\r".encode(),
)
BINARY = Family(
    "toshiba",
    lambda number, address: binary(f"{number:02X} 52 {address:04X}"),
    lambda number, address, word: binary(f"{number:02X} 52 {address:04X} {word:04X}"),
    lambda number, address, word: binary(f"{number:02X} 57 {address:04X} {word:04X}"),
    lambda number: binary(f"{number:02X} 4E 0000"),
)


class Master:
    """Asks a line of one running drive, number 1, every half second."""

    def __init__(self, family: Family, model: str) -> None:
        self.family = family
        drive = {"number": 1, "model": model, "protocol": family.protocol, "running_at": 30}
        self.line = install(SimulatedLineConfig.model_validate({"drive": [drive]}), 0.0)
        self.now = 0.0

    def ask(self, frame: bytes) -> bytes:
        """Return what is heard within half a second, b"" for silence."""
        self.line.wire.feed(frame, self.now)
        self.now += 0.5
        return b"".join(data for _, data in heard(self.line.wire, self.now))

    def has(self, address: int, word: int, number: int = 1) -> bool:
        """Read, and say whether the answer has that word."""
        return self.ask(self.family.read(number, address)) == self.family.value(number, address, word)

    def takes(self, address: int, word: int, number: int = 1) -> bool:
        """Write to the EEPROM, where there is a place, and say whether that was acknowledged."""
        frame = self.family.write(number, address, word)
        return self.ask(frame) == frame


@pytest.fixture(params=[MODBUS, ASCII, BINARY], ids=["modbus", "ascii", "binary"])
def family(request: pytest.FixtureRequest) -> Family:
    """Take each protocol, and each mode of it."""
    assert isinstance(request.param, Family)
    return request.param


@pytest.fixture(params=["vf-nc3", "vf-mb1"])
def master(request: pytest.FixtureRequest, family: Family) -> Master:
    """Ask each model in each protocol."""
    return Master(family, str(request.param))


# each register of the catalogue that is not written while the motor turns, with its model
FOR_STANDSTILL = [
    (model.name, register)
    for model in models().values()
    for register in model.registers.values()
    if register.is_writable and not register.writable_while_running
]


def test_the_catalogue_has_a_register_that_needs_standstill() -> None:
    """AU1 of VF-nC3: otherwise the next test would try nothing."""
    assert ("vf-nc3", AU1) in [(model, register.address) for model, register in FOR_STANDSTILL]


@pytest.mark.parametrize(("model", "register"), FOR_STANDSTILL, ids=lambda part: getattr(part, "name", part))
def test_what_needs_standstill_is_refused_until_the_motor_stands(
    family: Family, model: str, register: Register
) -> None:
    """Error 04, and N0000 in TOSHIBA; the word stays, and is taken when STOP was pressed and the ramp is over."""
    master = Master(family, model)
    assert master.ask(family.write(1, register.address, 1)) == family.unable(1)
    assert master.has(register.address, register.initial)
    master.line.wire.drives[0].inverter.run_by_panel(0)
    master.now += 20
    assert master.takes(register.address, 1)
    assert master.has(register.address, 1)


def test_a_power_cycle_leaves_what_the_eeprom_has(master: Master) -> None:
    """No answer while it is off and for a second more; then RAM is empty, the motor stands, a parameter is kept."""
    assert master.takes(NOTES, 77)
    assert master.takes(FREQUENCY, 1234)
    (drive,) = master.line.wire.drives
    drive.inverter.reset(master.now, off=2.0)
    begun = master.now
    while (silent := not master.has(NOTES, 77)) and master.now < begun + 10:
        pass
    assert not silent
    assert 2 + START_UP <= master.now - begun <= 2 + START_UP + 1
    assert master.has(FREQUENCY, 0)
    assert not drive.inverter.is_running


def test_a_number_that_is_written_over_the_line_acts_at_once_and_stays(master: Master) -> None:
    """F802: the answer still has the old number, which then is nobody's; a power cycle changes nothing."""
    assert master.takes(NUMBER, 5)
    assert master.ask(master.family.read(1, NOTES)) == b""
    assert master.has(NUMBER, 5, number=5)
    master.line.wire.drives[0].inverter.reset(master.now)
    master.now += 2
    assert master.ask(master.family.read(1, NOTES)) == b""
    assert master.has(NUMBER, 5, number=5)
    assert master.takes(NUMBER, 1, number=5)
    assert master.has(NUMBER, 1)
