"""The exception codes of MODBUS-TCP answers."""

from __future__ import annotations

from enum import IntEnum

from gateway.image import Missing


class ExceptionCode(IntEnum):
    """MODBUS Application Protocol V1.1b3, 7, as far as this gateway uses them."""

    ILLEGAL_FUNCTION = 0x01
    ILLEGAL_DATA_ADDRESS = 0x02
    ILLEGAL_DATA_VALUE = 0x03
    SERVER_DEVICE_FAILURE = 0x04
    SERVER_DEVICE_BUSY = 0x06
    GATEWAY_PATH_UNAVAILABLE = 0x0A
    GATEWAY_TARGET_FAILED_TO_RESPOND = 0x0B


CODE_FOR = {
    Missing.UNMAPPED: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Missing.NOT_FRESH: ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND,
    Missing.LINE_DOWN: ExceptionCode.GATEWAY_PATH_UNAVAILABLE,
}
