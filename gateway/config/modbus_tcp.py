"""The section `[modbus_tcp]`: who is served where, by TLS or RTU frames, with what rights and which map."""

from __future__ import annotations

from decimal import Decimal
from typing import Literal

from pydantic import Field, model_validator

from gateway.config.notation import (
    OFF,
    Duration,
    Function,
    Listen,
    ListenOrOff,
    Network,
    PointName,
    Registers,
    Units,
    seconds,
)
from gateway.config.section import Section


class MapSection(Section):
    """One value at an address of the user's own."""

    point: PointName = Field(description='drive and value: "pump-1.output_frequency"')
    address: int = Field(ge=0, le=0xFFFF, description="of its first register, counted from 0")
    type: Literal["word", "signed", "int32", "uint32", "float32"] = Field(
        "word", description="word: as the drive has it; signed: 16 bits; all but word are the value in its unit"
    )
    scale: float = Field(1.0, ge=1e-6, le=1e6, description="the value is multiplied by it, and rounded where whole")
    word_order: Literal["big", "little"] = Field("big", description="of 32 bits; big: the high word first")
    unit: int | None = Field(None, ge=1, le=255, description="MODBUS-TCP unit id; map_unit by default")

    @model_validator(mode="after")
    def _sound(self) -> MapSection:
        if self.type == "word" and "scale" in self.model_fields_set:
            raise ValueError('scale: a "word" is as the drive has it; give it another type, such as "signed"')
        if self.type in ("word", "signed") and "word_order" in self.model_fields_set:
            raise ValueError(f'word_order: "{self.type}" is one word; only 32 bits have an order')
        return self

    @property
    def drive(self) -> str:
        """Return the drive's name, which may contain dots."""
        return self.point.rpartition(".")[0]

    @property
    def value(self) -> str:
        """Return the value's name."""
        return self.point.rpartition(".")[2]

    @property
    def factor(self) -> Decimal:
        """Return the scale exactly as it is written."""
        return Decimal(str(self.scale))


class ReservedSection(Section):
    """Places of the MODBUS-TCP server that are kept for some clients."""

    addresses: list[Network] = Field(min_length=1, description="whose: addresses or networks")
    places: int = Field(ge=1, le=1000, description="how many of `connections`")


class ModbusTlsSection(Section):
    """MODBUS/TCP Security: clients show a certificate, which says their role."""

    listen: Listen = "127.0.0.1:802"
    certificate: str = Field(min_length=1, description="the gateway's certificate (PEM), its intermediates behind it")
    key: str = Field(min_length=1, description="its private key (PEM), without a passphrase")
    ca: str = Field(min_length=1, description="file of the authorities that sign clients' certificates (PEM)")
    crl: str | None = Field(None, min_length=1, description="file of revocation lists (PEM), one of each authority")
    handshake_timeout: Duration = Field(seconds("5s"), ge=0.1, le=60)
    warn_days: int = Field(30, ge=1, le=365, description="it is warned so long before a certificate expires")


class ModbusRtuSection(Section):
    """MODBUS-RTU frames over TCP, for masters that know nothing else."""

    listen: Listen = "127.0.0.1:5021"


class TcpRightSection(Section):
    """What some clients of the MODBUS-TCP server may do. It takes away only: `control` and `sources` hold besides."""

    role: str | None = Field(
        None, min_length=1, max_length=64, description="of clients by TLS, * and ? stand for any; without: all others"
    )
    addresses: list[Network] | None = Field(None, min_length=1, description="only clients from there; all by default")
    units: list[Units] | None = Field(None, min_length=1, description="unit ids or [first, last]; all by default")
    functions: list[Function] = Field(["read"], min_length=1, description='"read", "write", or function codes')
    registers: list[Registers] | None = Field(
        None, min_length=1, description="numbers or [first, last]; all by default"
    )


class ModbusTcpSection(Section):
    """The MODBUS-TCP server."""

    listen: ListenOrOff = Field("127.0.0.1:5020", description='without TLS; "off": not at all')
    connections: int = Field(32, ge=1, le=1000)
    per_address: int | None = Field(None, ge=1, le=1000, description="connections of one client; no limit by default")
    reserved: list[ReservedSection] = Field([], description="places that are kept for some clients")
    allow: list[Network] | None = Field(None, min_length=1, description="who may connect at all; all by default")
    idle_timeout: Duration = Field(seconds("60s"), ge=1)
    tls: ModbusTlsSection | None = None
    rtu: ModbusRtuSection | None = None
    right: list[TcpRightSection] = Field([], description="what clients may do; see docs/modbus-tcp.md")
    map_unit: int = Field(247, ge=1, le=255, description="unit id of the user-defined map; no drive's")
    map: list[MapSection] = Field([], description="the user-defined map: values at addresses of your own")

    @model_validator(mode="after")
    def _served(self) -> ModbusTcpSection:
        if self.listen == OFF and self.tls is None and self.rtu is None:
            raise ValueError('listen = "off": nobody is served; give [modbus_tcp.tls] or [modbus_tcp.rtu]')
        kept = sum(reserved.places for reserved in self.reserved)
        if kept > self.connections:
            raise ValueError(f"reserved: {kept} places are kept, and connections are {self.connections}")
        if self.tls is None and any(right.role is not None for right in self.right):
            raise ValueError("right: a role is told by certificates only: give [modbus_tcp.tls]")
        return self

    def unit_of(self, entry: MapSection) -> int:
        """Return the unit id under which an entry is read."""
        return self.map_unit if entry.unit is None else entry.unit
