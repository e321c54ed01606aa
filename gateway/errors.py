"""Errors, grouped by what the caller does next; each docstring is the policy."""

from __future__ import annotations

from enum import Enum


class GatewayError(Exception):
    """Whatever the gateway can explain to its operator; never shown as a traceback."""


class BadConfig(GatewayError):
    """The configuration or a catalogue file is wrong: say where, what would be right, and do not start."""


class LineDown(GatewayError):
    """The port is gone or cannot be opened: drop what waits, reopen with back-off."""


class NoReply(GatewayError):
    """Silence: retry, and count it against the drive's link."""


class TooLate(GatewayError):
    """The line was not free in time: nothing was sent, and nothing is to be sent later."""


class BadReply(GatewayError):
    """Bytes that are no answer to the request: drain until silence, then as for silence."""


class CoreTaskEnded(GatewayError):
    """A task that must run for ever has ended: the process ends too, and the service manager starts it anew."""


class Refusal(Enum):
    """Why a drive says no, whatever protocol it says it in.

    MODBUS-RTU error codes 01-04 (E6581657 5.3); the TOSHIBA protocol's 0000-0004 (E6581657 4.3).
    """

    COMMAND = "command not known"
    ADDRESS = "communication number not known, or not writable"
    RANGE = "data range error"
    UNABLE = "impossible to execute now"
    CHECKSUM = "checksum error"
    OTHER = "unknown error code"


class Refused(GatewayError):
    """The drive understood and said no: do not retry."""

    def __init__(self, message: str, reason: Refusal, is_tripped: bool | None = None) -> None:
        super().__init__(message)
        self.reason = reason
        self.is_tripped = is_tripped  # None where the protocol does not say
