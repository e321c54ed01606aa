"""A drive model: its registers, its block forms, its times and how it says who it is."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from gateway.drives.register import Derived, Register


@dataclass(frozen=True, slots=True)
class BlockForms:
    """Which block forms a model has; a count of 0 says that it has not got the form.

    The indirect block carries the values that the selectors F875-F879 name; a direct block carries
    consecutive numbers, 8000H where none exists. `direct_ranges` are the numbers for which the manual
    shows direct blocks; elsewhere a drive may refuse them, which is found out by trying.
    """

    indirect_read_address: int = 0
    indirect_read_minimum: int = 0
    indirect_read_maximum: int = 0
    indirect_write_address: int = 0
    indirect_write_words: int = 0
    has_exchange: bool = False
    direct_read_maximum: int = 0
    direct_ranges: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, slots=True)
class DriveTimes:
    """How long a model may take, in seconds (response time, Appendix 2 of the manuals)."""

    processing: float = 0.015
    eeprom: float = 0.050
    start_up: float = 1.0


@dataclass(frozen=True, slots=True)
class Connector:
    """The names of the communication parameters of one RS485 connector, by their role.

    Roles: baud_rate, parity, number, timeout, timeout_action, timeout_detection, wait_time, protocol,
    master_slave. An absent one is a parameter that the model has not got, or its manual does not tell of.
    `block_write` and `block_read` name the block selectors (F870-F871, F875-F879), in order.
    """

    name: str
    parameters: Mapping[str, str] = field(default_factory=dict)
    block_write: tuple[str, ...] = ()
    block_read: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Cautions:
    """What to be careful of when writing to a model.

    `never` are communication numbers that the gateway does not write. `keys` and `may_start` are register names:
    those that take the panel's keys away, and those by which a motor may start. `unanswered` names the bit of a
    register that the drive obeys without an answer.
    """

    never: frozenset[int] = frozenset()
    keys: frozenset[str] = frozenset()
    may_start: frozenset[str] = frozenset()
    unanswered: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Foreign:
    """A communication number by which a drive tells that it is of another model, where nothing else tells who it is.

    Without `words` whoever knows the number is another model; with them whoever answers one of them.
    """

    address: int
    words: frozenset[int] = frozenset()
    means: str = ""


@dataclass(frozen=True, slots=True)
class Model:
    """One drive model of the catalogue.

    `identity` begins the device reference that a drive of this model answers to 2BH; empty where unknown.
    `foreign` are numbers that tell another model. `read_selectors` and `write_selectors` map the value of a block
    selector to a register name ("" for none). `capacities` names the type form for each FB05 code. `profile` is
    what to poll when nobody says.
    """

    name: str
    title: str
    source: str
    registers: Mapping[str, Register]
    identity: str = ""
    series_code: int | None = None
    foreign: tuple[Foreign, ...] = ()
    times: DriveTimes = field(default_factory=DriveTimes)
    blocks: BlockForms = field(default_factory=BlockForms)
    connectors: tuple[Connector, ...] = ()
    cautions: Cautions = field(default_factory=Cautions)
    read_selectors: Mapping[int, str] = field(default_factory=dict)
    write_selectors: Mapping[int, str] = field(default_factory=dict)
    capacities: Mapping[int, str] = field(default_factory=dict)
    derived: tuple[Derived, ...] = ()
    profile: tuple[tuple[tuple[str, ...], str], ...] = ()
    by_address: Mapping[int, Register] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        by_address = {register.address: register for register in self.registers.values()}
        object.__setattr__(self, "by_address", by_address)

    def at(self, address: int) -> Register | None:
        """Return the register with that communication number, or None."""
        return self.by_address.get(address)

    def connector(self, name: str = "") -> Connector | None:
        """Return the connector of that name, the first one by default, or None."""
        return next((c for c in self.connectors if name in ("", c.name)), None)

    def trip_signs(self, words: Iterable[tuple[int, int]]) -> dict[str, bool]:
        """Return what (communication number, word) pairs tell of a trip: by FC90's code, and by FD01's bit."""
        signs = {}
        for address, word in words:
            register = self.by_address.get(address)
            if register is None or register.name not in ("trip_code", "status"):
                continue
            bit = next((bit for bit, name in register.bits.items() if name == "tripped"), None)
            if register.name == "trip_code":
                signs[register.name] = word != 0
            elif bit is not None:
                signs[register.name] = bool(word >> bit & 1)
        return signs
