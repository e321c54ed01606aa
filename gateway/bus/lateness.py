"""Answers that came when nobody waited for them any more: what that says of a drive that does not answer in time.

A drive whose send waiting time F805 is set, and not configured, answers each time, too late (E6581657 6.5).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from gateway.errors import Refused
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import Request, Target


@dataclass(slots=True)
class LateAnswers:
    """Which drives of a line were late the last time that they were heard. Times are in seconds."""

    _missed: tuple[Codec, Request, float] | None = None
    _late: dict[Target, float] = field(default_factory=dict)  # by number, from the end of the request

    def missed(self, codec: Codec, request: Request, sent: float) -> None:
        """Take that a request which ended at `sent` got no answer in its time."""
        self._missed = codec, request, sent

    def unasked(self, data: bytes, ended: float) -> None:
        """Take what came between two exchanges, and when it ended: it may be what was missed before."""
        if self._missed is not None and data and _is_answer(self._missed[0], self._missed[1], data):
            self._late[self._missed[1].number] = ended - self._missed[2]
        self._missed = None

    def in_time(self, number: Target) -> None:
        """Take that a drive has answered in time."""
        self._late.pop(number, None)

    def said(self, number: Target) -> str:
        """Say of a drive that does not answer in time that it did answer later; "" where it did not."""
        late = self._late.get(number)
        if late is None:
            return ""
        remedy = "is a send waiting time set (F805)? Give it as wait_time"
        return f" in time; one came after {late * 1000:.0f} ms: {remedy}"


def _is_answer(codec: Codec, request: Request, data: bytes) -> bool:
    """Say whether bytes hold an answer to a request, or its refusal."""
    decoder = codec.decoder(request)
    decoder.feed(data)
    decoder.feed(b"")
    try:
        return decoder.next_reply() is not None
    except Refused:
        return True
