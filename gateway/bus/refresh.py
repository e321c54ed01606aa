"""How long a good exchange with a drive may take to be had when much happens at once, against its F803.

The reckoning that `keepalive` relies on, made before anything runs (SAFETY.md H06, H30). All times are in seconds.

An exchange takes at most: the gap before it, the request, the gap and the drive's processing, the line's margin, the
longest answer, the silence that is awaited behind a late or damaged one, and the gateway's own time. A good turn is
an exchange that keeps a drive and is answered in time: without the margin, and with two gaps.

Premise: within one lead at most one exchange of the line is lost beside the one that is under way.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from decimal import ROUND_CEILING, Decimal

from gateway.bus.keepalive import BROADCASTS_AHEAD, PER_TIMEOUT, STOPS_AHEAD
from gateway.control.composing import COMMAND
from gateway.control.watchdog import contradictions
from gateway.protocol.codec import Answering, Codec, NoSuchForm
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Identify,
    ReadBlock,
    ReadWords,
    Request,
    WriteRam,
    WriteStored,
)
from gateway.site import Drive, Line, Site

OWN_TIME = 0.003  # of the gateway for each exchange: waits in whole milliseconds, decoding, publishing
GAPS = 4  # before the request, behind it, and two of silence behind an answer that was late or damaged
LONGEST_TIMEOUT = Decimal(100)  # of F803 (E6581657 6.3)
MANY = 4  # drives that are counted, not named
FORMS: Mapping[type[Request], str] = {
    ReadWords: "read",
    ReadBlock: "block read",
    Identify: "identification",
    WriteRam: "write",
    WriteStored: "write to the EEPROM",
    Exchange: "block exchange",
}


@dataclass(frozen=True, slots=True)
class Longest:
    """The longest exchange of some, and what it is."""

    seconds: float
    what: str


@dataclass(frozen=True, slots=True)
class WorstCase:
    """What a good exchange with a drive of one line may have to wait for, at the worst and all at once.

    `blocking` is the exchange under way, whatever it is. `lost` is the longest keepalive that comes to nothing.
    `turns` are the keepalives of the controlled drives that are answered: reads, or frames of their commands.
    `broadcasts` are the emergency stops that are told to all.
    """

    blocking: Longest
    lost: Longest
    turns: Mapping[str, float]
    broadcasts: float

    @property
    def stopping(self) -> float:
        """Return what stopping another drive takes: a drive's own stop is its turn."""
        return STOPS_AHEAD * max(self.turns.values()) if len(self.turns) > 1 else 0.0

    @property
    def lead(self) -> float:
        """Return how long before its deadline a drive has to go first: the shortest interval that can be promised."""
        return self.blocking.seconds + self.lost.seconds + sum(self.turns.values()) + self.stopping + self.broadcasts

    @property
    def least_timeout(self) -> Decimal:
        """Return the shortest F803 that can be kept, in its steps of 0.1 s."""
        return (PER_TIMEOUT * Decimal(str(self.lead))).quantize(Decimal("0.1"), ROUND_CEILING)


@dataclass(frozen=True, slots=True)
class Refresh:
    """How one drive's F803 of `timeout` seconds is kept, and with it what its worst case is made of."""

    drive: str
    timeout: float
    worst: WorstCase

    @property
    def interval(self) -> float:
        """Return within what time a good exchange is due."""
        return self.timeout / PER_TIMEOUT

    @property
    def is_kept(self) -> bool:
        """Say whether it can be had whatever the line is doing."""
        return self.worst.lead <= self.interval

    @property
    def margin(self) -> float:
        """Return what share of the interval is left in the worst case; negative where it is not kept."""
        return 1 - self.worst.lead / self.interval

    def __str__(self) -> str:
        verdict = f"kept, margin {self.margin:.0%}" if self.is_kept else "TOO SHORT"
        return (
            f"F803 {self.timeout:.1f} s: a good exchange is due every {self.interval:.3f} s;"
            f" worst case {self.worst.lead:.3f} s = {' + '.join(self._terms())}: {verdict}"
        )

    def _terms(self) -> Iterator[str]:
        worst, own = self.worst, self.worst.turns[self.drive]
        others = [name for name in worst.turns if name != self.drive]
        named = ", ".join(others) if len(others) < MANY else f"{len(others)} other drives"
        yield f"{worst.blocking.seconds:.3f} an exchange under way ({worst.blocking.what})"
        yield f"{worst.lost.seconds:.3f} a lost exchange ({worst.lost.what})"
        if others:
            yield f"{sum(worst.turns.values()) - own:.3f} turn of {named}"
            yield f"{worst.stopping:.3f} stop of another drive"
        if worst.broadcasts:
            yield f"{worst.broadcasts:.3f} emergency stop of the whole line"
        yield f"{own:.3f} its own turn"


