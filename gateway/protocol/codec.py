"""What every codec does: a request becomes bytes, bytes become its reply or nothing."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from gateway.errors import GatewayError
from gateway.protocol.pdu import Reply, Request


class NoSuchForm(GatewayError):
    """The protocol has no frame for this request: plan another one; nothing was sent."""


class Answering(Enum):
    """Whether a request is answered."""

    ALWAYS = "always"
    MAYBE = "by the representative where there is one, or only to refuse"
    NEVER = "never"


@dataclass(frozen=True, slots=True)
class Forms:
    """What a protocol has, whatever the model.

    `numbers` are those that a drive can be addressed by. `has_direct_block` is a read of consecutive numbers,
    `has_block` the indirect block, `has_exchange` a block written and read in one frame, `writes_all_or_none` that
    of its words a drive takes all or none (17H), not each by itself (X, E6581657 4.1.3), `has_ram_write` a write of a
    stored parameter that spares the EEPROM, `has_digit_groups` a broadcast to a digit, `says_tripped` a flag
    in every answer.
    """

    numbers: range
    has_direct_block: bool = False
    has_block: bool = False
    has_exchange: bool = False
    writes_all_or_none: bool = False
    has_identification: bool = False
    has_ram_write: bool = False
    has_digit_groups: bool = False
    has_proportional: bool = False
    says_tripped: bool = False


class Decoder(Protocol):
    """Waits for the reply to one request; bounded, strict, and not put off by bytes in front.

    It reads from left to right, so that the way in which bytes were cut makes no difference.
    """

    def feed(self, data: bytes) -> None:
        """Take bytes as they come, in pieces of any size; an empty piece says that the line has fallen silent.

        Only silence tells a few answers from an echo with another answer behind it, and a broken beginning from
        one that goes on: feed it before giving up, and ask for the reply once more.
        """
        ...

    def next_reply(self) -> Reply | None:
        """Return the reply once it is whole, None before; raise Refused when the drive says no."""
        ...

    @property
    def received(self) -> bytes:
        """Return what was fed and is not part of a reply, for messages."""
        ...


class Codec(Protocol):
    """One protocol of the drives; holds no state.

    NoSuchForm from any method: the protocol has no such request, or not for that target or count.
    """

    name: str
    forms: Forms

    def encode(self, request: Request) -> bytes:
        """Return the frame of a request."""
        ...

    def answering(self, request: Request) -> Answering:
        """Say whether a request is answered."""
        ...

    def answer_size(self, request: Request) -> int:
        """Return how many characters the normal answer has; the longest where it varies, 0 where there is none."""
        ...

    def least_answer(self, request: Request) -> int:
        """Return how many characters the shortest possible answer has, a refusal included; 0 where there is none."""
        ...

    def decoder(self, request: Request) -> Decoder:
        """Return a decoder that waits for the reply to this request."""
        ...
