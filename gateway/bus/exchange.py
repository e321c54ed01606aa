"""One exchange: a request goes out, its answer comes back or an error says what came instead."""

from __future__ import annotations

import contextlib
import logging
import math
from dataclasses import dataclass

from gateway.bus.line import Line
from gateway.clock import Clock
from gateway.errors import BadReply, NoReply, Refused
from gateway.metrics import LineStats
from gateway.protocol.codec import Answering, Codec
from gateway.protocol.pdu import Identity, Reply, Request
from gateway.protocol.timing import LineTiming

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

    An answer sooner than the wire allows is no answer to this request and is dropped. A pseudo-terminal may
    be a simulator without wire timing; there, and only there, early answers are believed after the first ones.
    """

    def __init__(self, line: Line, timing: LineTiming, margin: float, clock: Clock, stats: LineStats) -> None:
        self._line = line
        self._timing = timing
        self._margin = margin
        self._clock = clock
        self._stats = stats
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
                await self._let_pass(sent + self._timing.gap + processing)
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

    async def _let_pass(self, until: float) -> None:
        """Wait until the drives have worked on a request that nobody answers: they hear nothing before."""
        while await self._line.read(until):
            pass  # an adapter's echo

    async def _answer(
        self, codec: Codec, request: Request, frame: bytes, begun: float, sent: float, processing: float
    ) -> Reply:
        """Wait for the first character, then for the rest."""
        size, least = codec.answer_size(request), codec.least_answer(request)
        deadline = sent + self._timing.gap + processing + self._margin
        decoder = codec.decoder(request)
        is_started = False
        while True:
            data = await self._line.read(deadline)
            if data and self._clock.now() > deadline + STALE:
                raise BadReply(f"number {request.number}: an answer that may have lain here for long: read too late")
            if data and not is_started:
                is_started = True
                deadline += self._timing.answer(max(size, least))
            decoder.feed(data)  # nothing says that the line is silent
            try:
                reply = decoder.next_reply()
            except Refused:
                if self._is_credible(begun, sent, least):
                    raise
                reply = None
                decoder = codec.decoder(request)
            if reply is not None:
                if self._is_credible(begun, sent, least if isinstance(reply, Identity) else size):
                    return reply
                decoder = codec.decoder(request)
            if not data:
                break
        received = decoder.received
        if not received:
            raise NoReply(f"number {request.number}: no answer")
        if received == frame:
            self._stats.errors["echo"] += 1
            raise NoReply(f"number {request.number}: only the echo of the request; the drive does not answer")
        raise BadReply(f"number {request.number}: {len(received)} bytes that are no answer: {received[:32].hex(' ')}")

    def _is_credible(self, begun: float, sent: float, answer: int) -> bool:
        """Say whether an answer may be whole by now; count and refuse it where the wire does not allow that."""
        least = sent - begun + self._timing.gap + self._timing.answer(answer)
        if self._clock.now() - begun >= EARLIEST * least:
            self._was_on_time = True
            self._early = 0
            return True
        self._stats.errors["early"] += 1
        self._early += 1
        if self._line.is_pty and not self._was_on_time and self._early >= UNTIMED_AFTER:
            self._is_untimed = True
        return self._is_untimed
