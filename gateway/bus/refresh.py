"""How long a good exchange with a drive may take to be had when everything happens at once, against its F803.

The reckoning that `keepalive` relies on, made before anything runs (SAFETY.md H06, H30). All times are in seconds.
One exchange takes at most: the gap before it, the request, the gap and the drive's processing, the line's margin,
the longest answer, the silence that is awaited behind a late or damaged one, and the gateway's own time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import ROUND_CEILING, Decimal

from gateway.bus.keepalive import BROADCASTS_AHEAD, PER_TIMEOUT, STOPS_AHEAD, TRIES
from gateway.control.composing import COMMAND
from gateway.control.watchdog import contradictions
from gateway.protocol.codec import Answering, Codec, NoSuchForm
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Identify,
    ReadBlock,
    ReadWords,
    Request,
    WriteRam,
    WriteStored,
)
from gateway.site import Drive, Line, Site

OWN_TIME = 0.003  # of the gateway for each exchange: waits in whole milliseconds, decoding, publishing
KEEPALIVE_SHARE = 0.8  # of the line at the most, while nothing goes wrong
GAPS = 4  # before the request, behind it, and two of silence behind an answer that was late or damaged
LONGEST_TIMEOUT = Decimal(100)  # of F803 (E6581657 6.3)
MANY = 4  # drives that are counted, not named
FORMS: Mapping[type[Request], str] = {
    ReadWords: "read",
    ReadBlock: "block read",
    Identify: "identification",
    WriteRam: "write",
    WriteStored: "write to the EEPROM",
}


@dataclass(frozen=True, slots=True)
class Longest:
    """The longest exchange of some, and what it is."""

    seconds: float
    what: str


@dataclass(frozen=True, slots=True)
class WorstCase:
    """What a good exchange with a drive of one line may have to wait for, at the worst and all at once.

    `blocking` is the exchange under way, whatever it is. `turns` are the keepalives of the controlled drives, reads
    or frames of their commands, lost once and repeated. `stops` are what stopping each of them takes ahead of that,
    `broadcasts` the emergency stops that are told to all. `room` is by how much an interval has to be longer than
    all that, so that keepalives leave a fifth of the line to everything else while nothing goes wrong.
    """

    blocking: Longest
    turns: Mapping[str, float]
    stops: Mapping[str, float]
    broadcasts: float
    room: float = 0.0

    @property
    def stopping(self) -> float:
        """Return what stopping every drive but one takes: a drive's own stop is an exchange with it."""
        return sum(self.stops.values()) - min(self.stops.values(), default=0.0)

    @property
    def lead(self) -> float:
        """Return how long before its deadline a drive has to go first."""
        return self.blocking.seconds + sum(self.turns.values()) + self.stopping + self.broadcasts

    @property
    def least_interval(self) -> float:
        """Return the shortest time between two good exchanges that can be promised."""
        return self.lead + self.room

    @property
    def least_timeout(self) -> Decimal:
        """Return the shortest F803 that can be kept, in its steps of 0.1 s."""
        return (PER_TIMEOUT * Decimal(str(self.least_interval))).quantize(Decimal("0.1"), ROUND_CEILING)


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
        return self.worst.least_interval <= self.interval

    @property
    def margin(self) -> float:
        """Return what share of the interval is left in the worst case; negative where it is not kept."""
        return 1 - self.worst.least_interval / self.interval

    def __str__(self) -> str:
        verdict = f"kept, margin {self.margin:.0%}" if self.is_kept else "TOO SHORT"
        return (
            f"F803 {self.timeout:.1f} s: a good exchange is due every {self.interval:.3f} s;"
            f" worst case {self.worst.least_interval:.3f} s = {' + '.join(self._terms())}: {verdict}"
        )

    def _terms(self) -> Iterator[str]:
        worst, own = self.worst, self.worst.turns[self.drive]
        others = [name for name in worst.turns if name != self.drive]
        named = ", ".join(others) if len(others) < MANY else f"{len(others)} other drives"
        yield f"{worst.blocking.seconds:.3f} an exchange under way ({worst.blocking.what})"
        if others:
            yield f"{sum(worst.turns.values()) - own:.3f} keepalive of {named}, lost once and repeated"
            yield f"{worst.stopping:.3f} stop of {named}"
        if worst.broadcasts:
            yield f"{worst.broadcasts:.3f} emergency stop of the whole line"
        yield f"{own:.3f} its own exchange, lost once and repeated"
        yield f"{worst.room:.3f} room for all else"


