"""What every codec does: a request becomes bytes, bytes become its reply or nothing."""

from __future__ import annotations

from typing import Protocol

from gateway.protocol.pdu import Reply, Request


class Decoder(Protocol):
    """Waits for the reply to one request; bounded, strict, and not put off by bytes in front."""

    def feed(self, data: bytes) -> None:
        """Take bytes as they come, in pieces of any size."""
        ...

    def next_reply(self) -> Reply | None:
        """Return the reply once it is whole, None before; raise Refused when the drive says no."""
        ...

    @property
    def received(self) -> bytes:
        """Return what was fed and is not part of a reply, for messages."""
        ...


class Codec(Protocol):
    """One protocol of the drives; holds no state."""

    def encode(self, request: Request) -> bytes:
        """Return the frame of a request."""
        ...

    def answer_size(self, request: Request) -> int:
        """Return how many characters the normal answer has; the longest where it varies."""
        ...

    def decoder(self, request: Request) -> Decoder:
        """Return a decoder that waits for the reply to this request."""
        ...
