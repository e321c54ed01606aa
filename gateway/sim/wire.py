"""One RS485 line in time: characters take their bits, frames end by silence, and what overlaps is lost.

Times are seconds on the caller's clock. The line is half-duplex: one master, and drives that hear its every frame.
Here they do not hear each other's answers; on a real line they do, and an answer of the TOSHIBA protocol that looks
like its request, and has no number in it, is a request to them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

from gateway.protocol.timing import SPLIT_CHARACTERS, LineTiming
from gateway.sim.drive import SimulatedDrive
from gateway.sim.faults import Faults, Kind
from gateway.sim.frames import is_whole
from gateway.sim.journal import Entry, Journal, Way
from gateway.sim.script import Script
from gateway.sim.statistics import WireStatistics

ROUNDING = 1e-6  # seconds; a gap that is shorter by less than this is kept


class Delivery(Enum):
    """When the master gets an answer: whole at the end of its last character, or character by character."""

    FRAME = "frame"
    CHARACTER = "character"


@dataclass(slots=True)
class Frame:
    """What the master has sent since the last silence."""

    begin: float
    end: float
    data: bytearray
    is_lost: bool = False
    is_noise: bool = False


@dataclass(slots=True)
class Sending:
    """An answer on its way: when each character ends, and its byte."""

    begin: float
    end: float
    drive: int | None
    note: str
    characters: deque[tuple[float, int]] = field(default_factory=deque)
    heard: bytearray = field(default_factory=bytearray)


class Wire:
    """The line, its master's bytes and the drives on it; pure, so that any loop or clock can run it."""

    def __init__(
        self,
        timing: LineTiming,
        drives: Sequence[SimulatedDrive],
        faults: Faults,
        *,
        parity: str = "even",
        delivery: Delivery = Delivery.FRAME,
    ) -> None:
        self.drives = list(drives)
        self.faults = faults
        self.statistics = WireStatistics()
        self.journal = Journal()
        self.script: Script | None = None
        self._timing = timing
        self._parity = parity
        self._delivery = delivery
        self._split = timing.request(1) * SPLIT_CHARACTERS
        self._frame: Frame | None = None
        self._sent: deque[tuple[float, float]] = deque()  # begin and end of the frames before, while they matter
        self._sendings: list[Sending] = []
        self._echoes: deque[tuple[float, bytes]] = deque()
        self._busy: dict[int, float] = {}  # until when each drive, by its place, works on a frame
        self._heard: list[bytes] = []
        self._heard_at = 0.0

    # -- what the loop calls --------------------------------------------------------------------------------

    def feed(self, data: bytes, now: float, *, is_noise: bool = False) -> None:
        """Take bytes that the master wrote; its UART sends them one after another.

        `is_noise` says that it sends them at another baud rate: no drive understands them.
        """
        if not data:
            return
        self._advance(now)
        if self._frame is None and self.script is not None:
            self.script.exchange_over(now)
        frame = self._frame
        begin = now if frame is None else max(now, frame.end)
        end = begin + self._timing.request(len(data))
        if frame is None:
            self._frame = Frame(begin, end, bytearray(data), is_lost=self._begins_too_early(begin))
        else:
            self._continue(frame, begin)
            frame.data += data
            frame.end = end
        if self._frame is not None:
            self._frame.is_noise |= is_noise
        if self.faults.strikes(Kind.ECHO, (), now):
            self._echoes.append((end, data))

    def babble(self, count: int, now: float) -> None:
        """Put noise on the line at once, as a broken drive does."""
        self._advance(now)
        self._send(self.faults.noise(count), now, None, "noise")

    def next_event(self) -> float | None:
        """Return when `due` has something to do next; None while the line is quiet."""
        return self._heard_at if self._heard else self._next_on_line()

    def _next_on_line(self) -> float | None:
        times = [sending.characters[0][0] for sending in self._sendings if sending.characters]
        if self._delivery is Delivery.FRAME:
            times = [sending.end for sending in self._sendings if sending.characters]
        if self._frame is not None:
            times.append(self._frame.end + self._timing.gap)
        if self._echoes:
            times.append(self._echoes[0][0])
        if self.script is not None and (planned := self.script.next_time) is not None:
            times.append(planned)
        return min(times, default=None)

    def due(self, now: float) -> list[bytes]:
        """Let time pass until now; return what the master hears, in pieces, in their order."""
        self._advance(now)
        heard, self._heard = self._heard, []
        return heard

    def clear(self) -> None:
        """Forget what is on the line: the adapter was pulled out."""
        self._frame = None
        self._sendings.clear()
        self._echoes.clear()
        self._heard.clear()

    # -- the master's frames --------------------------------------------------------------------------------

    def _begins_too_early(self, begin: float) -> bool:
        """Judge a new frame against what the line carries: an answer under way, or one that just ended."""
        self._prune(begin)
        for sending in self._sendings:
            if sending.begin <= begin < sending.end - ROUNDING:
                self.statistics.collisions += 1
                return True
            if sending.end - ROUNDING <= begin < sending.end + self._timing.gap - ROUNDING:
                self.statistics.gap_violations += 1
                return True
        return False

    def _continue(self, frame: Frame, begin: float) -> None:
        """Judge bytes that come before 3.5 characters of silence: another request too early, or a frame split."""
        if is_whole(bytes(frame.data)):
            self.statistics.gap_violations += 1
            frame.is_lost = True
        elif begin - frame.end > self._split + ROUNDING:
            self.statistics.splits += 1
            frame.is_lost = True

    def _advance(self, now: float) -> None:
        while (event := self._next_on_line()) is not None and event <= now + ROUNDING:
            if self._frame is not None and event >= self._frame.end + self._timing.gap:
                self._end_frame(self._frame)
            self._deliver(event)

    def _end_frame(self, frame: Frame) -> None:
        """Hand a frame to every drive that can hear it, 3.5 characters after its end."""
        self._frame = None
        heard_at = frame.end + self._timing.gap
        if any(s.begin < heard_at and s.end + self._timing.gap > frame.begin + ROUNDING for s in self._sendings):
            frame.is_lost = True
        self._sent.append((frame.begin, frame.end))
        self.statistics.requests += 1
        self.statistics.wrong_baud += frame.is_noise
        data = bytes(frame.data)
        is_lost = frame.is_lost or frame.is_noise
        heard = None if is_lost else self.faults.heard(data, (), heard_at)
        self.journal.add(Entry(Way.REQUEST, frame.begin, frame.end, data, None, _fate(frame, heard)))
        if is_lost:
            self.statistics.lost += 1
            return
        is_broken = heard is not None and not is_whole(heard)
        self.statistics.broken += is_broken
        answers = [self._ask(place, drive, heard, frame, heard_at) for place, drive in enumerate(self.drives)]
        if not is_broken and not any(answers):
            self.statistics.unanswered += 1
            self.statistics.busy += self._timing.request(len(data)) + self._timing.gap

    def _ask(self, place: int, drive: SimulatedDrive, data: bytes | None, frame: Frame, now: float) -> bool:
        """Let one drive have what reaches it of a frame; say whether it answers."""
        is_busy = self._busy.get(place, 0.0) > frame.begin + ROUNDING
        if is_busy or not drive.hears(self._timing.baud, self._parity):
            return False
        number = drive.number
        heard = None if data is None else self.faults.heard(data, (drive, number), now)
        if heard is None:
            return False
        answer, processing = drive.handle(heard, now)
        if answer is None:
            self._busy[place] = now + processing
            return False
        own_end = now + processing + self._timing.answer(len(answer))
        self._busy[place] = own_end
        begin = now + processing
        sendings = self.faults.sendings(answer, (drive, number), now)
        self.journal.add(Entry(Way.ANSWER, begin, own_end, answer, number, "" if sendings else Kind.DROP.value))
        for sending in sendings:
            begin = self._send(sending.data, begin + sending.delay, number, sending.note)
        necessary = self._timing.exchange(len(heard), len(answer), processing)
        self.statistics.answered(number, own_end, necessary)
        return True

    # -- the drives' answers --------------------------------------------------------------------------------

    def _send(self, data: bytes, begin: float, drive: int | None, note: str) -> float:
        """Put bytes on the line; where another sender is on it already, both are lost as far as they overlap."""
        sending = Sending(begin, begin + self._timing.answer(len(data)), drive, note)
        ends = [begin + self._timing.answer(place + 1) for place in range(len(data))]
        sending.characters.extend(zip(ends, data, strict=True))
        for other in self._sendings:
            if other.begin < sending.end and sending.begin < other.end:
                self.statistics.collisions += 1
                self._collide(other, sending)
        self._sendings.append(sending)
        return sending.end

    def _collide(self, first: Sending, second: Sending) -> None:
        """Spoil what two senders put on top of each other: one stream of wrong bytes is heard."""
        one = self._timing.answer(1)
        begin, end = max(first.begin, second.begin), min(first.end, second.end)
        first.characters = deque(
            (at, self._spoilt(byte) if at > begin and at - one < end else byte) for at, byte in first.characters
        )
        second.characters = deque((at, byte) for at, byte in second.characters if at - one >= end)

    def _spoilt(self, byte: int) -> int:
        return self.faults.collided(bytes([byte]))[0]

    def _deliver(self, now: float) -> None:
        """Hand the master what has ended by now."""
        while self._echoes and self._echoes[0][0] <= now + ROUNDING:
            end, echo = self._echoes.popleft()
            self._hear(echo, now)
            self.journal.add(Entry(Way.HEARD, end - self._timing.request(len(echo)), end, echo, None, "echo"))
        for sending in self._sendings:
            if not sending.characters or (self._delivery is Delivery.FRAME and sending.end > now + ROUNDING):
                continue
            talk = self._talk_over(sending)
            arrived = bytearray()
            while sending.characters and sending.characters[0][0] <= now + ROUNDING:
                at, byte = sending.characters.popleft()
                arrived.append(self._spoilt(byte) if talk and self._is_within(at, talk) else byte)
            if arrived:
                self._hear(bytes(arrived), now)
                sending.heard += arrived
                self._note(sending)
        self._prune(now)
        if self.script is not None:
            if not (self._frame or self._echoes or any(sending.characters for sending in self._sendings)):
                self.script.exchange_over(now)
            self.script.play(now)

    def _hear(self, data: bytes, now: float) -> None:
        if not self._heard:
            self._heard_at = now
        self._heard.append(data)

    def _note(self, sending: Sending) -> None:
        """Enter an answer, or noise, that has reached the master to its last character."""
        if not sending.characters:
            self.journal.add(
                Entry(Way.HEARD, sending.begin, sending.end, bytes(sending.heard), sending.drive, sending.note)
            )

    def _talk_over(self, sending: Sending) -> list[tuple[float, float]]:
        """Return when the master sent while an answer was on the line."""
        sent = [*self._sent, (self._frame.begin, self._frame.end)] if self._frame else self._sent
        return [(begin, end) for begin, end in sent if begin < sending.end and sending.begin < end]

    def _is_within(self, at: float, spans: list[tuple[float, float]]) -> bool:
        """Say whether a character that ended then was on the line during one of those spans."""
        first = at - self._timing.answer(1)
        return any(begin < at - ROUNDING and first < end - ROUNDING for begin, end in spans)

    def _prune(self, now: float) -> None:
        """Forget what no longer matters to what comes."""
        gap = self._timing.gap
        self._sendings = [s for s in self._sendings if s.characters or s.end + gap > now]
        oldest = min((s.begin for s in self._sendings), default=now)
        while self._sent and self._sent[0][1] < oldest:
            self._sent.popleft()


def _fate(frame: Frame, heard: bytes | None) -> str:
    """Say what became of a request on its way to the drives, "" for nothing."""
    if frame.is_noise:
        return "wrong baud rate"
    if frame.is_lost:
        return "lost"
    if heard is None:
        return Kind.CUT.value
    return "" if heard == frame.data else Kind.REQUEST_FLIP.value
