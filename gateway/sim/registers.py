"""What a protocol may ask of a drive, whatever the protocol."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from gateway.drives.model import BlockForms


class Registers(Protocol):
    """The registers behind a frame; every method may raise Denied."""

    @property
    def blocks(self) -> BlockForms:
        """Return which block forms the model has."""
        ...

    @property
    def is_tripped(self) -> bool:
        """Say whether a trip is held."""
        ...

    @property
    def most_groups(self) -> int:
        """Return how many words X may write: two, or five to the display while FA80 = 1."""
        ...

    @property
    def has_proportional(self) -> bool:
        """Say whether the model has the S command."""
        ...

    def read(self, address: int) -> int:
        """Read one word."""
        ...

    def read_direct(self, first: int, count: int) -> Sequence[int]:
        """Read consecutive numbers."""
        ...

    def read_block(self, count: int) -> Sequence[int]:
        """Read what F875-F879 select."""
        ...

    def write_stored(self, address: int, word: int) -> None:
        """Write one word, to the EEPROM too where the register has a place there."""
        ...

    def write_ram(self, address: int, word: int) -> None:
        """Write one word, to the RAM only."""
        ...

    def write_block(self, words: Sequence[int]) -> None:
        """Write to RAM what F870 and F871 select, all of it or nothing."""
        ...

    def write_groups(self, words: Sequence[int]) -> Sequence[int]:
        """Write to RAM what F870 and F871 select, each word that can be; return the places of the others."""
        ...

    def write_proportional(self, address: int, word: int, *, is_master_tripped: bool) -> None:
        """Take a frequency command in 0.01 %."""
        ...

    def identity(self) -> tuple[str, str]:
        """Return the device reference and the version."""
        ...
