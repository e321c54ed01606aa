"""What an edge node remembers over restarts: the number of its last connection (Sparkplug 3.0, 6.4.5)."""

from __future__ import annotations

from typing import Protocol

from gateway.sparkplug.session import NUMBERS
from gateway.sparkplug.topics import Topics

PATIENCE = 2.0  # seconds that the first connection waits for what was kept; without it counting begins at 0


class Keeper(Protocol):
    """Where short texts outlive the process. Nothing is lost but the memory where it fails."""

    async def recalled(self, key: str, within: float) -> str:
        """Return what was kept, "" where nothing was, or nothing could be read in so many seconds."""
        ...

    def keep(self, key: str, text: str) -> None:
        """Keep a text; it never waits."""
        ...


class Memory:
    """The number of the last connection of one edge node."""

    def __init__(self, keeper: Keeper, topics: Topics) -> None:
        self._keeper = keeper
        self._key = f"bdSeq {topics.group}/{topics.node}"

    async def last(self) -> int | None:
        """Return it; None where it is not known."""
        text = await self._keeper.recalled(self._key, PATIENCE)
        is_number = text.isascii() and text.isdecimal() and int(text) < NUMBERS
        return int(text) if is_number else None

    def keep(self, bd_seq: int) -> None:
        """Keep it."""
        self._keeper.keep(self._key, str(bd_seq))
