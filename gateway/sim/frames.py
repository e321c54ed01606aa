"""Which protocol a frame is of: MODBUS-RTU, or the mode of TOSHIBA that its start code says (E6581657 3, 4)."""

from __future__ import annotations

from gateway.sim import modbus, toshiba_ascii, toshiba_binary
from gateway.sim.options import MODBUS_RTU, TOSHIBA
from gateway.sim.registers import Registers
from gateway.sim.toshiba import checksum

STARTS = (toshiba_ascii.START, toshiba_binary.START)  # of TOSHIBA
STOP = b"\r"  # of TOSHIBA ASCII


def answer(protocol: int, frame: bytes, number: int, registers: Registers) -> bytes | None:
    """Let a drive that is set to that protocol (F829) do what a frame asks; None where it keeps silent."""
    if protocol == MODBUS_RTU:
        return modbus.answer(frame, number, registers)
    if frame.startswith(toshiba_ascii.START):
        return toshiba_ascii.answer(frame, number, registers)
    return toshiba_binary.answer(frame, number, registers)


def is_whole(frame: bytes) -> bool:
    """Say whether a frame is a request in one of the protocols, with nothing missing and the right check."""
    return modbus.is_whole(frame) or toshiba_ascii.is_whole(frame) or toshiba_binary.is_whole(frame)


def protocol_of(frame: bytes) -> int | None:
    """Return the protocol (F829) of a whole request or answer, by its check or stop code; None for others."""
    if modbus.is_whole(frame):
        return MODBUS_RTU
    is_ascii = frame.startswith(toshiba_ascii.START) and frame.endswith(STOP)
    is_binary = frame.startswith(toshiba_binary.START) and checksum(frame[:-1]) == frame[-1]
    return TOSHIBA if is_ascii or is_binary else None
