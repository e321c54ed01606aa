"""A line used by hand for a while: exchanges one after another, reads that are retried, writes that are read back."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from gateway import site
from gateway.bus.echo import LocalEcho
from gateway.bus.exchange import Exchanger
from gateway.bus.line import LATE_AT_MOST, SETTLE, Line, Opener
from gateway.bus.serial_line import open_line
from gateway.clock import Clock
from gateway.control.writes import PlannedWrite, Verdict, judge
from gateway.drives.notation import label
from gateway.drives.register import Register
from gateway.errors import BadReply, LineDown, NoReply, Refusal, Refused
from gateway.metrics import LineStats
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Identify, Identity, ReadWords, Reply, Request, Words
from gateway.site import Drive

UNTRIPPED = "not tripped: a reset would stop it and clear its RAM"
GARBAGE = "number {} answers garbage (do two drives have this number?)"
NOT_SAID = "the drive does not say whether it is tripped"

READ_TRIES = 3  # a read may be repeated; a write without an answer may have been done, and never is


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a write: the words of its register before and after, None where the drive did not say."""

    drive: Drive
    write: PlannedWrite
    verdict: Verdict
    old: int | None
    new: int | None
    note: str = ""


@asynccontextmanager
async def opened(line: site.Line, clock: Clock, opener: Opener = open_line) -> AsyncIterator[Session]:
    """Open a line for a session, and close it whatever happens; LineDown says why it cannot be opened."""
    port = await opener(line, clock)
    try:
        await port.drain(SETTLE, 2 * SETTLE)
        yield Session(line, port, clock)
    finally:
        port.close()


