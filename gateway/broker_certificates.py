"""Watches the certificates of brokers: the gateway's and the authorities'; warned of before they expire.

They are read anew for each connection (`mqtt.access`); here is only how long they hold.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence

from gateway.clock import Clock
from gateway.config import BrokerSection, Config
from gateway.metrics import MqttStats, Stats
from gateway.modbus_tcp import certificate_files
from gateway.modbus_tcp.certificate_files import LOOK_EVERY, Reminder, Stamp, held, stamp
from gateway.modbus_tcp.role_certificate import RoleCertificate

CERTIFICATE, CA = "certificate", "ca"
LOSS = {CERTIFICATE: "the broker refuses it", CA: "the broker's certificate is not trusted"}


class Watch:
    """One file of one broker's TLS: when it expires, and what is said of that."""

    def __init__(self, section: BrokerSection, stats: MqttStats, what: str, path: str) -> None:
        self._named = f"{section.table}.tls.{what}"
        self._log = logging.getLogger(section.channel)
        self._reminder = Reminder(self._log, section.tls.warn_days)
        self._certificates = stats.certificates
        self._what, self._path = what, path
        self._stamp: Stamp | None = None
        self._found: Sequence[RoleCertificate] = ()

    def look(self, now: float, wall: float) -> None:
        """Read the file where it has changed; warn, once a day, where it will soon hold no more."""
        found = stamp(self._path)
        if found != self._stamp:
            self._stamp = found
            self._read()
        if self._found:
            first = first_to_expire(self._what, self._found, wall)
            self._certificates[self._what] = first.not_after
            self._reminder.look(f"{self._named} {self._path}", first, LOSS[self._what], now, wall)

    def _read(self) -> None:
        try:
            self._found = read(self._path)
        except ValueError as error:
            self._found = ()
            self._certificates.pop(self._what, None)
            self._log.warning("%s: %s; when it expires is not known", self._named, error)


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
    found = certificate_files.read(path)
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
        yield held(f"{what} {path}", found, wall)