def worst_case(line: Line) -> WorstCase:
    """Reckon a line: every drive may be dead, every controlled one may have an F803 and be stopped just now."""
    controlled = [drive for drive in line.drives if drive.is_controlled]
    exchanges = [_longest(line, drive, _exchanges(drive)) for drive in line.drives]
    keepalives = [_longest(line, drive, [*_turns(drive), *_identification(drive)]) for drive in controlled]
    return WorstCase(
        blocking=_longest_of(exchanges),
        lost=_longest_of(keepalives) if keepalives else Longest(0.0, "nobody is commanded"),
        turns={drive.name: OWN_TIME + turn(line, drive) for drive in controlled},
        broadcasts=_broadcasts(line) if len(controlled) == len(line.drives) else 0.0,
    )


def refreshes(line: Line) -> tuple[Refresh, ...]:
    """Return how the configured F803 of each drive is kept; what a drive has of itself only it can tell."""
    worst = worst_case(line)
    configured = [(drive.name, drive.section.communication_timeout) for drive in line.drives if drive.section]
    return tuple(Refresh(name, timeout, worst) for name, timeout in configured if timeout and name in worst.turns)


def unkept(line: Line, worst: WorstCase, drive: str, timeout: float) -> str:
    """Say that an F803 cannot be kept, and what would help; "" where it can."""
    refresh = Refresh(drive, timeout, worst)
    return "" if refresh.is_kept else f"{refresh}; {remedy(line, worst)}"


def remedy(line: Line, worst: WorstCase) -> str:
    """Say what makes an F803 keepable, the simplest first."""
    ways = []
    if worst.least_timeout <= LONGEST_TIMEOUT:
        ways.append(f"set communication_timeout to {worst.least_timeout} s or more")
    ways.append(f"lower answer_margin ({line.margin * 1000:.0f} ms) as far as adapter or network permit")
    if line.baud < 38400:
        ways.append("raise F800 and line.baud to 38400")
    if len(worst.turns) > 1:
        ways.append(f"command fewer than {len(worst.turns)} drives on this line")
    return "; or ".join(ways)


def refusals(site: Site) -> list[str]:
    """List what is configured of communication time-outs and contradicts itself or the model: key, and what to do."""
    return [
        f"{key}.{name}: {text}"
        for line, key, drive in _commanded(site)
        if drive.section is not None
        for name, text in contradictions(drive.section, drive.model)
    ]


def too_short(site: Site) -> list[str]:
    """List each configured F803 that cannot be kept whatever its line is doing: key, arithmetic, and what to do."""
    return [
        f"{key}.communication_timeout: {text}"
        for line, key, drive in _commanded(site)
        if drive.section is not None and (timeout := drive.section.communication_timeout)
        if (text := unkept(line, worst_case(line), drive.name, timeout))
    ]


def _commanded(site: Site) -> Iterator[tuple[Line, str, Drive]]:
    """Yield each drive that may be commanded, with its line and its key in the file."""
    for index, line in enumerate(site.lines):
        for place, drive in enumerate(line.drives):
            if drive.is_controlled:
                yield line, f"line[{index}].drive[{place}] ({drive.name})", drive


# ---- what an exchange takes


def _longest(line: Line, drive: Drive, requests: Iterable[Request]) -> Longest:
    """Return the longest of some exchanges with a drive."""
    return _longest_of(
        Longest(at_most(line, drive, request), f"{drive.name}: {FORMS[type(request)]}") for request in requests
    )