def worst_case(line: Line) -> WorstCase:
    """Reckon a line: every drive may be dead, every controlled one may have an F803 and be stopped just now."""
    controlled = [drive for drive in line.drives if drive.is_controlled]
    longest = {drive.name: _longest(line, drive, [*_reads(drive), *_writes(drive)]) for drive in line.drives}
    return WorstCase(
        blocking=max(longest.values(), key=lambda each: each.seconds),
        turns={drive.name: TRIES * longest[drive.name].seconds for drive in controlled},
        stops={drive.name: STOPS_AHEAD * _longest(line, drive, _stops(drive)).seconds for drive in controlled},
        broadcasts=_broadcasts(line) if len(controlled) == len(line.drives) else 0.0,
        room=sum(_glance(line, drive) for drive in controlled) / KEEPALIVE_SHARE,
    )


def turn(line: Line, drive: Drive) -> float:
    """Return how long a good keepalive exchange with a drive takes at the most, in seconds."""
    return _longest(line, drive, _reads(drive)).seconds


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
    """List what is configured of communication time-outs and cannot be kept: key, arithmetic, and what to do."""
    return [text for index, line in enumerate(site.lines) for text in _refusals(index, line)]


def _refusals(index: int, line: Line) -> Iterator[str]:
    kept = {refresh.drive: refresh for refresh in refreshes(line)}
    for place, drive in enumerate(line.drives):
        if drive.section is None or not drive.is_controlled:
            continue
        key = f"line[{index}].drive[{place}] ({drive.name})"
        for name, text in contradictions(drive.section, drive.model):
            yield f"{key}.{name}: {text}"
        refresh = kept.get(drive.name)
        if refresh is not None and not refresh.is_kept:
            yield f"{key}.communication_timeout: {refresh}; {remedy(line, refresh.worst)}"


# ---- what an exchange takes


def _longest(line: Line, drive: Drive, requests: list[Request]) -> Longest:
    """Return the longest of some exchanges with a drive."""
    times = [Longest(at_most(line, drive, request), f"{drive.name}: {FORMS[type(request)]}") for request in requests]
    return max(times, key=lambda longest: longest.seconds)


def at_most(line: Line, drive: Drive, request: Request) -> float:
    """Return how long an exchange takes at the most: answered in time or late, damaged, or not at all."""
    times = drive.model.times
    processing = (times.eeprom if isinstance(request, WriteStored) else times.processing) + drive.wait_time
    return _exchange(line, drive.codec, request, processing)


def _glance(line: Line, drive: Drive) -> float:
    """Return how long a keepalive takes that goes well: a single read."""
    codec, read = drive.codec, ReadWords(drive.number, 0)
    processing = drive.model.times.processing + drive.wait_time
    return OWN_TIME + line.timing.exchange(len(codec.encode(read)), codec.answer_size(read), processing)


def _exchange(line: Line, codec: Codec, request: Request, processing: float) -> float:
    timing = line.timing
    sent = timing.request(len(codec.encode(request)))
    if codec.answering(request) is Answering.NEVER:
        return OWN_TIME + timing.gap + sent + timing.gap + processing
    answer = timing.answer(max(codec.answer_size(request), codec.least_answer(request)))
    return OWN_TIME + GAPS * timing.gap + sent + processing + line.margin + answer


def _reads(drive: Drive) -> list[Request]:
    """Return the longest read of each form, an identification among them: it repeats what was lost."""
    number, blocks, forms = drive.number, drive.model.blocks, drive.codec.forms
    requests: list[Request] = [ReadWords(number, 0)]
    if forms.has_identification:
        requests.append(Identify(number))
    if forms.has_direct_block and blocks.direct_read_maximum:
        requests.append(ReadWords(number, 0, blocks.direct_read_maximum))
    if forms.has_block and blocks.indirect_read_maximum:
        requests.append(ReadBlock(number, blocks.indirect_read_address, blocks.indirect_read_maximum))
    return requests


def _writes(drive: Drive) -> list[Request]:
    """Return the longest write of each form that the gateway makes."""
    requests: list[Request] = [WriteRam(drive.number, 0, 0)]
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


def _stops(drive: Drive) -> list[Request]:
    """Return the frames of a stop: the command word, and reading it back."""
    return [WriteRam(drive.number, _command(drive), 0), ReadWords(drive.number, _command(drive))]


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
