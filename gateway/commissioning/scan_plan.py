"""What a scan tries, in which order, and how long that takes at the most."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

from gateway.bus.groups import MODBUS, family
from gateway.config import LineSection
from gateway.drives.model import Model
from gateway.errors import BadConfig
from gateway.protocol.pdu import Identify, ReadWords, Request
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.timing import LineTiming

BAUDS = (19200, 9600, 38400)  # as shipped first
PARITIES = ("even", "none", "odd")
TOSHIBA = ("toshiba-binary", "toshiba-ascii")  # drives speak both; the numbers of the binary mode end at 63
LIKELY = range(1, 17)  # numbers that are tried everywhere before any other
HIGHEST = 247  # inverter number, of any protocol
RANGE = re.compile(r"([0-9]{1,3})(?:-([0-9]{1,3}))?")
WHOEVER = None  # a TOSHIBA request without a number is answered by every drive (E6581657 4.1)


@dataclass(frozen=True, slots=True)
class Setting:
    """Baud rate and parity."""

    baud: int
    parity: str

    def __str__(self) -> str:
        return f"{self.baud} baud, {self.parity} parity" if self.parity != "none" else f"{self.baud} baud, no parity"


@dataclass(frozen=True, slots=True)
class Probe:
    """One question: is there a drive with that number, or, in TOSHIBA, any drive at all."""

    protocol: str
    number: int | None
    request: Request


@dataclass(frozen=True, slots=True)
class Wish:
    """What to look for. `numbers` is empty where all are wanted; `wait_time` is F805 at the most, in seconds.

    `is_each_baud`: the baud rates were asked for, and are tried even where the port itself has none (a pty, which
    another program may carry to a line).
    """

    port: str
    bauds: tuple[int, ...] = BAUDS
    parities: tuple[str, ...] = PARITIES
    protocols: tuple[str, ...] = (*TOSHIBA, MODBUS)
    numbers: tuple[int, ...] = ()
    wait_time: float = 0.0
    is_all: bool = False
    is_each_baud: bool = False


def numbers_of(text: str) -> tuple[int, ...]:
    """Read "1-16,20"; BadConfig says the form."""
    numbers: list[int] = []
    for part in text.split(","):
        match = RANGE.fullmatch(part.strip())
        if match is None:
            raise BadConfig(f"--numbers {text!r}: give numbers from 0 to {HIGHEST}, such as 1-16,20")
        first, last = int(match[1]), int(match[2] or match[1])
        if (top := max(first, last)) > HIGHEST:
            raise BadConfig(f"--numbers {text!r}: {top} is above {HIGHEST}; give numbers such as 1-16,20")
        if first > last:
            raise BadConfig(f"--numbers {text!r}: {part.strip()} is empty; give {last}-{first}")
        numbers += range(first, last + 1)
    return tuple(dict.fromkeys(numbers))


def check_numbers(protocols: Sequence[str], numbers: Sequence[int]) -> None:
    """Refuse (BadConfig) numbers that none of the protocols has: nothing would be asked."""
    if not numbers or any(number in PROTOCOLS[name].forms.numbers for name in protocols for number in numbers):
        return
    ranges = {name: PROTOCOLS[name].forms.numbers for name in protocols}
    known = ", ".join(f"{name} {each[0]} to {each[-1]}" for name, each in ranges.items())
    given = ", ".join(map(str, numbers))
    raise BadConfig(f"--numbers {given}: no protocol that is tried has these: {known}")


def protocols_of(names: Iterable[str]) -> tuple[str, ...]:
    """Read protocols: "toshiba" stands for both of its modes; BadConfig says what there is."""
    found: list[str] = []
    for name in names:
        if name != "toshiba" and name not in PROTOCOLS:
            raise BadConfig(f"--protocol {name}: give toshiba, {', '.join(PROTOCOLS)}")
        found += TOSHIBA if name == "toshiba" else (name,)
    return tuple(dict.fromkeys(found)) or (*TOSHIBA, MODBUS)


def one_of(option: str, given: Sequence[int] | Sequence[str], key: str) -> None:
    """Check values of a line's setting; BadConfig says what there is."""
    known = get_args(LineSection.model_fields[key].annotation)
    for value in given:
        if value not in known:
            raise BadConfig(f"{option} {value}: give {', '.join(map(str, known))}")


