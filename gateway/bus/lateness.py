"""Answers that came when nobody waited for them any more: what that says of a drive that does not answer in time.

A drive whose send waiting time F805 is set, and not configured, answers each time, too late (E6581657 6.5).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from gateway.errors import Refused
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Request, Target

LONGEST = 2.5  # seconds: F805 goes up to 2.00 s (E6581657 6.5)


@dataclass(slots=True)
class LateAnswers:
    """Which drives of a line were late the last time that they were heard. Times are in seconds."""

    _missed: dict[Target, tuple[Codec, Request, float]] = field(default_factory=dict)  # by number, when it was sent
    _late: dict[Target, float] = field(default_factory=dict)  # by number, from the end of the request

    def missed(self, codec: Codec, request: Request, sent: float) -> None:
        """Take that a request which ended at `sent` got no answer in its time."""
        self._missed[request.number] = codec, request, sent

    def unasked(self, data: bytes, ended: float) -> None:
        """Take bytes that are no answer to what was asked last, and when they ended: they may be what was missed."""
        for number, (codec, request, sent) in list(self._missed.items() if data else ()):
            if ended - sent > LONGEST:
                del self._missed[number]
            elif holds_answer(codec, request, data):
                self._late[number] = ended - sent
                del self._missed[number]

    def in_time(self, number: Target) -> None:
        """Take that a drive has answered in time."""
        self._late.pop(number, None)
        self._missed.pop(number, None)

    def said(self, number: Target) -> str:
        """Say of a drive that does not answer in time that it did answer later; "" where it did not."""
        late = self._late.get(number)
        if late is None:
            return ""
        remedy = "is a send waiting time set (F805)? Give it as wait_time"
        return f" in time; one came after {late * 1000:.0f} ms: {remedy}"


def holds_answer(codec: Codec, request: Request, data: bytes) -> bool:
    """Say whether bytes hold an answer to a request, or its refusal."""
    decoder = codec.decoder(request)
    decoder.feed(data)
    decoder.feed(b"")
    try:
        return decoder.next_reply() is not None
    except Refused:
        return True
