"""Looks for drives on a port: tries settings, protocols and numbers by reading only, and asks who is found."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from gateway import site
from gateway.bus.exchange import Exchanger
from gateway.bus.groups import family
from gateway.bus.line import LATE_AT_MOST, SETTLE, Line, Opener
from gateway.bus.serial_line import open_line
from gateway.clock import Clock
from gateway.commissioning import scan_plan
from gateway.commissioning.findings import Found, Result
from gateway.commissioning.recognition import addresses, recognise
from gateway.commissioning.scan_plan import Probe, Setting, Wish
from gateway.drives.model import Model
from gateway.errors import BadReply, NoReply, Refused
from gateway.metrics import LineStats
from gateway.protocol.pdu import Identify, Identity, ReadWords, Reply, Request, Words
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.timing import LineTiming

TRIES = 3  # of a number that answers garbage, before two drives are suspected
LISTEN = 0.5  # seconds at the most in which nobody may talk who was not asked


class Answer(Enum):
    """What came back for a probe."""

    SILENCE = "nothing"
    ANSWER = "an answer"
    GARBAGE = "bytes that are no answer"


class Watcher(Protocol):
    """Who is told how a scan gets on."""

    def begin(self, what: str, probes: int) -> None:
        """Take note that so many probes begin."""
        ...

    def step(self) -> None:
        """Take note that one of them is over."""
        ...

    def tell(self, what: str) -> None:
        """Take note of something found."""
        ...


@dataclass(slots=True)
class Search:
    """What one scan goes by: times in seconds, and where its findings go."""

    wish: Wish
    models: Mapping[str, Model]
    clock: Clock
    watcher: Watcher
    opener: Opener = open_line
    result: Result = field(default_factory=Result)

    @property
    def has_fixed_settings(self) -> bool:
        """Say whether the port is a serial server whose baud rate and parity cannot be set from here."""
        return self.wish.port.startswith("socket://")

    @property
    def margin(self) -> float:
        """Return the time for adapters and networks, beside the drive's own."""
        return site.usual_margin(self.wish.port)

    @property
    def processing(self) -> float:
        """Return how long the slowest drive may take to answer."""
        return scan_plan.patience(self.models, self.wish.wait_time)

    async def open(self, setting: Setting) -> Line:
        """Open the port at a setting; LineDown says why it cannot be opened."""
        line = site.Line(
            name="scan",
            port=self.wish.port,
            baud=setting.baud,
            parity=setting.parity,
            margin=self.margin,
            silent_share=0.0,
            probe_every=0.0,
            probe_at_most=0.0,
            drives=(),
        )
        return await self.opener(line, self.clock)


async def scan(search: Search) -> Result:
    """Try everything that is wanted, in turn, until drives are found (all of it where the wish `is_all`).

    Before a setting is given up its likely numbers are asked once more: a lost frame shall not hide an only drive.
    LineDown: the port cannot be opened. BadReply: somebody talks on the line without being asked.
    """
    settings = await _settings(search)
    first = scan_plan.first_look(search.wish, search.models)
    rest = scan_plan.second_look(search.wish, search.models)
    if await _look(search, settings, first, rest) and not search.wish.is_all:
        return search.result
    tried = {found.setting for found in search.result.found}
    await _look(search, [setting for setting in settings if setting not in tried], (*first, *rest), ())
    return search.result


async def _settings(search: Search) -> Sequence[Setting]:
    """Return the settings that make a difference on this port."""
    port = await search.open(Setting(search.wish.bauds[0], search.wish.parities[0]))
    is_pty = port.is_pty
    port.close()
    if is_pty:
        search.result.notes.append(
            "a pseudo-terminal has no parity and no baud rate: these are the ones tried, not those of the line behind"
        )
    if search.has_fixed_settings:
        search.result.notes.append("baud rate and parity are set in the serial server, and were not tried")
    has_any = not is_pty and not search.has_fixed_settings
    has_baud = has_any or (is_pty and search.wish.is_each_baud)
    return scan_plan.settings(search.wish, has_parity=has_any, has_baud=has_baud)


async def _look(search: Search, settings: Sequence[Setting], probes: Sequence[Probe], rest: Sequence[Probe]) -> bool:
    """Try probes at each setting, and the rest where something is there; say whether a drive was found."""
    is_found = False
    for setting in settings if probes else ():
        port = await search.open(setting)
        try:
            place = _Place(setting, port, search)
            await place.listen()
            search.watcher.begin(str(setting), len(probes))
            if await place.try_all(probes):
                more = scan_plan.every_toshiba(search.wish, search.models) if place.hears_toshiba else ()
                search.watcher.begin(f"{setting}, all numbers", len(more) + len(rest))
                await place.try_all((*more, *rest))
                again = scan_plan.worth_a_second_try(place.silent, search.wish)
                search.watcher.begin(f"{setting}, once more", len(again))
                await place.try_all(again)
        finally:
            port.close()
        is_found |= any(found.setting == setting for found in search.result.found)
        if is_found and not search.wish.is_all:
            break
    return is_found