def settings(wish: Wish, *, has_parity: bool, has_baud: bool) -> tuple[Setting, ...]:
    """Return the settings to try, the likely ones first; where a port has no parity or baud rate, one is enough."""
    parities = wish.parities if has_parity else wish.parities[:1]
    bauds = wish.bauds if has_baud else wish.bauds[:1]
    return tuple(Setting(baud, parity) for parity in parities for baud in bauds)


def first_look(wish: Wish, models: Mapping[str, Model]) -> tuple[Probe, ...]:
    """Return what is tried at every setting: is anybody there who speaks TOSHIBA; likely MODBUS-RTU numbers."""
    anybody = [_probe(name, WHOEVER, models) for name in wish.protocols if family(name) == "TOSHIBA"]
    if wish.numbers:
        return (*anybody, *_numbered(wish.protocols, wish.numbers, models))
    return (*anybody, *_numbered(set(wish.protocols) & {MODBUS}, LIKELY, models))


def second_look(wish: Wish, models: Mapping[str, Model]) -> tuple[Probe, ...]:
    """Return what is tried at a setting only where the first look found something, or nothing anywhere."""
    if wish.numbers:
        return ()
    rest = [number for number in PROTOCOLS[MODBUS].forms.numbers if number not in LIKELY]
    return _numbered(set(wish.protocols) & {MODBUS}, rest, models)


def everything(wish: Wish, models: Mapping[str, Model]) -> tuple[Probe, ...]:
    """Return what is asked at each setting where nobody answers: the first look is repeated with the second."""
    first = first_look(wish, models)
    return (*first, *first, *second_look(wish, models))


def every_toshiba(wish: Wish, models: Mapping[str, Model]) -> tuple[Probe, ...]:
    """Return the numbers of TOSHIBA drives, where any drive answered; those beyond 63 in ASCII."""
    if wish.numbers:
        return ()
    names = [name for name in TOSHIBA if name in wish.protocols]
    probes: list[Probe] = []
    for name in names:
        new = [n for n in PROTOCOLS[name].forms.numbers if n not in [probe.number for probe in probes]]
        probes += _numbered([name], new, models)
    return tuple(probes)


def worth_a_second_try(silent: Iterable[Probe], wish: Wish) -> tuple[Probe, ...]:
    """Return the numbers that are asked again where others answered: one lost frame shall not hide a drive."""
    wanted = set(wish.numbers or (0, *LIKELY))
    return tuple(probe for probe in silent if probe.number in wanted)


def _numbered(protocols: Iterable[str], numbers: Iterable[int], models: Mapping[str, Model]) -> tuple[Probe, ...]:
    wanted = tuple(numbers)
    return tuple(_probe(p, n, models) for p in protocols for n in wanted if n in PROTOCOLS[p].forms.numbers)


def _probe(protocol: str, number: int | None, models: Mapping[str, Model]) -> Probe:
    """Ask for the identification where the protocol has it, for the status where not: no answer is too long."""
    if number is not None and PROTOCOLS[protocol].forms.has_identification:
        return Probe(protocol, number, Identify(number))
    status = next(model.registers["status"] for model in models.values() if "status" in model.registers)
    return Probe(protocol, number, ReadWords(number, status.address))


def patience(models: Mapping[str, Model], wait_time: float) -> float:
    """Return how long the slowest model may take to begin an answer, in seconds."""
    return max(model.times.processing for model in models.values()) + wait_time


def longest(probes: Iterable[Probe], setting: Setting, processing: float, margin: float) -> float:
    """Return how many seconds these probes take where nobody answers."""
    timing = LineTiming(setting.baud)
    return sum(
        timing.gap
        + timing.request(len(PROTOCOLS[probe.protocol].encode(probe.request)))
        + timing.gap
        + processing
        + margin
        + timing.gap
        for probe in probes
    )
