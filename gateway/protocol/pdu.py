"""Requests to a drive and its replies, the same for every protocol."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Group:
    """Several drives addressed at once: all of them, or those with one decimal digit in common (E6581657 4.4).

    A digit that is None stands for any. The TOSHIBA ASCII mode has `**`, `*n` and `n*`; its binary mode (FFH)
    and MODBUS-RTU (0) know all drives only.
    """

    tens: int | None = None
    ones: int | None = None

    def has(self, number: int) -> bool:
        """Say whether the drive with that number obeys."""
        return self.tens in (None, number // 10) and self.ones in (None, number % 10)

    @property
    def representative(self) -> int:
        """Return the number of the one drive that answers in the TOSHIBA protocols, where it is on the line."""
        return 10 * (self.tens or 0) + (self.ones or 0)

    def __str__(self) -> str:
        return "".join("*" if digit is None else str(digit) for digit in (self.tens, self.ones))


EVERY_DRIVE = Group()

Target = int | Group | None
"""Whom a request is for: a drive's number, a group, or None for the only drive on the line (TOSHIBA only)."""


@dataclass(frozen=True, slots=True)
class ReadWords:
    """Read `count` words from consecutive communication numbers; the drive answers with Words.

    One word is a single read, more are a direct block: 8000H stands where no number exists
    (E6581657 5.1.1, 5.1.3). TOSHIBA: R, one word only (4.2).
    """

    number: Target
    address: int
    count: int = 1


@dataclass(frozen=True, slots=True)
class ReadBlock:
    """Read `count` words of the indirect block, mapped by F875-F879 in force; the drive answers with Words.

    `address` is where MODBUS-RTU has the block: 1875H (E6581657 5.1.2). TOSHIBA binary: X without write data (4.1.3).
    """

    number: Target
    address: int
    count: int


@dataclass(frozen=True, slots=True)
class WriteRam:
    """Write one word that is to last until the drive is reset; the drive answers with Written.

    TOSHIBA: P (E6581657 4.2). MODBUS-RTU: 06H, which is RAM-only for registers without a place in the EEPROM
    and for no others (5.1.4): whoever makes this request has seen to that. A fault reset is not answered
    (`is_answered`, 7.1).
    """

    number: Target
    address: int
    word: int
    is_answered: bool = True


@dataclass(frozen=True, slots=True)
class WriteStored:
    """Write one word to RAM and, where the register has a place there, to the EEPROM; answered with Written.

    TOSHIBA: W (E6581657 4.2). MODBUS-RTU: 06H (5.1.4).
    """

    number: Target
    address: int
    word: int


@dataclass(frozen=True, slots=True)
class WriteBlock:
    """Write to RAM what F870 and F871 in force select; the drive answers with Written.

    `address` is where MODBUS-RTU has the block: 1870H, always two words (E6581657 5.1.5).
    TOSHIBA binary: X without read data, one or two words (4.1.3), or the five of the panel's text (7.3.1).
    """

    number: Target
    address: int
    words: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Exchange:
    """Write as WriteBlock and read as ReadBlock in one frame; the drive answers with Exchanged.

    MODBUS-RTU: 17H (E6581657 5.1.6). TOSHIBA binary: X (4.1.3).
    """

    number: Target
    read_address: int
    count: int
    write_address: int
    words: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Identify:
    """Ask a drive who it is; it answers with Identity. MODBUS-RTU only, read codes 0 to 3 (E6581657 5.1.7)."""

    number: Target
    code: int = 1


@dataclass(frozen=True, slots=True)
class Proportional:
    """Give a frequency in 0.01 % for the drives' F810-F814 to convert; never answered. TOSHIBA binary only: S.

    `is_master_tripped` makes it s: the drives do what F806 says of a tripped master (VF-MB1 manual 4.2, 6).
    """

    number: Target
    address: int
    word: int
    is_master_tripped: bool = False


Write = WriteRam | WriteStored | WriteBlock | Exchange | Proportional
Request = ReadWords | ReadBlock | Identify | Write


@dataclass(frozen=True, slots=True)
class Words:
    """The words of an answer, as the drive sent them. `is_tripped` is None where the protocol does not say."""

    words: tuple[int, ...]
    is_tripped: bool | None = None


@dataclass(frozen=True, slots=True)
class Written:
    """A write was acknowledged. `failed` has the places of a block's words that were not written (Y, 4.1.3)."""

    failed: tuple[int, ...] = ()
    is_tripped: bool | None = None


@dataclass(frozen=True, slots=True)
class Exchanged:
    """The words read by an exchange, and the places of the words that were not written (Y, E6581657 4.1.3)."""

    words: tuple[int, ...]
    failed: tuple[int, ...] = ()
    is_tripped: bool | None = None


@dataclass(frozen=True, slots=True)
class Identity:
    """Who a drive says it is: "TOSHIBA", "VFnC3-2007P", "0100"."""

    vendor: str
    device: str
    version: str
    is_tripped: bool | None = None


Reply = Words | Written | Exchanged | Identity
