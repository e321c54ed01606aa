"""The gateway's certificate, and the authorities whose clients it trusts: read, renewed, watched as they expire."""

from __future__ import annotations

import logging
import ssl
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from gateway.clock import Clock
from gateway.config import ModbusTlsSection
from gateway.errors import BadConfig
from gateway.metrics import TcpStats
from gateway.modbus_tcp.role_certificate import BadCertificate, RoleCertificate
from gateway.modbus_tcp.role_certificate import read as read_certificate

log = logging.getLogger("gateway.modbus_tcp")

TABLE = "modbus_tcp.tls"
NO_PASSPHRASE = ""  # without it OpenSSL would ask at the terminal for the passphrase of an encrypted key
LOOK_EVERY = 10.0  # seconds between two looks whether files have changed
DAY = 86_400.0  # seconds
BEGINS, ENDS = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"

Stamp = tuple[tuple[int, int, int], ...]
"""What tells whether files are the same: size, time of change in ns and number of each."""


@dataclass(frozen=True, slots=True)
class Credentials:
    """What was read from the files: `own` is the gateway's certificate, `authorities` those it trusts."""

    context: ssl.SSLContext
    own: RoleCertificate
    authorities: tuple[RoleCertificate, ...]


def load(section: ModbusTlsSection) -> Credentials:
    """Read the files; BadConfig says which is wrong."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2  # MODBUS/TCP Security: 1.2 or better, mutual
    context.verify_mode = ssl.CERT_REQUIRED
    context.options |= ssl.OP_NO_RENEGOTIATION
    try:
        context.load_cert_chain(section.certificate, section.key, password=NO_PASSPHRASE)
    except OSError as error:
        reason = f"{TABLE}: certificate {section.certificate} with key {section.key}: {error}"
        raise BadConfig(f"{reason}; a PEM certificate and its key without a passphrase are wanted") from error
    _trust(context, section.ca, "ca")
    if section.crl is not None:
        _trust(context, section.crl, "crl")
        context.verify_flags |= ssl.VERIFY_CRL_CHECK_LEAF
        if not context.cert_store_stats()["crl"]:
            raise BadConfig(f"{TABLE}.crl: {section.crl}: no revocation list in it")
    own, authorities = _read_all(section.certificate, "certificate"), _read_all(section.ca, "ca")
    if not own or not authorities:
        raise BadConfig(f"{TABLE}: no certificate in {section.ca if own else section.certificate}")
    return Credentials(context, own[0], authorities)


def report(section: ModbusTlsSection, wall: float) -> str:
    """Say how long the certificates hold at a moment (UTC seconds), or what is wrong with their files."""
    try:
        found = load(section)
    except BadConfig as error:
        return f"WARNING: {error}"
    soonest = min(found.authorities, key=lambda one: one.not_after)
    held = [_held(what, one, wall) for what, one in (("certificate", found.own), ("ca", soonest))]
    return "; ".join(held)


def _held(what: str, certificate: RoleCertificate, wall: float) -> str:
    until = f"{datetime.fromtimestamp(certificate.not_after, UTC):%Y-%m-%d}"
    if certificate.is_valid(wall):
        return f"{what} holds until {until}"
    return f"WARNING: {what} {'is not valid yet' if wall < certificate.not_before else f'has expired on {until}'}"


def _trust(context: ssl.SSLContext, path: str, key: str) -> None:
    try:
        context.load_verify_locations(path)
    except OSError as error:
        raise BadConfig(f"{TABLE}.{key}: {path}: {error}") from error


def _read_all(path: str, key: str) -> tuple[RoleCertificate, ...]:
    try:
        text = Path(path).read_text(encoding="ascii", errors="replace")
        return tuple(read_certificate(ssl.PEM_cert_to_DER_cert(block)) for block in _blocks(text))
    except (OSError, ValueError, BadCertificate) as error:
        raise BadConfig(f"{TABLE}.{key}: {path}: {error}") from error


def _blocks(text: str) -> Iterator[str]:
    for part in text.split(BEGINS)[1:]:
        body, end, _ = part.partition(ENDS)
        if end:
            yield BEGINS + body + ENDS


class Keyring:
    """The credentials in force. Files that have changed are read anew; wrong ones change nothing."""

    def __init__(self, section: ModbusTlsSection, clock: Clock, stats: TcpStats) -> None:
        self._section = section
        self._clock = clock
        self._stats = stats
        self._stamp = self._look()
        self.credentials = load(section)
        self._next_look = clock.now() + LOOK_EVERY
        self._warned: dict[str, tuple[float, float]] = {}  # by certificate: which one, and when it was said last
        self._watch()

    @property
    def is_own_valid(self) -> bool:
        """Say whether the gateway's own certificate holds now."""
        return self.credentials.own.is_valid(self._clock.wall())

    def pulse(self) -> None:
        """Look now and then whether files have changed, and warn of what expires."""
        if self._clock.now() >= self._next_look:
            self._next_look = self._clock.now() + LOOK_EVERY
            self.renew()

    def renew(self) -> None:
        """Read the files where they have changed; connections that stand are not touched."""
        stamp = self._look()
        if stamp != self._stamp:
            self._stamp = stamp
            try:
                self.credentials = load(self._section)
                log.info("the certificates of modbus_tcp.tls were read anew")
            except BadConfig as error:
                log.error("the certificates of modbus_tcp.tls stay as they were: %s", error)
        self._watch()

    def _look(self) -> Stamp:
        section = self._section
        paths = (section.certificate, section.key, section.ca, section.crl)
        return tuple(_stamp(path) for path in paths if path is not None)

    def _watch(self) -> None:
        """Publish when certificates expire; warn, once a day, of those that soon will."""
        own, authorities = self.credentials.own, self.credentials.authorities
        soonest = min(authorities, key=lambda one: one.not_after)
        for what, certificate in (("certificate", own), ("ca", soonest)):
            self._stats.certificates[what] = certificate.not_after
            self._warn(what, certificate)

    def _warn(self, what: str, certificate: RoleCertificate) -> None:
        now, wall = self._clock.now(), self._clock.wall()
        days = (certificate.not_after - wall) / DAY
        is_sound = wall >= certificate.not_before and days > self._section.warn_days
        which, said = self._warned.get(what, (0.0, float("-inf")))
        if is_sound or (which == certificate.not_after and now - said < DAY):
            return
        self._warned[what] = (certificate.not_after, now)
        path = self._section.certificate if what == "certificate" else self._section.ca
        loss = "clients may only read by TLS" if what == "certificate" else "its clients are refused"
        if wall < certificate.not_before:
            log.error("modbus_tcp.tls.%s %s is not valid yet: %s; is the clock right?", what, path, loss)
        elif days <= 0:
            log.error("modbus_tcp.tls.%s %s has expired: %s until it is renewed", what, path, loss)
        else:
            log.warning("modbus_tcp.tls.%s %s expires in %.1f days: then %s", what, path, days, loss)


def _stamp(path: str) -> tuple[int, int, int]:
    try:
        found = Path(path).stat()
    except OSError:
        return 0, 0, 0
    return found.st_size, found.st_mtime_ns, found.st_ino
