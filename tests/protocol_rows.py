"""How the examples of docs/protocols.md come about: what is asked for, which drive hears it, what the answer says.

A row is named as on the page: A for TOSHIBA in ASCII, B for TOSHIBA in binary, M for MODBUS-RTU.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from gateway.errors import Refusal
from gateway.protocol.codec import Codec
from gateway.protocol.modbus_rtu import ModbusRtu
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Exchanged,
    Group,
    Identify,
    Identity,
    Proportional,
    ReadBlock,
    ReadWords,
    Request,
    Words,
    WriteBlock,
    WriteRam,
    WriteStored,
    Written,
)
from gateway.protocol.toshiba_ascii import ToshibaAscii
from gateway.protocol.toshiba_binary import ToshibaBinary
from tests.protocol.drive_side import Denied, Heard
from tests.sim.rig import Rig, binary, checked, framed

SELECTED = {f"block_read_{place}": place for place in range(1, 6)} | {"block_write_1": 1, "block_write_2": 3}
SHOWING = {"standard_monitor": 18, "led_selection": 1, "block_mode": 1}
RUN_60_HZ = (0xC400, 6000)
TEXT = (0x30, 0x31, 0x32, 0x33, 3)
FAULT_RESET = WriteRam(1, 0xFA00, 0xA000, is_answered=False)
X = Exchange(1, 0x1875, 5, 0x1870, RUN_60_HZ)
ERR5 = 0x18


@dataclass(frozen=True, slots=True)
class Case:
    """One example. `said` is None where nothing is answered, or where an answer is none to the request.

    `frame` is given where the gateway does not send it; `request` is then what it would have asked for.
    `drive` is None where no simulated drive can be brought to answer so.
    """

    codec: Codec
    request: Request
    said: Heard | None
    drive: Callable[[], Rig] | None
    frame: bytes | None = None


def plain(**options: Any) -> Rig:
    """Return a VF-nC3 at standstill that is set to TOSHIBA."""
    return Rig(**({"protocol": "toshiba"} | options))


def tripped(**options: Any) -> Rig:
    """Return one that has tripped with Err5."""
    rig = plain(**options)
    rig.drive.inverter.trip(ERR5)
    return rig


def forced(name: str, word: int, **options: Any) -> Rig:
    """Return a drive with a register that reads that word."""
    rig = Rig(**options)
    rig.drive.force(name, word)
    return rig


running = partial(plain, running_at=60.0)
selected = partial(plain, presets=SELECTED)
protected = partial(plain, presets={"write_protection": 2})
secret = partial(plain, presets={"password": 1234})
modbus = partial(Rig, presets=SELECTED)

ASCII, BARE = ToshibaAscii(), ToshibaAscii(has_checksum=False, has_stop=False)
BINARY, BY_G = ToshibaBinary(), ToshibaBinary(reads_by_g=True)
RTU, BY_10H = ModbusRtu(), ModbusRtu(writes_by_10h=True)

FREQUENCY = ReadWords(1, 0xFD00)
SET_60_HZ = WriteRam(1, 0xFA01, 6000)
ABSENT, MONITOR = ReadWords(1, 0x0131), WriteRam(1, 0xFD00, 0)
STANDSTILL = WriteStored(1, 0x0000, 1)
NOTES, PASSWORD = WriteStored(1, 0x0880, 1), WriteStored(1, 0x0738, 0)
UNABLE, BEYOND, NOWHERE, UNKNOWN, DAMAGED = (
    Denied(reason, False)
    for reason in (Refusal.UNABLE, Refusal.RANGE, Refusal.ADDRESS, Refusal.COMMAND, Refusal.CHECKSUM)
)
DONE, DONE_TRIPPED = Written((), False), Written((), True)
SIXTY, STOPPED = Words((6000,), False), Words((ERR5,), True)
TRIP_CODE = ReadWords(1, 0xFC90)
TOO_FAST = WriteRam(1, 0xFA01, 8001)


def of_group(request: WriteRam, group: Group) -> WriteRam:
    """Return a write for a group."""
    return replace(request, number=group)


ASCII_CASES = {
    "A1": Case(ASCII, FREQUENCY, SIXTY, running),
    "A2": Case(ASCII, WriteStored(1, 0x0010, 100), DONE, plain),
    "A3": Case(ASCII, SET_60_HZ, DONE, plain),
    "A4": Case(ASCII, ReadWords(None, 0xFD00), SIXTY, running),
    "A5": Case(BARE, FREQUENCY, SIXTY, running),
    "A6": Case(ASCII, WriteStored(1, 0x0803, 0), DONE, plain, checked("01W08030")),
    "A7": Case(ASCII, TRIP_CODE, STOPPED, tripped),
    "A8": Case(ASCII, WriteStored(1, 0x0010, 100), DONE_TRIPPED, tripped),
    "A9": Case(ASCII, SET_60_HZ, DONE_TRIPPED, tripped),
    "A10": Case(ASCII, of_group(SET_60_HZ, EVERY_DRIVE), DONE, partial(plain, number=0)),
    "A11": Case(ASCII, of_group(SET_60_HZ, Group(None, 9)), DONE, partial(plain, number=9)),
    "A12": Case(ASCII, of_group(SET_60_HZ, Group(2, None)), DONE, partial(plain, number=20)),
    "A13": Case(ASCII, of_group(SET_60_HZ, EVERY_DRIVE), None, partial(plain, number=5)),
    "A14": Case(ASCII, ReadWords(Group(None, 2), 0xFD00), SIXTY, partial(running, number=2)),
    "A15": Case(ASCII, STANDSTILL, UNABLE, running),
    "A16": Case(ASCII, NOTES, UNABLE, protected),
    "A17": Case(ASCII, ReadWords(1, 0x0880), UNABLE, partial(plain, model="vf-mb1", presets={"write_protection": 4})),
    "A18": Case(ASCII, PASSWORD, UNABLE, secret),
    "A19": Case(ASCII, NOTES, UNABLE, None),
    "A20": Case(ASCII, TOO_FAST, BEYOND, plain),
    "A21": Case(ASCII, WriteRam(1, 0x0880, 0x64), BEYOND, plain, checked("01P088000064")),
    "A22": Case(ASCII, ABSENT, NOWHERE, plain),
    "A23": Case(ASCII, MONITOR, NOWHERE, plain),
    "A24": Case(ASCII, FREQUENCY, UNKNOWN, plain, checked("01GFD00")),
    "A25": Case(ASCII, FREQUENCY, DAMAGED, plain, b"(01RFD00&00)\r"),
    "A26": Case(ASCII, ABSENT, Denied(Refusal.ADDRESS, True), tripped),
    "A27": Case(ASCII, ReadWords(2, 0xFD00), None, plain),
    "A28": Case(ASCII, FREQUENCY, None, plain, checked("1RFD00")),
    "A29": Case(ASCII, ReadWords(None, 0x0011), None, plain, b"(R11)\r"),
    "A30": Case(ASCII, FREQUENCY, None, plain, b"(01RFD00]\r"),
    "A31": Case(ASCII, FREQUENCY, None, plain, b"(01RFD00&EB)"),
    "A32": Case(ASCII, FAULT_RESET, None, tripped),
    "A33": Case(ASCII, ReadWords(99, 0xFD00), SIXTY, partial(running, number=99)),
    "A34": Case(ASCII, ReadWords(100, 0xFD00), None, partial(plain, number=100), checked("100RFD00")),
}

BINARY_CASES = {
    "B1": Case(BINARY, FREQUENCY, SIXTY, running),
    "B2": Case(BY_G, FREQUENCY, SIXTY, running),
    "B3": Case(BINARY, WriteStored(1, 0x0010, 100), DONE, plain),
    "B4": Case(BINARY, SET_60_HZ, DONE, plain),
    "B5": Case(BINARY, X, Exchanged((0x4000, 0, 0, 0, 0), (), False), selected),
    "B6": Case(BINARY, ReadBlock(1, 0, 2), Words((0x6400, 6000), False), partial(selected, running_at=60.0)),
    "B7": Case(BINARY, WriteBlock(1, 0, RUN_60_HZ), DONE, selected),
    "B8": Case(BINARY, WriteBlock(1, 0, RUN_60_HZ[:1]), DONE, selected),
    "B9": Case(BINARY, X, Exchanged((0,) * 5, (0, 1), False), plain),
    "B10": Case(BINARY, WriteBlock(1, 0, (0x8400, 0xFFFF)), Written((1,), False), selected),
    "B11": Case(BINARY, ReadBlock(1, 0, 2), Words((0, 6000), False), partial(running, presets={"block_read_2": 2})),
    "B12": Case(
        BINARY,
        Exchange(1, 0, 5, 0, TEXT),
        Exchanged((0x64, 0x41, 0x74, 0x41, 0), (), False),
        partial(plain, presets=SHOWING),
    ),
    "B13": Case(BINARY, ReadWords(None, 0xFD00), SIXTY, running),
    "B14": Case(BINARY, Proportional(None, 0xFA01, 5000), None, partial(plain, model="vf-mb1")),
    "B15": Case(BINARY, Proportional(None, 0xFA01, 0, True), None, partial(plain, model="vf-mb1")),
    "B16": Case(BINARY, Proportional(1, 0xFA01, 5000), None, partial(plain, model="vf-mb1")),
    "B17": Case(BINARY, TRIP_CODE, STOPPED, tripped),
    "B18": Case(BY_G, TRIP_CODE, STOPPED, tripped),
    "B19": Case(BINARY, WriteStored(1, 0x0010, 100), DONE_TRIPPED, tripped),
    "B20": Case(BINARY, SET_60_HZ, DONE_TRIPPED, tripped),
    "B21": Case(BINARY, ReadBlock(1, 0, 1), Words((0x0003,), True), partial(tripped, presets=SELECTED)),
    "B22": Case(BINARY, of_group(SET_60_HZ, EVERY_DRIVE), DONE, partial(plain, number=0)),
    "B23": Case(BINARY, of_group(SET_60_HZ, EVERY_DRIVE), None, partial(plain, number=5)),
    "B24": Case(BINARY, ReadWords(EVERY_DRIVE, 0xFD00), SIXTY, partial(running, number=0)),
    "B25": Case(BINARY, WriteBlock(EVERY_DRIVE, 0, RUN_60_HZ), DONE, partial(selected, number=0)),
    "B26": Case(BINARY, STANDSTILL, UNABLE, running),
    "B27": Case(BINARY, NOTES, UNABLE, protected),
    "B28": Case(BINARY, PASSWORD, UNABLE, secret),
    "B29": Case(BINARY, NOTES, UNABLE, None),
    "B30": Case(BINARY, TOO_FAST, BEYOND, plain),
    "B31": Case(BINARY, ABSENT, NOWHERE, plain),
    "B32": Case(BINARY, MONITOR, NOWHERE, plain),
    "B33": Case(BINARY, FREQUENCY, DAMAGED, plain, bytes.fromhex("2F 01 52 FD 00 00")),
    "B34": Case(BINARY, X, DAMAGED, selected, bytes.fromhex("2F 01 58 02 05 C4 00 17 70 D9")),
    "B35": Case(BINARY, ABSENT, Denied(Refusal.ADDRESS, True), tripped),
    "B36": Case(BINARY, FREQUENCY, None, plain, binary("01 4C FD 00")),
    "B37": Case(BINARY, WriteBlock(1, 0, (1, 2)), None, selected, binary("01 58 03 00 0001 0002 0003")),
    "B38": Case(BINARY, ReadBlock(1, 0, 5), None, selected, binary("01 58 00 06")),
    "B39": Case(BINARY, FREQUENCY, None, plain, binary("01 52 FD 00 00")),
    "B40": Case(BINARY, X, None, selected, bytes.fromhex("2F 01 58 02 05 C4 00")),
    "B41": Case(BINARY, ReadWords(2, 0xFD00), None, plain),
    "B42": Case(
        BINARY,
        Proportional(None, 0xFA01, 5000),
        None,
        partial(plain, model="vf-mb1"),
        bytes.fromhex("2F 53 FA 01 13 88 00"),
    ),
    "B43": Case(BINARY, Proportional(None, 0xFA00, 5000), None, partial(plain, model="vf-mb1")),
    "B44": Case(BINARY, FAULT_RESET, None, tripped),
    "B45": Case(BINARY, ReadWords(0x3F, 0xFD00), SIXTY, partial(running, number=0x3F)),
    "B46": Case(BINARY, ReadWords(0x40, 0xFD00), None, partial(plain, number=0x40), binary("40 52 FD 00")),
}

WORD_60 = Words((6000,))
RTU_UNABLE, RTU_BEYOND, RTU_NOWHERE, RTU_UNKNOWN = (
    Denied(reason, None) for reason in (Refusal.UNABLE, Refusal.RANGE, Refusal.ADDRESS, Refusal.COMMAND)
)
IDENTITY = Identity("TOSHIBA", "VFnC3-2007P", "0100")
capacity = partial(Rig, capacity="VFnC3-2007P")

MODBUS_CASES = {
    "M1": Case(RTU, FREQUENCY, WORD_60, partial(Rig, running_at=60.0)),
    "M2": Case(RTU, ReadWords(1, 0x0875, 5), Words((1, 2, 3, 4, 5)), modbus),
    "M3": Case(RTU, ReadWords(1, 0x0805, 4), Words((0, 0x8000, 0x8000, 1)), Rig),
    "M4": Case(RTU, ReadBlock(1, 0x1875, 2), Words((0x6400, 6000)), partial(modbus, running_at=60.0)),
    "M5": Case(
        RTU, ReadBlock(1, 0x1875, 2), Words((0, 6000)), partial(Rig, running_at=60.0, presets={"block_read_2": 2})
    ),
    "M6": Case(RTU, SET_60_HZ, Written(), Rig),
    "M7": Case(BY_10H, SET_60_HZ, Written(), Rig),
    "M8": Case(RTU, WriteBlock(1, 0x1870, RUN_60_HZ), Written(), modbus),
    "M9": Case(RTU, replace(X, count=2), Exchanged((0x4000, 0)), modbus),
    "M10": Case(RTU, Identify(1, 0), IDENTITY, capacity),
    "M11": Case(RTU, Identify(1, 1), IDENTITY, capacity),
    "M12": Case(RTU, Identify(1, 2), IDENTITY, capacity),
    "M13": Case(RTU, Identify(1, 3), IDENTITY, capacity),
    "M14": Case(
        RTU,
        Exchange(1, 0x1875, 2, 0x1870, TEXT[:2]),
        Exchanged((0x64, 0x41)),
        partial(Rig, presets=SELECTED | SHOWING),
    ),
    "M15": Case(RTU, of_group(SET_60_HZ, EVERY_DRIVE), None, Rig),
    "M16": Case(BY_10H, of_group(SET_60_HZ, EVERY_DRIVE), None, Rig),
    "M17": Case(RTU, WriteBlock(EVERY_DRIVE, 0x1870, RUN_60_HZ), None, modbus),
    "M18": Case(RTU, ReadWords(EVERY_DRIVE, 0xFD00), None, Rig, framed("03 FD00 0001", 0)),
    "M19": Case(RTU, FREQUENCY, None, Rig, framed("04 FD00 0001")),
    "M20": Case(RTU, Identify(1), RTU_UNKNOWN, Rig, framed("2B 0D 01 00")),
    "M21": Case(RTU, ABSENT, RTU_NOWHERE, Rig),
    "M22": Case(RTU, ReadWords(1, 0x0131, 2), RTU_NOWHERE, Rig),
    "M23": Case(RTU, WriteStored(1, 0xFFFF, 0), RTU_NOWHERE, Rig),
    "M24": Case(RTU, MONITOR, RTU_NOWHERE, Rig),
    "M25": Case(RTU, ReadWords(1, 0xFD00, 2), RTU_BEYOND, Rig),
    "M26": Case(RTU, ReadWords(1, 0x0800, 8), RTU_BEYOND, Rig, framed("03 0800 0009")),
    "M27": Case(RTU, ReadBlock(1, 0x1875, 5), RTU_BEYOND, modbus, framed("03 1875 0006")),
    "M28": Case(RTU, ReadBlock(1, 0x1876, 2), RTU_BEYOND, modbus),
    "M29": Case(RTU, TOO_FAST, RTU_BEYOND, Rig),
    "M30": Case(RTU, WriteBlock(1, 0x1870, RUN_60_HZ), RTU_BEYOND, modbus, framed("10 1870 0003 04 C400 1770")),
    "M31": Case(RTU, WriteBlock(1, 0x1871, RUN_60_HZ), RTU_BEYOND, modbus),
    "M32": Case(RTU, WriteBlock(1, 0x1870, (0xC400, 0xFFFF)), RTU_BEYOND, modbus),
    "M33": Case(RTU, X, RTU_BEYOND, modbus, framed("17 1875 0006 1870 0002 04 C400 1770")),
    "M34": Case(RTU, Identify(1), RTU_BEYOND, Rig, framed("2B 0E 04 00")),
    "M35": Case(RTU, STANDSTILL, RTU_UNABLE, partial(Rig, running_at=60.0)),
    "M36": Case(RTU, NOTES, RTU_UNABLE, partial(Rig, presets={"write_protection": 2})),
    "M37": Case(RTU, PASSWORD, RTU_UNABLE, partial(Rig, presets={"password": 1234})),
    "M38": Case(RTU, NOTES, RTU_UNABLE, None),
    "M39": Case(RTU, WriteBlock(1, 0x1870, RUN_60_HZ), RTU_UNABLE, Rig),
    "M40": Case(RTU, X, RTU_UNABLE, Rig),
    "M41": Case(RTU, ReadWords(2, 0xFD00), None, Rig),
    "M42": Case(RTU, FREQUENCY, None, Rig, bytes.fromhex("01 03 FD 00 00 01 B5 A7")),
    "M43": Case(RTU, FREQUENCY, None, Rig, framed("03 FD00 00")),
    "M44": Case(RTU, ReadWords(248, 0xFD00), None, partial(Rig, number=248), framed("03 FD00 0001", 248)),
    "M45": Case(RTU, FAULT_RESET, None, partial(tripped, protocol="modbus-rtu")),
    "M46": Case(RTU, FREQUENCY, None, plain),
    "M47": Case(RTU, ReadWords(247, 0xFD00), WORD_60, partial(Rig, number=247, running_at=60.0)),
}

CASES = ASCII_CASES | BINARY_CASES | MODBUS_CASES
