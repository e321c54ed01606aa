"""What the codecs have in common: a request is one frame, and what may answer it is known before it is sent."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache

from gateway.protocol.answers import AnswerDecoder, Dialogue
from gateway.protocol.codec import Answering
from gateway.protocol.pdu import Request


class FrameCodec(ABC):
    """A codec by what it says of one request; equal codecs are hashable, and say the same."""

    __slots__ = ()

    @abstractmethod
    def dialogue(self, request: Request) -> Dialogue:
        """Return the frame of a request and its answers; NoSuchForm where the protocol has none."""

    def encode(self, request: Request) -> bytes:
        """Return the frame of a request, checksum included."""
        return _dialogue(self, request).frame

    def answering(self, request: Request) -> Answering:
        """Say whether a request is answered."""
        return _dialogue(self, request).answering

    def answer_size(self, request: Request) -> int:
        """Return the characters of the normal answer, the most where they vary, 0 where there is none."""
        return _dialogue(self, request).size

    def least_answer(self, request: Request) -> int:
        """Return the characters of the shortest answer, a refusal included, 0 where there is none."""
        return _dialogue(self, request).least

    def decoder(self, request: Request) -> AnswerDecoder:
        """Return a decoder that waits for the reply to this request, for ever where nobody answers."""
        return AnswerDecoder(_dialogue(self, request))


@lru_cache(maxsize=1024)
def _dialogue(codec: FrameCodec, request: Request) -> Dialogue:
    """Remember what is known of a request: polls repeat the same ones, with 3.5 characters between them."""
    return codec.dialogue(request)
