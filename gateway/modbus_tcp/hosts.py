"""Names clients by their addresses: IPv4 clients of an IPv6 socket by their IPv4 address, without a zone. Pure."""

from __future__ import annotations

import contextlib
import ipaddress
from collections.abc import Iterable, Sequence

Network = ipaddress.IPv4Network | ipaddress.IPv6Network
AT = "@"  # between a role and its host, in the name of a source


def host_of(peer: Sequence[object] | None) -> str:
    """Return the address of a socket's peer; empty where it has none."""
    host = str(peer[0]).partition("%")[0] if peer else ""
    with contextlib.suppress(ValueError):
        address = ipaddress.ip_address(host)
        host = str(getattr(address, "ipv4_mapped", None) or address)
    return host


def peer_name(peer: Sequence[object] | None) -> str:
    """Return how a client is called in the log: "192.0.2.7:50123", "[2001:db8::7]:50123"."""
    if not peer or len(peer) < 2:
        return "a client that is gone"
    host = host_of(peer)
    return f"[{host}]:{peer[1]}" if ":" in host else f"{host}:{peer[1]}"


def source_name(role: str, host: str) -> str:
    """Return how a controller with a certificate is called: two roles on one machine are two controllers."""
    return f"{role}{AT}{host}"


def host_of_source(name: str) -> str:
    """Return the address of a controller, with a role or without."""
    return name.rpartition(AT)[2]


def networks(texts: Iterable[str]) -> tuple[Network, ...]:
    """Read addresses and networks."""
    return tuple(ipaddress.ip_network(text) for text in texts)


def is_from(host: str, of: Iterable[Network]) -> bool:
    """Say whether a host, as `host_of` names it, is in one of some networks; who has no address is in none."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return False
    return any(address in network for network in of)
