"""The exception codes of MODBUS-TCP answers: why a value is not given, and why a command was not carried out."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from gateway.control.command import Reason, Result, Status
from gateway.image import LinkState, Missing


class ExceptionCode(IntEnum):
    """MODBUS Application Protocol V1.1b3, 7, as far as this gateway uses them."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_DATA_ADDRESS = 0x02
    ILLEGAL_DATA_VALUE = 0x03
    SERVER_DEVICE_FAILURE = 0x04
    ACKNOWLEDGE = 0x05
    SERVER_DEVICE_BUSY = 0x06
    GATEWAY_PATH_UNAVAILABLE = 0x0A
    GATEWAY_TARGET_FAILED_TO_RESPOND = 0x0B


class Wrong(Exception):
    """A request that is not carried out, and the exception that says so."""

    def __init__(self, code: ExceptionCode) -> None:
        super().__init__(code.name)
        self.code = code


CODE_FOR = {
    Missing.UNMAPPED: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Missing.NOT_FRESH: ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND,
    Missing.LINE_DOWN: ExceptionCode.GATEWAY_PATH_UNAVAILABLE,
    Missing.NOT_FITTING: ExceptionCode.SERVER_DEVICE_FAILURE,
}

REFUSED: Mapping[Reason, ExceptionCode] = {  # nothing was sent
    Reason.NOT_CONTROLLED: ExceptionCode.ILLEGAL_FUNCTION,
    Reason.NOT_PERMITTED: ExceptionCode.ILLEGAL_FUNCTION,
    Reason.NOT_IN_MODEL: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Reason.READ_ONLY: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Reason.FORBIDDEN: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Reason.STORED: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Reason.RANGE: ExceptionCode.ILLEGAL_DATA_VALUE,
    Reason.MALFORMED: ExceptionCode.ILLEGAL_DATA_VALUE,
    Reason.RETAINED: ExceptionCode.ILLEGAL_DATA_VALUE,
    Reason.NO_WATCHDOG: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.WORN: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.NO_STORE: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.REFUSED_BY_DRIVE: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.NOT_READ_BACK: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.STILL_TRIPPED: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.NONE: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.NOT_OWNER: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.NOT_ARMED: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.QUIESCED: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.BUSY: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.TOO_OFTEN: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.EXPIRED: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.SUPERSEDED: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.STOPPED: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.ENDING: ExceptionCode.SERVER_DEVICE_BUSY,
    Reason.UNKNOWN_DRIVE: ExceptionCode.GATEWAY_PATH_UNAVAILABLE,
    Reason.LINE_DOWN: ExceptionCode.GATEWAY_PATH_UNAVAILABLE,
    Reason.OFFLINE: ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND,
    Reason.NO_ANSWER: ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND,
}
BESIDE_A_STOP = frozenset(  # nothing that was sent fails so: of the words beside a stop none was
    (Reason.NOT_PERMITTED, Reason.NOT_IN_MODEL, Reason.READ_ONLY, Reason.FORBIDDEN, Reason.STORED, Reason.RANGE)
)
TARGET_LOST = frozenset((Reason.NO_ANSWER, Reason.OFFLINE))


def exception_of(result: Result, link: LinkState = LinkState.ONLINE) -> ExceptionCode | None:
    """Return the exception that tells a result; None where it is done. `link` is that of its drive.

    What was sent and failed is never told by a code that says that nothing was sent (01, 02, 03, 06): beside a raw
    stop that was carried out they tell of the words that were not sent.
    """
    if result.status is Status.DONE:
        return None
    if result.status is Status.FAILED and result.reason in BESIDE_A_STOP:
        return REFUSED[result.reason]
    if result.status is Status.REFUSED:
        is_line_down = link is LinkState.LINE_DOWN and result.reason is Reason.OFFLINE
        return REFUSED[Reason.LINE_DOWN if is_line_down else result.reason]
    if result.status is Status.UNKNOWN or result.reason in TARGET_LOST:
        return ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND
    return ExceptionCode.SERVER_DEVICE_FAILURE
