"""The gateway's certificate, and the authorities whose clients it trusts: read, renewed, watched as they expire."""

from __future__ import annotations

import logging
import ssl
from dataclasses import dataclass

from gateway.clock import Clock
from gateway.config import ModbusTlsSection
from gateway.errors import BadConfig
from gateway.metrics import TcpStats
from gateway.modbus_tcp import certificate_files
from gateway.modbus_tcp.certificate_files import LOOK_EVERY
from gateway.modbus_tcp.role_certificate import RoleCertificate

log = logging.getLogger("gateway.modbus_tcp")

TABLE = "modbus_tcp.tls"
NO_PASSPHRASE = ""  # without it OpenSSL would ask at the terminal for the passphrase of an encrypted key


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
    own, authorities = _read(section.certificate, "certificate"), _read(section.ca, "ca")
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
    held = [certificate_files.held(what, one, wall) for what, one in (("certificate", found.own), ("ca", soonest))]
    return "; ".join(held)


def _trust(context: ssl.SSLContext, path: str, key: str) -> None:
    try:
        context.load_verify_locations(path)
    except OSError as error:
        raise BadConfig(f"{TABLE}.{key}: {path}: {error}") from error


def _read(path: str, key: str) -> tuple[RoleCertificate, ...]:
    try:
        return certificate_files.read(path)
    except ValueError as error:
        raise BadConfig(f"{TABLE}.{key}: {error}") from error


class Keyring:
    """The credentials in force. Files that have changed are read anew; wrong ones change nothing."""

    def __init__(self, section: ModbusTlsSection, clock: Clock, stats: TcpStats) -> None:
        self._section = section
        self._clock = clock
        self._stats = stats
        self._stamp = self._look()
        self.credentials = load(section)
        self._next_look = clock.now() + LOOK_EVERY
        self._reminder = certificate_files.Reminder(log, section.warn_days)
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

    def _look(self) -> tuple[certificate_files.Stamp, ...]:
        section = self._section
        paths = (section.certificate, section.key, section.ca, section.crl)
        return tuple(certificate_files.stamp(path) for path in paths if path is not None)

    def _watch(self) -> None:
        """Publish when certificates expire; warn, once a day, of those that soon will."""
        own, authorities = self.credentials.own, self.credentials.authorities
        soonest = min(authorities, key=lambda one: one.not_after)
        for what, certificate in (("certificate", own), ("ca", soonest)):
            self._stats.certificates[what] = certificate.not_after
            is_own = certificate is own
            named = f"{TABLE}.{what} {self._section.certificate if is_own else self._section.ca}"
            loss = "clients may only read by TLS" if is_own else "its clients are refused"
            self._reminder.look(named, certificate, loss, self._clock.now(), self._clock.wall())
