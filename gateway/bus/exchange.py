"""One exchange: a request goes out, its answer comes back or an error says what came instead."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

from gateway.bus.echo import Listening, LocalEcho
from gateway.bus.lateness import LateAnswers, holds_answer
from gateway.bus.line import Line
from gateway.clock import Clock
from gateway.errors import BadReply, LineDown, NoReply, Refused
from gateway.metrics import LineStats
from gateway.protocol.codec import Answering, Codec, Decoder
from gateway.protocol.pdu import Identity, Reply, Request
from gateway.protocol.timing import LineTiming
from gateway.trace.record import Hearing, Record, Tap, Unasked, Verdict

log = logging.getLogger("gateway.bus")

EARLIEST = 0.85  # of the computed wire time; a line without parity has 10 bits where 11 are counted
UNTIMED_AFTER = 2  # early answers in a row, none on time before: a pseudo-terminal without wire timing


@dataclass(frozen=True, slots=True)
class Answered:
    """A reply and its times: request begun, request ended, answer whole (monotonic seconds).

    `reply` is None where no answer is no fault: nobody answers such a request, or nobody need.
    """

    reply: Reply | None
    begun: float
    sent: float
    done: float

STALE = 0.1  # seconds after its time at which an answer was read, not given: the process stood still (SAFETY.md H23)


class Exchanger:
    """Carries out exchanges on one line, one at a time.

    An answer sooner than the wire allows is no answer to this request and is dropped. Where there may be a simulator
    without wire timing, and only there, early answers are believed after the first ones. An adapter's echo is told
    by its bytes once it is known. A tap is told of every exchange, and of what came between two of them.
    """

    def __init__(
        self,
        line: Line,
        timing: LineTiming,
        margin: float,
        clock: Clock,
        stats: LineStats,
        echo: LocalEcho | None = None,
        tap: Tap | None = None,
    ) -> None:
        self._line = line
        self._timing = timing
        self._margin = margin
        self._clock = clock
        self._stats = stats
        self._echo = echo or LocalEcho()
        self._stats.has_echo = self._echo.is_present
        self._tap = tap
        self._heard = Hearing()
        self._late = LateAnswers()
        self._before: tuple[Codec, Request] | None = None
        self._early = 0
        self._is_untimed = False
        self._was_on_time = False
        self._last_end = clock.now()

    async def ready(self) -> BadReply | None:
        """Wait until the line may carry a request; return why it may not where it babbles."""
        try:
            await self._line.quiet()
        except BadReply as error:
            return error
        return None

    async def exchange(
        self, codec: Codec, request: Request, processing: float, not_after: float = math.inf
    ) -> Answered:
        """Send a request, not after a time (monotonic seconds), and return its answer.

        NoReply: silence. BadReply: other bytes came. Refused: the drive said no. After the first two the line
        has been drained. LineDown, NoSuchForm and TooLate pass through; after the latter two nothing was sent.
        """
        frame = codec.encode(request)
        quiet_since = await self._take_unasked()
        begun = await self._line.write(frame, not_after)
        self._before = codec, request
        self._stats.exchanges += 1
        self._stats.gaps.observe(begun - self._last_end)
        sent = begun + self._timing.request(len(frame))
        heard = self._heard = Hearing()
        reply: Reply | None = None
        verdict, note = Verdict.BROKEN_OFF, ""
        try:
            reply = await self._converse(codec, request, frame, begun, sent, processing)
            verdict = Verdict.NOT_AWAITED if reply is None else Verdict.ANSWERED
            self._late.in_time(request.number)
        except (NoReply, BadReply) as error:
            verdict, note = Verdict.of(error), str(error)
            heard.end()
            await self._drain()
            self._late.missed(codec, request, sent)
            if isinstance(error, BadReply) or codec.answering(request) is not Answering.MAYBE:
                raise
            verdict, note = Verdict.NOT_AWAITED, ""
        except (Refused, LineDown) as error:
            verdict, note = Verdict.of(error), str(error)
            if isinstance(error, Refused):
                self._late.in_time(request.number)
            raise
        finally:
            done = self._clock.now()
            self._last_end = done
            self._stats.busy += done - begun + self._timing.gap
            if self._tap is not None:
                gap = begun - quiet_since
                self._tap(Record(codec, request, frame, gap, begun, sent, done, heard, verdict, reply, note))
        return Answered(reply, begun, sent, done)

    async def _converse(
        self, codec: Codec, request: Request, frame: bytes, begun: float, sent: float, processing: float
    ) -> Reply | None:
        """Return the answer to a request that is being sent; None where nobody answers such a request."""
        if codec.answering(request) is Answering.NEVER:
            await self._let_pass(frame, sent + self._timing.gap + processing)
            return None
        return await self._answer(codec, request, frame, begun, sent, processing)

    async def _take_unasked(self) -> float:
        """Take what came since the last exchange, before it is thrown away; return since when the line is quiet."""
        since = self._clock.now()
        try:
            since = await self._line.quiet()
        finally:
            data = await self._line.read(self._clock.now())
            self._late.unasked(data, since)
            if data and self._tap is not None:
                self._tap(Unasked(since, data, self._before))
        return since

    async def _drain(self) -> None:
        """Hear what still comes until the line has been quiet for a gap, or the margin is over; none of it counts."""
        end = self._clock.now() + self._margin
        while (now := self._clock.now()) < end and (data := await self._line.read(min(now + self._timing.gap, end))):
            self._heard.take(self._clock.now(), data)

    async def _let_pass(self, frame: bytes, until: float) -> None:
        """Wait until the drives have worked on a request that nobody answers: they hear nothing before."""
        listening = self._echo.listen(frame)
        while data := await self._line.read(until):
            self._heard.take(self._clock.now(), data)
            listening.take(data)
        if listening.is_damaged:
            self._stats.errors["collision"] += 1
        self._learn(listening, lambda: False)

    async def _answer(
        self, codec: Codec, request: Request, frame: bytes, begun: float, sent: float, processing: float
    ) -> Reply:
        """Wait for the answer, and learn from what comes whether there is an echo."""
        listening = self._echo.listen(frame)
        try:
            return await self._behind_echo(listening, codec, request, begun, sent, processing)
        finally:
            # as for MODBUS-RTU 06H, whose answer cannot be told from the echo of its request
            self._learn(listening, lambda: holds_answer(codec, request, frame))

    async def _behind_echo(
        self, listening: Listening, codec: Codec, request: Request, begun: float, sent: float, processing: float
    ) -> Reply:
        """Wait for the first character that is no echo, then for the rest."""
        size, least = codec.answer_size(request), codec.least_answer(request)
        deadline = sent + self._timing.gap + processing + self._margin
        decoder = codec.decoder(request)
        is_started = False
        while True:
            data = await self._line.read(deadline)
            now = self._clock.now()
            heard = listening.take(data)
            self._note(now, data, len(data) - len(heard), is_echo=listening.is_heard)
            if data and now > deadline + STALE:
                raise BadReply(f"number {request.number}: an answer that may have lain here for long: read too late")
            if data and not heard:
                continue  # the echo
            if data and not is_started:
                is_started = True
                deadline += self._timing.answer(max(size, least))
            decoder.feed(heard)  # nothing says that the line is silent
            try:
                reply = decoder.next_reply()
            except Refused:
                if self._is_believed(listening, decoder.received, begun, sent, least):
                    raise
                reply = None
                decoder = self._anew(codec, request)
            if reply is not None:
                shortest = least if isinstance(reply, Identity) else size
                if self._is_believed(listening, decoder.received, begun, sent, shortest):
                    self._late.unasked(decoder.received, now)
                    return reply
                decoder = self._anew(codec, request)
            if not data:
                break
        self._late.unasked(decoder.received, self._clock.now())
        raise self._unanswered(listening, request, decoder.received)

    def _note(self, now: float, data: bytes, kept_back: int, *, is_echo: bool) -> None:
        """Keep for a tap what has come: the adapter's echo is marked as early, for it is no answer."""
        if kept_back > 0:
            self._heard.take(now, data[:kept_back])
            if is_echo:
                self._heard.drop()
        if len(data) > max(kept_back, 0):
            self._heard.take(now, data[max(kept_back, 0) :])

    def _unanswered(self, listening: Listening, request: Request, received: bytes) -> NoReply | BadReply:
        """Say what came instead of an answer, and count what became of the echo."""
        number = request.number
        if listening.is_damaged:
            self._stats.errors["collision"] += 1
            return BadReply(f"number {number}: {listening.said}")
        if (listening.is_heard and not received) or received == listening.frame:
            self._stats.errors["echo"] += 1
            return NoReply(f"number {number}: only the echo of the request; the drive does not answer")
        if not received:
            return NoReply(f"number {number}: no answer{self._late.said(number)}{listening.said}")
        return BadReply(f"number {number}: {len(received)} bytes that are no answer: {received[:32].hex(' ')}")

    def _learn(self, listening: Listening, is_copied: Callable[[], bool]) -> None:
        """Take what became of the echo; the first answers tell whether there is one."""
        if self._echo.learn(listening.heard(is_copied)):
            self._stats.has_echo = self._echo.is_present
            if self._echo.is_present:
                log.info("line %s: the adapter echoes what is sent; the echo is discarded", self._echo.line)

    def _is_believed(self, listening: Listening, junk: bytes, begun: float, sent: float, answer: int) -> bool:
        """Say whether an answer may be believed, by what came before it and by its time."""
        if not listening.may_answer(junk) or not self._is_credible(begun, sent, answer):
            return False
        listening.believe(junk)
        return True

    def _anew(self, codec: Codec, request: Request) -> Decoder:
        """Drop what has come as sooner than the wire allows, and wait for the answer from the beginning."""
        self._heard.drop()
        return codec.decoder(request)

    def _is_credible(self, begun: float, sent: float, answer: int) -> bool:
        """Say whether an answer may be whole by now; count and refuse it where the wire does not allow that."""
        least = sent - begun + self._timing.gap + self._timing.answer(answer)
        if self._clock.now() - begun >= EARLIEST * least:
            self._was_on_time = True
            self._early = 0
            return True
        self._stats.errors["early"] += 1
        self._early += 1
        if self._line.may_be_simulated and not self._was_on_time and self._early >= UNTIMED_AFTER:
            self._is_untimed = True
        return self._is_untimed
