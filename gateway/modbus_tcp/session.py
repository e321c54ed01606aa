"""The requests of one client that are not answered yet: writes under way, and what came behind them. Pure.

Every answer goes out in the order of the requests, since many clients match answers by order alone. Writes begin at
once, in their order, so that a stop does not wait for the command in front of it; a read behind a write is made when
the write has been answered, so that it sees what the write did.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from gateway.control.command import Source
from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.requests import WRITING
from gateway.modbus_tcp.responder import FUNCTION_AT, UNIT_AT, Responder

Reply = Callable[[bytes | ExceptionCode], None]
"""Takes the answer PDU of a write, or the exception; what comes after the first is passed over."""


class Writer(Protocol):
    """Who carries out the writes to one unit id."""

    def write(self, pdu: bytes, source: Source, reply: Reply) -> float:
        """Begin a request that writes, and return for how many seconds its client may wait for `reply`."""
        ...


class Timer(Protocol):
    """A call that was put off."""

    def cancel(self) -> None:
        """Let it never be made."""
        ...


CallLater = Callable[[float, Callable[[], None]], Timer]


@dataclass(slots=True, eq=False)
class Owed:
    """One request that is not answered yet: `frame` from its protocol id on, the whole answer when it is there."""

    transaction: bytes
    frame: bytes
    is_under_way: bool = False
    answer: bytes | None = None
    timer: Timer | None = None


class Session:
    """What one client is owed. `wake` is called when more may be sent, which `release` then gives; not at once."""

    def __init__(
        self,
        responder: Responder,
        writers: Mapping[int, Writer],
        source: Source,
        wake: Callable[[], None],
        call_later: CallLater,
    ) -> None:
        self.owed: deque[Owed] = deque()
        self._responder = responder
        self._writers = writers
        self._source = source
        self._wake = wake
        self._call_later = call_later
        self._is_closed = False

    def __len__(self) -> int:
        return len(self.owed)

    def take(self, transaction: bytes, frame: bytes, now: float) -> bytes:
        """Take a request; return all that may be sent by now."""
        owed = Owed(transaction, frame)
        self.owed.append(owed)
        writer = self._writers.get(frame[UNIT_AT]) if frame[FUNCTION_AT] in WRITING else None
        if writer is not None:
            self._begin(owed, writer)
        return self.release(now)

    def _begin(self, owed: Owed, writer: Writer) -> None:
        owed.is_under_way = True

        def reply(told: bytes | ExceptionCode) -> None:
            if owed.answer is None and not self._is_closed:
                self._answered(owed, told)

        patience = writer.write(owed.frame[FUNCTION_AT:], self._source, reply)
        if owed.answer is None:
            owed.timer = self._call_later(patience, lambda: reply(ExceptionCode.ACKNOWLEDGE))

    def _answered(self, owed: Owed, told: bytes | ExceptionCode) -> None:
        owed.answer = owed.transaction + self._responder.told(owed.frame, told)
        if owed.timer is not None:  # else it is answered while it is taken
            owed.timer.cancel()
            self._wake()

    def release(self, now: float) -> bytes:
        """Return the answers up to the first write that is under way."""
        answers: list[bytes] = []
        while self.owed:
            first = self.owed[0]
            if first.answer is not None:
                answers.append(first.answer)
            elif first.is_under_way:
                break
            else:
                answers.append(first.transaction + self._responder.answer(first.frame, now))
            self.owed.popleft()
        return b"".join(answers)

    def close(self) -> None:
        """Forget the client: what is under way goes on, and its result goes nowhere."""
        self._is_closed = True
        for owed in self.owed:
            if owed.timer is not None:
                owed.timer.cancel()
        self.owed.clear()
