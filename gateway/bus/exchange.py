"""One exchange: a request goes out, its answer comes back or an error says what came instead."""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

from gateway.bus.echo import Listening, LocalEcho
from gateway.bus.line import Line
from gateway.clock import Clock
from gateway.errors import BadReply, NoReply, Refused
from gateway.metrics import LineStats
from gateway.protocol.codec import Answering, Codec
from gateway.protocol.pdu import Identity, Reply, Request
from gateway.protocol.timing import LineTiming

log = logging.getLogger("gateway.bus")
frames = logging.getLogger("gateway.bus.frames")

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
    by its bytes once it is known.
    """

    def __init__(
        self,
        line: Line,
        timing: LineTiming,
        margin: float,
        clock: Clock,
        stats: LineStats,
        echo: LocalEcho | None = None,
    ) -> None:
        self._line = line
        self._timing = timing
        self._margin = margin
        self._clock = clock
        self._stats = stats
        self._echo = echo or LocalEcho()
        self._stats.has_echo = self._echo.is_present
        self._early = 0
        self._is_untimed = False
        self._was_on_time = False
        self._last_end = clock.now()

    async def ready(self) -> None:
        """Wait until the line may carry a request; one that babbles is told by the exchange itself."""
        with contextlib.suppress(BadReply):
            await self._line.quiet()

    async def exchange(
        self, codec: Codec, request: Request, processing: float, not_after: float = math.inf
    ) -> Answered:
        """Send a request, not after a time (monotonic seconds), and return its answer.

        NoReply: silence. BadReply: other bytes came. Refused: the drive said no. After the first two the line
        has been drained. LineDown, NoSuchForm and TooLate pass through; after the latter two nothing was sent.
        """
        frame = codec.encode(request)
        answering = codec.answering(request)
        begun = await self._line.write(frame, not_after)
        if is_traced := frames.isEnabledFor(logging.DEBUG):
            frames.debug("tx %s", frame.hex(" "))
        self._stats.exchanges += 1
        self._stats.gaps.observe(begun - self._last_end)
        sent = begun + self._timing.request(len(frame))
        reply: Reply | None = None
        try:
            if answering is Answering.NEVER:
                await self._let_pass(frame, sent + self._timing.gap + processing)
            else:
                reply = await self._answer(codec, request, frame, begun, sent, processing)
        except NoReply:
            await self._line.drain(self._timing.gap, self._margin)
            if answering is not Answering.MAYBE:
                raise
        except BadReply:
            await self._line.drain(self._timing.gap, self._margin)
            raise
        finally:
            done = self._clock.now()
            self._last_end = done
            self._stats.busy += done - begun + self._timing.gap
        if is_traced:
            frames.debug("rx %s after %.1f ms", reply, (done - sent) * 1000)
        return Answered(reply, begun, sent, done)

    async def _let_pass(self, frame: bytes, until: float) -> None:
        """Wait until the drives have worked on a request that nobody answers: they hear nothing before."""
        listening = self._echo.listen(frame)
        while data := await self._line.read(until):
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
            self._learn(listening, lambda: _is_copied(codec, request, frame))

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
            if data and self._clock.now() > deadline + STALE:
                raise BadReply(f"number {request.number}: an answer that may have lain here for long: read too late")
            heard = listening.take(data)
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
                decoder = codec.decoder(request)
            if reply is not None:
                shortest = least if isinstance(reply, Identity) else size
                if self._is_believed(listening, decoder.received, begun, sent, shortest):
                    return reply
                decoder = codec.decoder(request)
            if not data:
                break
        raise self._unanswered(listening, request, decoder.received)

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
            return NoReply(f"number {number}: no answer{listening.said}")
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


def _is_copied(codec: Codec, request: Request, frame: bytes) -> bool:
    """Say whether a copy of a request is an answer to it, as for MODBUS-RTU 06H: it cannot be told from its echo."""
    decoder = codec.decoder(request)
    decoder.feed(frame)
    decoder.feed(b"")
    try:
        return decoder.next_reply() is not None
    except Refused:
        return True