def _longest_of(exchanges: Iterable[Longest]) -> Longest:
    return max(exchanges, key=lambda each: each.seconds)


def at_most(line: Line, drive: Drive, request: Request) -> float:
    """Return how long an exchange takes at the most: answered in time or late, damaged, or not at all."""
    times = drive.model.times
    processing = (times.eeprom if isinstance(request, WriteStored) else times.processing) + drive.wait_time
    return _exchange(line, drive.codec, request, processing)


def turn(line: Line, drive: Drive) -> float:
    """Return how long a good turn of a drive takes on the line, as `Planner.cost` reckons it: without `OWN_TIME`.

    A poll that takes longer is no keepalive; nor is a write to the EEPROM.
    """
    codec, processing = drive.codec, drive.model.times.processing + drive.wait_time
    return max(
        line.timing.exchange(len(codec.encode(request)), codec.answer_size(request), processing)
        for request in _turns(drive)
    )


def _exchange(line: Line, codec: Codec, request: Request, processing: float) -> float:
    timing = line.timing
    sent = timing.request(len(codec.encode(request)))
    if codec.answering(request) is Answering.NEVER:
        return OWN_TIME + timing.gap + sent + timing.gap + processing
    answer = timing.answer(max(codec.answer_size(request), codec.least_answer(request)))
    return OWN_TIME + GAPS * timing.gap + sent + processing + line.margin + answer


def _turns(drive: Drive) -> list[Request]:
    """Return what a keepalive may be: a single read, the indirect block, a frame of a command, or both in one."""
    blocks = drive.model.blocks
    requests: list[Request] = [ReadWords(drive.number, 0), WriteRam(drive.number, 0, 0)]
    if drive.codec.forms.has_block and blocks.indirect_read_maximum:
        read = ReadBlock(drive.number, blocks.indirect_read_address, blocks.indirect_read_maximum)
        requests.append(read)
        if drive.block_write and drive.codec.forms.has_exchange and blocks.has_exchange:
            words = (0,) * blocks.indirect_write_words
            requests.append(Exchange(drive.number, read.address, read.count, blocks.indirect_write_address, words))
    return requests


def _identification(drive: Drive) -> list[Request]:
    """Return what a keepalive is behind a lost exchange: as a lost one it covers a lost turn and itself answered."""
    return [Identify(drive.number)] if drive.codec.forms.has_identification else []


def _exchanges(drive: Drive) -> list[Request]:
    """Return the longest exchange of each form that the gateway has with a drive."""
    blocks = drive.model.blocks
    requests = [*_turns(drive), *_identification(drive)]
    if drive.codec.forms.has_direct_block and blocks.direct_read_maximum:
        requests.append(ReadWords(drive.number, 0, blocks.direct_read_maximum))
    if _may_wear(drive):
        requests.append(WriteStored(drive.number, 0, 0))
    return requests


def _may_wear(drive: Drive) -> bool:
    """Say whether its EEPROM may be written: selectors, stored parameters, or F803 in MODBUS-RTU."""
    section = drive.section
    if section is None or not drive.is_controlled:
        return drive.provision
    asked = (section.communication_timeout, section.timeout_action, section.timeout_detection)
    sets_timeout = any(value is not None for value in asked) and not drive.codec.forms.has_ram_write
    return drive.provision or section.allow_stored or sets_timeout


def _command(drive: Drive) -> int:
    return drive.model.registers[COMMAND].address


def _broadcasts(line: Line) -> float:
    """Return what an emergency stop of the whole line takes: a frame in each protocol that has it."""
    processing = max(drive.model.times.processing + drive.wait_time for drive in line.drives)
    taken = 0.0
    for codec in {drive.protocol: drive.codec for drive in line.drives}.values():
        try:
            taken += _exchange(line, codec, WriteRam(EVERY_DRIVE, _command(line.drives[0]), 0), processing)
        except NoSuchForm:
            continue
    return BROADCASTS_AHEAD * taken
