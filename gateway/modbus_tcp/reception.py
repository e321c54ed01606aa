"""Says by whom a client is served: who answers what it may read, and who carries out what it may write. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway.control.command import Channel, Source
from gateway.control.door import Door
from gateway.metrics import TcpStats
from gateway.modbus_tcp.guard import GuardedResponder, GuardedWriter, Ward
from gateway.modbus_tcp.hosts import source_name
from gateway.modbus_tcp.responder import Identify, Responder, Unit
from gateway.modbus_tcp.rights import Grants, Rights
from gateway.modbus_tcp.session import Writer


@dataclass(frozen=True, slots=True)
class Served:
    """What one client talks to, and as whom it commands."""

    responder: Responder
    writers: Mapping[int, Writer]
    source: Source


class Reception:
    """Those who serve, one for each different set of rights, and `free` for who is limited by `control` alone."""

    def __init__(
        self,
        units: Mapping[int, Unit],
        identify: Identify,
        stats: TcpStats,
        wards: Mapping[int, Ward],
        grants: Grants,
        door: Door | None,
    ) -> None:
        self._units = units
        self._identify = identify
        self._stats = stats
        self._wards = wards
        self._grants = grants
        self._door = door
        self.free = Responder(units, identify, stats)
        self.free_writers: dict[int, Writer] = {unit: ward.writer for unit, ward in wards.items()}
        self._of_rights: dict[Rights, tuple[Responder, Mapping[int, Writer]]] = {}

    @property
    def is_open(self) -> bool:
        """Say whether all clients without TLS have the same rights: those that `control` gives."""
        return not self._grants.restricts_plain

    def plain(self, host: str) -> Served:
        """Return by whom a client without TLS is served."""
        rights = self._grants.of_plain(host)
        source = Source(Channel.MODBUS_TCP, host)
        if rights is None:
            return Served(self.free, self.free_writers, source)
        return Served(*self._serving(rights), source)

    def secured(self, role: str | None, host: str, *, is_trusted: bool = True) -> Served:
        """Return by whom a client with a certificate is served, by its role; None is no role.

        Where the gateway's own certificate has expired, nobody writes (SAFETY.md H32).
        """
        rights = self._grants.of_role(role, host)
        if not is_trusted:
            rights = rights.reading()
        name = host if role is None else source_name(role, host)
        return Served(*self._serving(rights), Source(Channel.MODBUS_TCP, name))

    def _serving(self, rights: Rights) -> tuple[Responder, Mapping[int, Writer]]:
        if rights not in self._of_rights:
            responder = GuardedResponder(self._units, self._identify, self._stats, rights)
            door, wards = self._door, self._wards.items() if self._door else ()
            writers = {unit: GuardedWriter(ward, rights, door, self._stats) for unit, ward in wards if door}
            self._of_rights[rights] = (responder, writers)
        return self._of_rights[rights]
