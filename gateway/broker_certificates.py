"""Watches the certificates of brokers: the gateway's and the authorities'; warned of before they expire.

They are read anew for each connection (`mqtt.access`); here is only how long they hold.
"""

from __future__ import annotations

import logging
import re
import ssl
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from gateway.clock import Clock
from gateway.config import BrokerSection, Config
from gateway.metrics import MqttStats, Stats
from gateway.modbus_tcp.role_certificate import BadCertificate, RoleCertificate
from gateway.modbus_tcp.role_certificate import read as read_certificate

LOOK_EVERY = 10.0  # seconds between two looks at the files
DAY = 86_400.0  # seconds
CERTIFICATE, CA = "certificate", "ca"
LOSS = {CERTIFICATE: "the broker refuses it", CA: "the broker's certificate is not trusted"}
BLOCK = re.compile(r"-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", re.DOTALL)

Stamp = tuple[int, int, int]
"""What tells whether a file is the same: size, time of change in ns and number."""


class Watch:
    """One file of one broker's TLS: when it expires, and what is said of that."""

    def __init__(self, section: BrokerSection, stats: MqttStats, what: str, path: str) -> None:
        self._table = f"{section.table}.tls.{what}"
        self._log = logging.getLogger(section.channel)
        self._warn_days = section.tls.warn_days
        self._certificates = stats.certificates
        self._what, self._path = what, path
        self._stamp: Stamp | None = None
        self._found: Sequence[RoleCertificate] = ()
        self._said = float("-inf")  # monotonic seconds; anew for another file

    def look(self, now: float, wall: float) -> None:
        """Read the file where it has changed; warn, once a day, where it will soon hold no more."""
        stamp = _stamp(self._path)
        if stamp != self._stamp:
            self._stamp, self._said = stamp, float("-inf")
            self._read()
        if self._found:
            found = first_to_expire(self._what, self._found, wall)
            self._certificates[self._what] = found.not_after
            if now - self._said >= DAY:
                self._warn(found, now, wall)

    def _read(self) -> None:
        try:
            self._found = read(self._path)
        except ValueError as error:
            self._found = ()
            self._certificates.pop(self._what, None)
            self._log.warning("%s: %s; when it expires is not known", self._table, error)

    def _warn(self, found: RoleCertificate, now: float, wall: float) -> None:
        days = (found.not_after - wall) / DAY
        if wall >= found.not_before and days > self._warn_days:
            return
        self._said = now
        loss = LOSS[self._what]
        if wall < found.not_before:
            self._log.error("%s %s is not valid yet: %s; is the clock right?", self._table, self._path, loss)
        elif days <= 0:
            self._log.error("%s %s has expired: %s until it is renewed", self._table, self._path, loss)
        else:
            self._log.warning("%s %s expires in %.1f days: then %s", self._table, self._path, days, loss)


class Watches:
    """All files of all brokers; one that several connections have is watched, and warned of, for each."""

    def __init__(self, config: Config, stats: Stats, clock: Clock) -> None:
        self._clock = clock
        self._next_look = float("-inf")
        self._all = [
            Watch(section, of, what, path)
            for section, of in _brokers(config, stats.brokers, stats.sparkplug)
            for what, path in files(section)
        ]

    def pulse(self) -> None:
        """Look now and then."""
        now = self._clock.now()
        if self._all and now >= self._next_look:
            self._next_look = now + LOOK_EVERY
            for watch in self._all:
                watch.look(now, self._clock.wall())


def _brokers(
    config: Config, brokers: Mapping[str, MqttStats], sparkplug: MqttStats
) -> Iterator[tuple[BrokerSection, MqttStats]]:
    for section in config.brokers:
        yield section, brokers[section.origin]
    if config.sparkplug is not None:
        yield config.sparkplug, sparkplug


def files(section: BrokerSection) -> Sequence[tuple[str, str]]:
    """Return the files to watch of a broker, by what they are: none where the system's authorities are trusted."""
    named = ((CERTIFICATE, section.tls.certificate), (CA, section.tls.ca))
    return [(what, path) for what, path in named if path is not None]


def read(path: str) -> Sequence[RoleCertificate]:
    """Return the certificates in a file, one at the least; ValueError says what is wrong."""
    try:
        blocks = BLOCK.findall(Path(path).read_text(encoding="ascii", errors="replace"))
        found = [read_certificate(ssl.PEM_cert_to_DER_cert(block)) for block in blocks]
    except (OSError, BadCertificate, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    if not found:
        raise ValueError(f"{path}: no certificate in it")
    return found


def first_to_expire(what: str, found: Sequence[RoleCertificate], wall: float) -> RoleCertificate:
    """Return the gateway's certificate, or of the authorities the first to expire.

    Of several those that hold count: bundles have old ones, as has a file in which one takes the place of another.
    """
    if what == CERTIFICATE:
        return found[0]
    return min([one for one in found if one.is_valid(wall)] or found, key=lambda one: one.not_after)


def report(section: BrokerSection, wall: float) -> Iterator[str]:
    """Say of each file how long it holds at a moment (UTC seconds), or what is wrong with it."""
    for what, path in files(section):
        try:
            found = first_to_expire(what, read(path), wall)
        except ValueError as error:
            yield f"WARNING: {section.table}.tls.{what}: {error}"
            continue
        until = f"{datetime.fromtimestamp(found.not_after, UTC):%Y-%m-%d}"
        if found.is_valid(wall):
            yield f"{what} {path} holds until {until}"
        elif wall < found.not_before:
            yield f"WARNING: {what} {path} is not valid yet"
        else:
            yield f"WARNING: {what} {path} has expired on {until}"


def _stamp(path: str) -> Stamp:
    try:
        found = Path(path).stat()
    except OSError:
        return 0, 0, 0
    return found.st_size, found.st_mtime_ns, found.st_ino
