"""Who is served when many want to be: all places, those of one address, those that are kept, and who may come at all.

Nobody who is served is put out for another: a client that finds no place is turned away at once.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from dataclasses import dataclass
from typing import Protocol

from gateway.config import ModbusTcpSection
from gateway.metrics import TcpStats
from gateway.modbus_tcp.hosts import Network, is_from, networks

log = logging.getLogger("gateway.modbus_tcp")

ALL = "all"  # about whom it is said that the places are taken
TOLD_AT_MOST = 256  # clients about whom something is said in the log


class Client(Protocol):
    """One who takes a place."""

    def overdue(self, now: float, idle_timeout: float) -> str | None:
        """Say why its time is over; None while it is not."""
        ...

    def cut(self, reason: str) -> None:
        """Close at once."""
        ...


@dataclass(frozen=True, slots=True)
class Reserved:
    """So many places are kept for these."""

    networks: tuple[Network, ...]
    places: int


@dataclass(frozen=True, slots=True)
class Limits:
    """How many are served, and who: None is no limit. An address belongs to the first of `reserved` that has it."""

    places: int
    per_address: int | None = None
    reserved: tuple[Reserved, ...] = ()
    allowed: tuple[Network, ...] | None = None

    def group(self, host: str) -> Reserved | None:
        """Return the places that are kept for a host; None where there are none."""
        return next((reserved for reserved in self.reserved if is_from(host, reserved.networks)), None)


def limits_of(section: ModbusTcpSection) -> Limits:
    """Return the limits of a configuration."""
    return Limits(
        section.connections,
        section.per_address,
        tuple(Reserved(networks(one.addresses), one.places) for one in section.reserved),
        None if section.allow is None else networks(section.allow),
    )


class Places:
    """The connections that are served, of all listeners together."""

    def __init__(self, limits: Limits | int, stats: TcpStats) -> None:
        self.taken: dict[Client, str] = {}  # with the address of each
        self.all_free = asyncio.Event()
        self.all_free.set()
        self._limits = Limits(limits) if isinstance(limits, int) else limits
        self._of_address: Counter[str] = Counter()
        self._of_group: Counter[Reserved] = Counter()
        self._stats = stats
        self._told: set[str] = set()  # about whom something was said

    def take(self, client: Client, host: str) -> bool:
        """Give a client a place; False where there is none for it."""
        if self.turns_away(host):
            return False
        self.taken[client] = host
        self._count(host, 1)
        self.all_free.clear()
        self._stats.accepted += 1
        return True

    def turns_away(self, host: str) -> bool:
        """Say whether there is no place for a host; whoever asks turns it away then, which is counted."""
        limits = self._limits
        if limits.allowed is not None and not is_from(host, limits.allowed):
            self._stats.not_allowed += 1
            self._tell(host, f"{host} is turned away: it is not in modbus_tcp.allow")
            return True
        if self._has_kept_place(host):
            return False
        if limits.per_address is not None and self._of_address[host] >= limits.per_address:
            self._tell(host, f"{host} has {limits.per_address} connections already: further ones are turned away")
        elif self._is_full:
            others = " or kept for others" if limits.reserved else ""
            self._tell(ALL, f"all {limits.places} connections are taken{others}: further clients are turned away")
        else:
            return False
        self._stats.turned_away += 1
        return True

    def _has_kept_place(self, host: str) -> bool:
        group = self._limits.group(host)
        return group is not None and self._of_group[group] < group.places

    @property
    def _is_full(self) -> bool:
        kept = sum(max(0, one.places - self._of_group[one]) for one in self._limits.reserved)
        return len(self.taken) + kept >= self._limits.places

    def _tell(self, about: str, text: str) -> None:
        """Say it once: a client that tries again every second does not fill the log."""
        if about not in self._told and len(self._told) < TOLD_AT_MOST:
            self._told.add(about)
            log.warning("%s", text)

    def give_back(self, client: Client) -> None:
        """Take a client off, if it had a place."""
        host = self.taken.pop(client, None)
        if host is not None:
            self._count(host, -1)
            self._told -= {ALL, host}
        if not self.taken:
            self.all_free.set()

    def _count(self, host: str, change: int) -> None:
        self._of_address[host] += change
        if not self._of_address[host]:
            del self._of_address[host]
        group = self._limits.group(host)
        if group is not None:
            self._of_group[group] += change
        self._stats.connections = len(self.taken)
