"""Files of certificates: what is in them, whether they have changed, and that they expire, said once a day."""

from __future__ import annotations

import logging
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from gateway.modbus_tcp.role_certificate import BadCertificate, RoleCertificate
from gateway.modbus_tcp.role_certificate import read as read_certificate

LOOK_EVERY = 10.0  # seconds between two looks whether files have changed
DAY = 86_400.0  # seconds
BEGINS, ENDS = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"

Stamp = tuple[int, int, int]
"""What tells whether a file is the same: size, time of change in ns and number."""


def stamp(path: str) -> Stamp:
    """Return what tells whether a file is the same; zeros where there is none."""
    try:
        found = Path(path).stat()
    except OSError:
        return 0, 0, 0
    return found.st_size, found.st_mtime_ns, found.st_ino


def read(path: str) -> tuple[RoleCertificate, ...]:
    """Return the certificates in a PEM file, none where it has none; ValueError says what is wrong, and where."""
    try:
        text = Path(path).read_text(encoding="ascii", errors="replace")
        return tuple(read_certificate(ssl.PEM_cert_to_DER_cert(block)) for block in _blocks(text))
    except (OSError, ValueError, BadCertificate) as error:
        raise ValueError(f"{path}: {error}") from error


def _blocks(text: str) -> Iterator[str]:
    for part in text.split(BEGINS)[1:]:
        body, end, _ = part.partition(ENDS)
        if end:
            yield BEGINS + body + ENDS


def held(what: str, certificate: RoleCertificate, wall: float) -> str:
    """Say how long a certificate holds at a moment (UTC seconds), with a warning where it does not."""
    until = f"{datetime.fromtimestamp(certificate.not_after, UTC):%Y-%m-%d}"
    if certificate.is_valid(wall):
        return f"{what} holds until {until}"
    return f"WARNING: {what} {'is not valid yet' if wall < certificate.not_before else f'has expired on {until}'}"


class Reminder:
    """Warns in a log of certificates that expire within `warn_days`: once a day, and at once of another one."""

    def __init__(self, log: logging.Logger, warn_days: float) -> None:
        self._log = log
        self._warn_days = warn_days
        self._warned: dict[str, tuple[float, float]] = {}  # by file: which certificate, and when it was said last

    def look(self, what: str, certificate: RoleCertificate, loss: str, now: float, wall: float) -> None:
        """Look at a certificate, `what` being its key and file; `loss` is what happens without it.

        `now` and `wall` are monotonic and UTC seconds.
        """
        days = (certificate.not_after - wall) / DAY
        is_sound = wall >= certificate.not_before and days > self._warn_days
        which, said = self._warned.get(what, (0.0, float("-inf")))
        if is_sound or (which == certificate.not_after and now - said < DAY):
            return
        self._warned[what] = (certificate.not_after, now)
        if wall < certificate.not_before:
            self._log.error("%s is not valid yet: %s; is the clock right?", what, loss)
        elif days <= 0:
            self._log.error("%s has expired: %s until it is renewed", what, loss)
        else:
            self._log.warning("%s expires in %.1f days: then %s", what, days, loss)
