"""Where the broker is, and what it is shown: user, password, certificate."""

from __future__ import annotations

import ssl
from dataclasses import dataclass, field
from urllib.parse import SplitResult, quote, urlsplit

from gateway.config import BrokerSection, Secret, TlsSection
from gateway.errors import BadConfig

DEFAULT_PORTS = {"mqtt": 1883, "mqtts": 8883, "ws": 80, "wss": 443}
DEFAULT_PATH = "/mqtt"  # of a WebSocket; most brokers have it there, and Mosquitto takes any
NO_PASSPHRASE = ""  # without it OpenSSL would ask at the terminal for the passphrase of an encrypted key


@dataclass(frozen=True, slots=True)
class Access:
    """All that a connection needs. Secrets do not show in its representation."""

    host: str
    port: int
    user: str | None = field(repr=False)
    password: str | None = field(repr=False)
    tls: ssl.SSLContext | None
    path: str | None = None  # of a WebSocket; None: plain TCP

    @property
    def authority(self) -> str:
        """Return host and port as HTTP names them: an IPv6 address in brackets, the port where it is not usual."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        usual = DEFAULT_PORTS["ws" if self.tls is None else "wss"]
        return host if self.port == usual else f"{host}:{self.port}"


def read(section: BrokerSection) -> Access:
    """Read secrets and certificates as they stand now; BadConfig says which file or variable is wrong."""
    url = urlsplit(section.url)
    user = section.user.reveal() if isinstance(section.user, Secret) else section.user
    return Access(
        host=url.hostname or "",
        port=url.port or DEFAULT_PORTS[url.scheme],
        user=user,
        password=None if section.password is None else section.password.reveal(),
        tls=_context(section.tls, section.table) if url.scheme in ("mqtts", "wss") else None,
        path=_path(url) if url.scheme in ("ws", "wss") else None,
    )


def _path(url: SplitResult) -> str:
    path = DEFAULT_PATH if url.path in ("", "/") else quote(url.path, safe="/%:@!$&'()*+,;=~-._")
    return f"{path}?{quote(url.query, safe='/%:@!$&()*+,;=~-._?')}" if url.query else path


def _context(tls: TlsSection, table: str) -> ssl.SSLContext:
    """Make a context that verifies the broker's certificate and its name, always."""
    try:
        context = ssl.create_default_context(cafile=tls.ca)
    except OSError as error:
        raise BadConfig(f"{table}.tls.ca: {tls.ca}: {error}") from error
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    if tls.certificate is not None:
        try:
            context.load_cert_chain(tls.certificate, tls.key, password=NO_PASSPHRASE)
        except OSError as error:
            reason = f"{table}.tls: certificate {tls.certificate} with key {tls.key}: {error}"
            raise BadConfig(f"{reason}; a PEM certificate and its key without a passphrase are wanted") from error
    return context