class _Place:
    """The line at one setting."""

    def __init__(self, setting: Setting, port: Line, search: Search) -> None:
        self.hears_toshiba = False
        self.silent: list[Probe] = []
        self._setting = setting
        self._port = port
        self._search = search
        self._result = search.result
        self._stats = LineStats()
        self._exchanger = Exchanger(port, LineTiming(setting.baud), search.margin, search.clock, self._stats)
        self._known: set[tuple[str, int]] = set()

    async def listen(self) -> None:
        """Let what is left of others pass; BadReply where somebody goes on talking."""
        await self._port.drain(SETTLE, 2 * SETTLE)
        if heard := await self._port.drain(SETTLE, LISTEN):
            raise BadReply(
                f"{self._search.wish.port}: {heard} bytes that nobody asked for: another master talks on this line"
            )

    async def try_all(self, probes: Iterable[Probe]) -> bool:
        """Try probes one after another; say whether anything at all came back."""
        is_heard = False
        for probe in probes:
            answer, reply = await self._ask(probe)
            self._search.watcher.step()
            if answer is Answer.SILENCE:
                self.silent.append(probe)
                continue
            is_heard = True
            if probe.number is None:
                self.hears_toshiba = True
            elif answer is Answer.GARBAGE:
                self._garbled(probe.protocol, probe.number)
            else:
                await self._take(probe.protocol, probe.number, reply)
        return is_heard

    async def _ask(self, probe: Probe) -> tuple[Answer, Reply | None]:
        """Ask once; again where it is not understood, for a late answer of another number is none of this one's."""
        is_disturbed = False
        for _ in range(TRIES):
            early = self._stats.errors["early"]
            try:
                return Answer.ANSWER, await self._exchange(probe.protocol, probe.request)
            except Refused:
                return Answer.ANSWER, None
            except NoReply:
                if self._stats.errors["early"] == early:
                    self._result.has_late_answers |= is_disturbed
                    return Answer.SILENCE, None
            except BadReply:
                if probe.number is None:
                    return Answer.GARBAGE, None
                is_disturbed = True
                late = max(LATE_AT_MOST, 2 * self._search.margin)
                await self._port.drain(late, 2 * late)
        return Answer.GARBAGE, None

    async def _exchange(self, protocol: str, request: Request) -> Reply | None:
        return (await self._exchanger.exchange(PROTOCOLS[protocol], request, self._search.processing)).reply

    async def _take(self, protocol: str, number: int, reply: Reply | None) -> None:
        """Ask a drive who it is and how it is set, and take it down; a TOSHIBA drive once, whatever the mode."""
        if (family(protocol), number) in self._known:
            return
        self._known.add((family(protocol), number))
        models = self._search.models
        identity = reply if isinstance(reply, Identity) else None
        if identity is None and PROTOCOLS[protocol].forms.has_identification:
            identity = await self._identity(protocol, number)
        words = await self._read(protocol, number, addresses(models))
        recognised = recognise(models, identity, words)
        settings: Mapping[str, int] = {}
        connector = recognised.model.connector() if recognised.model else None
        if recognised.model is not None and connector is not None:
            at = {recognised.model.registers[name].address: role for role, name in connector.parameters.items()}
            settings = await self._read(protocol, number, at)
        found = Found(self._setting, protocol, number, recognised, words, settings)
        self._result.found.append(found)
        self._search.watcher.tell(f"number {number}, {protocol}: {found.model_name}")

    async def _identity(self, protocol: str, number: int) -> Identity | None:
        answer, reply = await self._ask(Probe(protocol, number, Identify(number)))
        return reply if answer is Answer.ANSWER and isinstance(reply, Identity) else None

    async def _read(self, protocol: str, number: int, wanted: Mapping[int, str]) -> dict[str, int]:
        """Read what a drive has of some numbers."""
        words = {}
        for address, name in wanted.items():
            answer, reply = await self._ask(Probe(protocol, number, ReadWords(number, address)))
            if answer is Answer.GARBAGE:
                self._garbled(protocol, number)
            if isinstance(reply, Words):
                words[name] = reply.words[0]
        return words

    def _garbled(self, protocol: str, number: int) -> None:
        if (self._setting, protocol, number) not in self._result.garbled:
            self._result.garbled.append((self._setting, protocol, number))
