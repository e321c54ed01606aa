"""Requests to a drive and its replies, the same for every protocol."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ReadWords:
    """Read `count` words from consecutive communication numbers; the drive answers with Words.

    One word is a single read, more are a direct block: 8000H stands where no number exists
    (E6581657 5.1.1, 5.1.3).
    """

    number: int
    address: int
    count: int = 1


@dataclass(frozen=True, slots=True)
class ReadBlock:
    """Read `count` words of the indirect block, mapped by F875-F879 in force (E6581657 5.1.2).

    `address` is where the protocol has the block: 1875H in MODBUS-RTU.
    """

    number: int
    address: int
    count: int


@dataclass(frozen=True, slots=True)
class Identify:
    """Ask a drive who it is; it answers with Identity (E6581657 5.1.7)."""

    number: int
    code: int = 1


Request = ReadWords | ReadBlock | Identify


@dataclass(frozen=True, slots=True)
class Words:
    """The words of an answer, as the drive sent them."""

    words: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Identity:
    """Who a drive says it is: "TOSHIBA", "VFnC3-2007P", "0100"."""

    vendor: str
    device: str
    version: str


Reply = Words | Identity
