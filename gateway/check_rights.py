"""What `check` says of the ways in by MODBUS-TCP: where they are, who may connect, and who may do what."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gateway.config import OFF, ModbusTcpSection, TcpRightSection
from gateway.site import Site

READ_ONLY = "may read every register, and write nothing"


def report(configured: Site) -> Iterator[str]:
    """Yield the ways in, the limits, and the rights of each kind of client; nothing without MODBUS-TCP."""
    section = configured.config.modbus_tcp
    if section is None:
        return
    yield from _ways(section)
    yield f"  connections: {section.connections}{_limits(section)}"
    if section.allow is not None:
        yield f"  only from {', '.join(section.allow)}"
    can_command = any(drive.is_commanded_by("modbus-tcp") for drive in configured.drives)
    yield from _rights(section, can_command=can_command)


def _ways(section: ModbusTcpSection) -> Iterator[str]:
    if section.listen != OFF:
        yield f"MODBUS-TCP on {section.listen}"
    if section.tls is not None:
        files = f"certificate {section.tls.certificate}, ca {section.tls.ca}"
        yield f"MODBUS/TCP Security on {section.tls.listen}: {files}"
    if section.rtu is not None:
        yield f"MODBUS-RTU over TCP on {section.rtu.listen}"


def _limits(section: ModbusTcpSection) -> str:
    each = "" if section.per_address is None else f", {section.per_address} of one address"
    kept = "".join(f", {one.places} kept for {', '.join(one.addresses)}" for one in section.reserved)
    return each + kept


def _rights(section: ModbusTcpSection, *, can_command: bool) -> Iterator[str]:
    plain = [right for right in section.right if right.role is None]
    roles = [right for right in section.right if right.role is not None]
    if section.listen != OFF or section.rtu is not None:
        yield from _of_plain(section, plain, can_command=can_command)
    if section.tls is not None:
        yield "  clients by TLS without a role: may do nothing"
        if not roles:
            yield f"  clients by TLS with any role: {READ_ONLY}"
        for right in roles:
            yield f"  role {right.role}{_from(right)}: {in_words(right)}"
        if roles:
            yield "  all other roles: may do nothing"


def _of_plain(section: ModbusTcpSection, rights: Sequence[TcpRightSection], *, can_command: bool) -> Iterator[str]:
    who = "  clients without TLS"
    for right in rights:
        yield f"{who}{_from(right)}: {in_words(right)}"
    if rights and all(right.addresses is not None for right in rights):
        yield "  all others without TLS: may do nothing"
    elif not rights and section.tls is not None:
        yield f"{who}: {READ_ONLY}"
    elif not rights and can_command:
        yield f"{who}: may read every register, and write what `control`, `sources` and `right` of the drives permit"
    elif not rights:
        yield f"{who}: {READ_ONLY}: no drive may be commanded by MODBUS-TCP"
    if any("write" in right.functions for right in rights) and section.tls is not None:
        yield "    WARNING: they may write without TLS: whoever can send from such an address may"


def _from(right: TcpRightSection) -> str:
    return "" if right.addresses is None else f" from {', '.join(right.addresses)}"


def in_words(section: TcpRightSection) -> str:
    """Say what a right permits, in one line."""
    functions = ", ".join(one if isinstance(one, str) else f"{one:02X}H" for one in section.functions)
    units = "every unit" if section.units is None else f"units {_spans(section.units, '{}')}"
    registers = "every register" if section.registers is None else f"registers {_spans(section.registers, '{:04X}H')}"
    return f"{functions}; {units}; {registers}"


def _spans(spans: Sequence[tuple[int, int]], form: str) -> str:
    named = ((form.format(low), form.format(high)) for low, high in spans)
    return ", ".join(low if low == high else f"{low} to {high}" for low, high in named)
