"""Where the socket and the files of a gateway's trace are, for the gateway and for whoever looks for them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from gateway.site import Site

SERVICE = Path("/run/tosvert-gateway")  # RuntimeDirectory= of the unit in deploy/


def socket_path(site: Site, environment: Mapping[str, str] = os.environ) -> Path:
    """Return where the gateway serves: as configured, else in $RUNTIME_DIRECTORY, else in the file's folder."""
    if site.config.trace.socket is not None:
        return site.folder / site.config.trace.socket
    return (_first(environment, "RUNTIME_DIRECTORY") or site.folder) / _name(site)


def sockets_to_try(site: Site, environment: Mapping[str, str] = os.environ) -> Iterator[Path]:
    """Yield where a running gateway with that configuration may serve, the likeliest first."""
    yield socket_path(site, environment)
    if site.config.trace.socket is None:
        yield SERVICE / _name(site)
        yield site.folder / _name(site)


def directory(site: Site, environment: Mapping[str, str] = os.environ) -> Path:
    """Return where files are written: as configured, else in $STATE_DIRECTORY, else in the file's folder."""
    if site.config.trace.directory is not None:
        return site.folder / site.config.trace.directory
    return (_first(environment, "STATE_DIRECTORY") or site.folder) / "traces"


def _name(site: Site) -> str:
    return f"trace-{site.config.gateway.name}.sock"


def _first(environment: Mapping[str, str], variable: str) -> Path | None:
    found = environment.get(variable, "").split(":")[0]  # systemd lists several with colons
    return Path(found) if found else None