class Session:
    """Talks to the drives of one open line."""

    def __init__(self, line: site.Line, port: Line, clock: Clock) -> None:
        self.line = line
        self._port = port
        self._clock = clock
        echo = LocalEcho(line.local_echo, line.name)
        self._exchanger = Exchanger(port, line.timing, line.margin, clock, LineStats(), echo)

    # ---- exchanges

    async def ask(self, drive: Drive, request: Request) -> Reply:
        """Ask a drive, again where it is silent or not understood; NoReply, BadReply and Refused pass through."""
        for _ in range(READ_TRIES - 1):
            try:
                return await self._answer(drive, request)
            except (NoReply, BadReply):
                await self._let_late_answers_pass()
        try:
            return await self._answer(drive, request)
        except BadReply as error:
            raise BadReply(f"{GARBAGE.format(drive.number)}: {error}") from error

    async def _answer(self, drive: Drive, request: Request) -> Reply:
        answered = await self._exchanger.exchange(drive.codec, request, processing_time(drive))
        if answered.reply is None:
            raise NoReply(f"{drive.name}: no answer")
        return answered.reply

    async def send(self, codec: Codec, request: Request, processing: float) -> Reply | None:
        """Send a request once. None: nobody needs to answer it. NoReply, BadReply: it may have been done."""
        try:
            return (await self._exchanger.exchange(codec, request, processing)).reply
        except (NoReply, BadReply):
            await self._let_late_answers_pass()
            raise

    async def _let_late_answers_pass(self) -> None:
        """Wait until an answer that comes too late cannot be taken for the next one's (SAFETY.md H16)."""
        late = max(LATE_AT_MOST, 2 * self.line.margin)
        await self._port.drain(late, 2 * late)

    async def pause(self, seconds: float) -> None:
        """Let the line rest."""
        alarm = self._clock.alarm()
        try:
            await alarm.wait_until(self._clock.now() + seconds)
        finally:
            alarm.close()

    # ---- reading

    async def read(self, drive: Drive, register: Register) -> int:
        """Read the raw word of a register."""
        reply = await self.ask(drive, ReadWords(drive.number, register.address))
        if not isinstance(reply, Words):
            raise BadReply(f"{drive.name}: {label(register)}: {reply} is no value")
        return reply.words[0]

    async def read_if_possible(self, drive: Drive, register: Register) -> int | None:
        """Read a register; None where the drive is silent or does not let it be read."""
        try:
            return await self.read(drive, register)
        except (NoReply, BadReply, Refused):
            return None

    async def identify(self, drive: Drive) -> Identity | None:
        """Ask a drive who it is; None where its protocol, or the drive itself, has no identification."""
        if not drive.codec.forms.has_identification:
            return None
        try:
            reply = await self.ask(drive, Identify(drive.number))
        except Refused:
            return None
        return reply if isinstance(reply, Identity) else None

    # ---- writing

    async def write(self, drive: Drive, write: PlannedWrite, *, again: bool = False) -> Outcome:
        """Write one word and read it back.

        A write to the EEPROM of what the register reads already is not made, unless `again`.
        NoReply: the drive was silent, LineDown: the port was gone, both before anything was written.
        """
        if not write.is_answered:
            return await self._reset(drive, write)
        old = await self._before(drive, write)
        if old is not None and write.wears_eeprom and write.reads_back(old) and not again:
            return Outcome(drive, write, Verdict.EQUAL, old, old)
        try:
            note, is_refused = await self._write_once(drive, write)
            new = await self.read_if_possible(drive, write.register)
        except LineDown as error:
            return Outcome(drive, write, Verdict.UNKNOWN, old, None, may_be_done(error))
        return Outcome(drive, write, judge(write, new, is_refused=is_refused), old, new, note)

    async def _before(self, drive: Drive, write: PlannedWrite) -> int | None:
        """Read what a register holds; None where it can be written but not read."""
        try:
            return await self.read(drive, write.register)
        except Refused as refused:
            if refused.reason is Refusal.ADDRESS:
                return None
            raise

    async def _write_once(self, drive: Drive, write: PlannedWrite) -> tuple[str, bool]:
        """Send a write; return what is to be said of it, and whether it was refused."""
        try:
            await self.send(drive.codec, write.request, writing_time(drive, write))
        except Refused as refused:
            return refused.reason.value, True
        except (NoReply, BadReply) as error:
            return f"not acknowledged ({error})", False
        return "", False

    async def _reset(self, drive: Drive, write: PlannedWrite) -> Outcome:
        """Reset a tripped drive: it obeys without an answer, is deaf for a second, and its status tells (7.1).

        A drive that is not tripped is not reset: its output would be cut, and its RAM lost.
        """
        before = await self._states(drive)
        if before is None or "tripped" not in before:
            return Outcome(drive, write, Verdict.NOT_WRITTEN, None, None, NOT_SAID if before is None else UNTRIPPED)
        try:
            note, is_refused = await self._write_once(drive, write)  # an answer says that the drive did not obey
            if is_refused:
                return Outcome(drive, write, Verdict.REFUSED, None, None, note)
            await self.pause(drive.model.times.start_up)
            return await self._after_reset(drive, write)
        except LineDown as error:
            return Outcome(drive, write, Verdict.UNKNOWN, None, None, may_be_done(error))

    async def _states(self, drive: Drive) -> list[str] | None:
        """Read the states of a drive by name; None where it does not tell."""
        register = drive.model.registers.get("status")
        if register is None:
            return None
        try:
            return (register.text(await self.read(drive, register)) or "").split(", ")
        except Refused:
            return None

    async def _after_reset(self, drive: Drive, write: PlannedWrite) -> Outcome:
        """Judge a fault reset by the status of the drive, which was tripped before: it is not any more."""
        try:
            states = await self._states(drive)
        except (NoReply, BadReply):
            states = None
        if states is None:
            return Outcome(drive, write, Verdict.UNKNOWN, None, None, NOT_SAID)
        if "tripped" not in states:
            said = ", ".join(filter(None, states)) or "none"
            note = f"not tripped any more; {label(drive.model.registers['status'])}: {said}"
            return Outcome(drive, write, Verdict.DONE, None, None, note)
        return Outcome(drive, write, Verdict.NOT_DONE, None, None, f"still tripped{await self._trip(drive)}")

    async def _trip(self, drive: Drive) -> str:
        register = drive.model.registers.get("trip_code")
        code = None if register is None else await self.read_if_possible(drive, register)
        return f", {register.text(code)}" if register is not None and code is not None else ""


def may_be_done(error: LineDown) -> str:
    """Say of a write that went out on a port that is gone what is known of it."""
    return f"it may have been done ({error})"


def processing_time(drive: Drive) -> float:
    """Return how long a drive may take to answer, in seconds."""
    return drive.model.times.processing + drive.wait_time


def writing_time(drive: Drive, write: PlannedWrite) -> float:
    """Return how long a drive may take to acknowledge a write, in seconds: longer where it writes its EEPROM."""
    times = drive.model.times
    return (times.eeprom if write.wears_eeprom else times.processing) + drive.wait_time
