"""The TLS handshakes under way: how many there may be and for how long, how they end, and in whose words. No I/O."""

from __future__ import annotations

import logging
import ssl
from collections import Counter
from typing import Protocol

from gateway.metrics import TcpStats
from gateway.modbus_tcp.session import CallLater, Timer

log = logging.getLogger("gateway.modbus_tcp")

DONE = "done"
NO_ROLE = "no_role"  # done, and good for nothing
STALLED = "stalled"
LEFT = "left"
PUSHED_OUT = "pushed_out"
OTHER = "other"
TOLD_AT_MOST = 256  # hosts and kinds of failure that are remembered as told
PACE = 0.05  # seconds; a handshake takes 1 to 4 ms of a PC's processor
TELL_AGAIN = 60.0  # seconds after which the same failure of the same host is told again
KINDS = (  # a part of OpenSSL's message, the kind of failure for programs, and what the operator may do
    ("certificate has expired", "expired", "its certificate has expired: renew it, or set the clock of this machine"),
    ("certificate is not yet valid", "not_yet_valid", "its certificate is not valid yet: are the clocks right?"),
    ("certificate revoked", "revoked", "its certificate is revoked"),
    ("CRL", "no_crl", "modbus_tcp.tls.crl has no valid list of the authority that signed its certificate"),
    ("unsuitable certificate purpose", "unsuitable", "its certificate is not for clients (extended key usage)"),
    ("unsupported certificate purpose", "unsuitable", "its certificate is not for clients (extended key usage)"),
    ("CERTIFICATE_VERIFY_FAILED", "untrusted", "modbus_tcp.tls.ca does not hold the authority of its certificate"),
    ("PEER_DID_NOT_RETURN_A_CERTIFICATE", "no_certificate", "it shows no certificate"),
    ("HTTP_REQUEST", "not_tls", "what it sends is no TLS"),
    ("HTTPS_PROXY_REQUEST", "not_tls", "what it sends is no TLS"),
    ("WRONG_VERSION_NUMBER", "not_tls", "what it sends is no TLS"),
    ("UNKNOWN_PROTOCOL", "not_tls", "what it sends is no TLS"),
    ("BAD_RECORD_TYPE", "not_tls", "what it sends is no TLS"),
    ("UNSUPPORTED_PROTOCOL", "version", "it does not speak TLS 1.2 or later"),
    ("VERSION_TOO_LOW", "version", "it does not speak TLS 1.2 or later"),
    ("NO_SHARED_CIPHER", "no_cipher", "it has no cipher that is safe enough"),
    ("ALERT", "refused_by_client", "it breaks off: it may not trust the gateway's certificate, or not its name"),
)


class Handshake(Protocol):
    """One that is under way."""

    host: str

    def go_on(self) -> None:
        """Do what was put off."""
        ...

    def give_up(self, kind: str, reason: str) -> None:
        """End it."""
        ...


class Handshakes:
    """Those under way; none has a place yet. With too many, the oldest of the host that has the most gives way.

    `limit` of them are done as they come, and those beyond one each `PACE`: a handshake keeps the loop from the lines
    for some milliseconds.
    """

    def __init__(self, limit: int, patience: float, stats: TcpStats, call_later: CallLater) -> None:
        self._limit = limit
        self._patience = patience  # seconds
        self._stats = stats
        self._call_later = call_later
        self._left, self._left_at = float(limit), float("-inf")  # how many may be done at once, and when that was so
        self._waiting: dict[Handshake, None] = {}  # in their order
        self._timer: Timer | None = None
        self._begun: dict[Handshake, float] = {}  # in the order in which they have begun
        self._told: dict[tuple[str, str], float] = {}

    def __len__(self) -> int:
        return len(self._begun)

    def begin(self, handshake: Handshake, now: float) -> None:
        """Take note of one; where there are too many, another gives way."""
        self._begun[handshake] = now
        if len(self._begun) > self._limit:
            greediest, _ = Counter(one.host for one in self._begun).most_common(1)[0]
            oldest = next(one for one in self._begun if one.host == greediest)
            oldest.give_up(PUSHED_OUT, "it was slow, and others came")

    def may_go_on(self, handshake: Handshake, now: float) -> bool:
        """Say whether one may be done now; it is called by `go_on` later where not."""
        self._left = min(self._limit, self._left + (now - self._left_at) / PACE)
        self._left_at = now
        if self._left >= 1 and not self._waiting:
            self._left -= 1
            return True
        self._waiting[handshake] = None
        if self._timer is None:
            self._timer = self._call_later(PACE, self._next)
        return False

    def _next(self) -> None:
        self._timer = None
        if self._waiting:
            first = next(iter(self._waiting))
            del self._waiting[first]
            self._left = max(0.0, self._left - 1)
            self._timer = self._call_later(PACE, self._next)
            first.go_on()

    def end(self, handshake: Handshake, kind: str, text: str, now: float) -> None:
        """Forget one, count how it ended, and say so."""
        self._waiting.pop(handshake, None)
        if self._begun.pop(handshake, None) is None:
            return
        self._stats.handshakes[kind] += 1
        if kind == DONE:
            log.info("%s: %s", handshake.host, text)
        else:
            self._warn(handshake.host, kind, text, now)

    def _warn(self, host: str, kind: str, text: str, now: float) -> None:
        """Say it once a minute at most: a client that tries again and again does not fill the log."""
        is_again = now - self._told.get((host, kind), float("-inf")) < TELL_AGAIN
        if not is_again:
            self._told.pop((host, kind), None)
            self._told[host, kind] = now
            if len(self._told) > TOLD_AT_MOST:
                del self._told[next(iter(self._told))]
        log.log(logging.DEBUG if is_again else logging.WARNING, "%s: %s", host, text)

    def sweep(self, now: float) -> None:
        """Give up those that take too long."""
        for handshake, began in tuple(self._begun.items()):
            if now - began > self._patience:
                handshake.give_up(STALLED, f"the handshake was not done within {self._patience:g} s")

    def give_up_all(self) -> None:
        """End them all: the gateway ends."""
        for handshake in tuple(self._begun):
            handshake.give_up(OTHER, "the gateway ends")
        if self._timer is not None:
            self._timer.cancel()


def explain(error: ssl.SSLError) -> tuple[str, str]:
    """Return the kind of a failure, and what the operator is told of it."""
    text = str(error)
    cause = getattr(error, "reason", None) or text
    for part, kind, reason in KINDS:
        if part in text:
            return kind, f"{reason} ({cause})"
    return OTHER, text
