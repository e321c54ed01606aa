"""Who may do what over MODBUS-TCP: rights by role, address, unit, function and register range. Pure.

Rights only take away: what they let through is still judged by a drive's `control`, `sources` and own rights.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache

from gateway.config import ModbusTcpSection, TcpRightSection
from gateway.modbus_tcp.hosts import Network, is_from, networks
from gateway.modbus_tcp.requests import EXCHANGE, WRITE, WRITE_WORDS

READ_HOLDING = 0x03
READ_INPUT = 0x04
IDENTIFY = 0x2B

Span = tuple[int, int]
"""First and last."""

Deed = tuple[int, bool]
"""A function code, and whether it is about what it writes: 17H does both."""

READS: frozenset[Deed] = frozenset((code, False) for code in (READ_HOLDING, READ_INPUT, IDENTIFY, EXCHANGE))
WRITES: frozenset[Deed] = frozenset((code, True) for code in (WRITE, WRITE_WORDS, EXCHANGE))
EVERY_UNIT = (0, 0xFF)
EVERY_REGISTER = (0, 0x1FFFF)  # more than there are: a range that passes FFFFH is wrong (02), not forbidden
READING = "read"
WRITING = "write"


@dataclass(frozen=True, slots=True)
class Right:
    """Some deeds at some registers of some units."""

    units: tuple[Span, ...] = (EVERY_UNIT,)
    deeds: frozenset[Deed] = READS
    registers: tuple[Span, ...] = (EVERY_REGISTER,)


@dataclass(frozen=True, slots=True)
class Rights:
    """All that one kind of client may do; what no right covers is refused."""

    rights: tuple[Right, ...] = ()

    def permits(self, unit: int, deed: Deed, first: int, count: int) -> bool:
        """Say whether every one of these registers is covered, by whichever rights."""
        return any(low <= first and first + count - 1 <= high for low, high in _covered(self.rights, unit, deed))

    def touches(self, unit: int, deed: Deed) -> bool:
        """Say whether that may be done to any register of a unit at all."""
        return bool(_covered(self.rights, unit, deed))

    def knows(self, unit: int) -> bool:
        """Say whether anything may be done to a unit."""
        return any(self.touches(unit, deed) for deed in READS | WRITES)

    def writes_within(self, unit: int, first: int, last: int) -> bool:
        """Say whether anything may be written between two registers of a unit."""
        spans = (span for deed in WRITES for span in _covered(self.rights, unit, deed))
        return any(low <= last and first <= high for low, high in spans)

    def reading(self) -> Rights:
        """Return what is left of them without every write."""
        return Rights(tuple(Right(right.units, right.deeds & READS, right.registers) for right in self.rights))


NOTHING = Rights()
READ_ALL = Rights((Right(),))


@cache
def _covered(rights: tuple[Right, ...], unit: int, deed: Deed) -> tuple[Span, ...]:
    """Return the registers of a unit to which a deed may be done: in order, neighbours merged."""
    spans = sorted(
        span
        for right in rights
        if deed in right.deeds and any(low <= unit <= high for low, high in right.units)
        for span in right.registers
    )
    merged: list[Span] = []
    for low, high in spans:
        if merged and low <= merged[-1][1] + 1:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return tuple(merged)


@dataclass(frozen=True, slots=True)
class _Given:
    """A right of the file, and to whom it is given."""

    role: str | None
    networks: tuple[Network, ...] | None
    right: Right

    def is_for(self, role: str | None, host: str) -> bool:
        if (self.role is None) != (role is None):
            return False
        is_role = self.role is None or role is None or fnmatchcase(role, self.role)
        return is_role and (self.networks is None or is_from(host, self.networks))


class Grants:
    """The rights of a configuration, by who asks."""

    def __init__(self, section: ModbusTcpSection) -> None:
        self._given = tuple(map(_given, section.right))
        self._has_tls = section.tls is not None
        self._has_roles = any(given.role is not None for given in self._given)
        self._has_plain = any(given.role is None for given in self._given)

    @property
    def restricts_plain(self) -> bool:
        """Say whether clients without TLS may do less than `control` permits."""
        return self._has_plain or self._has_tls

    def of_plain(self, host: str) -> Rights | None:
        """Return what a client without TLS may do; None where only `control` limits it.

        Where there is a way in that knows roles, this one is for reading, unless it is said otherwise.
        """
        if self._has_plain:
            return Rights(tuple(given.right for given in self._given if given.is_for(None, host)))
        return READ_ALL if self._has_tls else None

    def of_role(self, role: str | None, host: str) -> Rights:
        """Return what a client with a certificate may do: nothing without a role, with any role read by default."""
        if role is None:
            return NOTHING
        if not self._has_roles:
            return READ_ALL
        return Rights(tuple(given.right for given in self._given if given.is_for(role, host)))


def _given(section: TcpRightSection) -> _Given:
    asked = None if section.addresses is None else networks(section.addresses)
    right = Right(
        units=(EVERY_UNIT,) if section.units is None else tuple(section.units),
        deeds=deeds(section.functions),
        registers=(EVERY_REGISTER,) if section.registers is None else tuple(section.registers),
    )
    return _Given(section.role, asked, right)


def deeds(functions: Iterable[int | str]) -> frozenset[Deed]:
    """Return what functions of a configuration come to: "read" and "write" each contain a half of 17H."""
    done: set[Deed] = set()
    for function in functions:
        if function == READING:
            done |= READS
        elif function == WRITING:
            done |= WRITES
        else:
            done |= {deed for deed in READS | WRITES if deed[0] == function}
    return frozenset(done)
