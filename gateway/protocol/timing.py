"""The arithmetic of a line: how long characters, gaps, exchanges and answers take."""

from __future__ import annotations

from dataclasses import dataclass

REQUEST_BITS = 11  # bits a character as the drive receives it: start, 8, parity, 1 stop (E6581657 2)
ANSWER_BITS = 12  # bits a character as the drive sends it: 2 stop bits (E6581657 2)
GAP_CHARACTERS = 3.5  # silence that ends a frame (E6581657 3.1)
SPLIT_CHARACTERS = 1.5  # silence inside a frame that breaks it (E6581657 3.1)


@dataclass(frozen=True, slots=True)
class LineTiming:
    """Times of one line in seconds, from its baud rate.

    Without parity a character has one bit less; the drive's manual speaks of 11-bit characters and counts
    its waiting times with them, so the longer reading is kept for both.
    """

    baud: int

    @property
    def gap(self) -> float:
        """Return the silence that separates two frames: 2.005 ms at 19200 baud."""
        return GAP_CHARACTERS * REQUEST_BITS / self.baud

    def request(self, characters: int) -> float:
        """Return how long that many characters take towards the drive."""
        return characters * REQUEST_BITS / self.baud

    def answer(self, characters: int) -> float:
        """Return how long that many characters take from the drive."""
        return characters * ANSWER_BITS / self.baud

    def exchange(self, request: int, answer: int, processing: float) -> float:
        """Return the time from the first bit of a request to the end of the gap behind its answer."""
        return self.request(request) + self.gap + processing + self.answer(answer) + self.gap

    def answer_within(self, answer: int, processing: float, margin: float) -> float:
        """Return when an answer must be complete, counted from the end of the request."""
        return self.gap + processing + self.answer(answer) + margin
