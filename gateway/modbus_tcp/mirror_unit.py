"""Unit 255 of a gateway whose drives may be commanded: mirror, stops of whole lines, and all else that it shows."""

from __future__ import annotations

import ipaddress
import struct
from collections.abc import Mapping
from functools import partial

from gateway.control.command import Result, Source
from gateway.control.door import Door
from gateway.image import Image, LinkState, Missing, Reading
from gateway.modbus_tcp.codes import CODE_FOR, ExceptionCode, Wrong, exception_of
from gateway.modbus_tcp.gateway_unit import NO_VALUE, REGISTERS_PER_DRIVE, VALUES, VALUES_AT, GatewayUnit
from gateway.modbus_tcp.hosts import host_of_source
from gateway.modbus_tcp.line_stops import LineStops, Tell
from gateway.modbus_tcp.mirror_commands import MirrorCommands
from gateway.modbus_tcp.mirror_map import (
    LINE_ORDERS,
    LINES_AT,
    MIRROR_AT,
    NOTHING,
    OWNERS,
    PER_DRIVE,
    STANDINGS,
    Place,
)
from gateway.modbus_tcp.requests import Malformed, WriteRequest, parse
from gateway.modbus_tcp.session import Reply
from gateway.modbus_tcp.writing import ANSWER_AT_MOST, patience

SHOWN = {  # places that show a value of the compact map
    Place.DRIVE_STATUS: VALUES_AT + VALUES.index("status"),
    Place.OUTPUT_FREQUENCY: VALUES_AT + VALUES.index("output_frequency"),
    Place.TRIP_CODE: VALUES_AT + VALUES.index("trip_code"),
}


class MirrorUnit:
    """Reads and writes of unit 255; drives and lines are in the order of the file, as in the compact map."""

    link = LinkState.ONLINE

    def __init__(self, image: Image, door: Door, gateway_unit: GatewayUnit) -> None:
        self.identity = gateway_unit.identity
        self._image = image
        self._drives = tuple(image.by_name)
        self._door = door
        self._gateway_unit = gateway_unit
        self._commands = MirrorCommands(door)
        self._stops = LineStops(door)

    def write(self, pdu: bytes, source: Source, reply: Reply) -> float:
        """Begin a request: registers of one drive, or of lines; its answer comes when the drives have answered."""
        try:
            request = parse(pdu)
            if request.read is not None and self.read(*request.read, self._door.clock.now()) is Missing.UNMAPPED:
                raise Wrong(ExceptionCode.ILLEGAL_DATA_ADDRESS)
            return self._begin(request, source, reply)
        except Malformed:
            reply(ExceptionCode.ILLEGAL_DATA_VALUE)
        except Wrong as wrong:
            reply(wrong.code)
        return 0.0

    def _begin(self, request: WriteRequest, source: Source, reply: Reply) -> float:
        def tell(result: Result | None) -> None:
            code = None if result is None else exception_of(result, self._link(result.command.drive))
            reply(self._answer(request, source) if code is None else code)

        first = request.address - LINES_AT
        if first >= 0 and first + len(request.words) <= len(self._stops.lines):
            self._stop_lines(self._stops.lines[first : first + len(request.words)], request, source, tell)
            return ANSWER_AT_MOST
        index, words = self._of_one_drive(request)
        drive = self._drives[index]
        if _reads_result(request, index):
            self._commands.write_and_show(drive, words, source)
            tell(None)
        else:
            self._commands.write(drive, words, source, tell)
        return patience(self._door.controls[drive].settings)

    def _answer(self, request: WriteRequest, source: Source) -> bytes | ExceptionCode:
        if request.read is None:
            return request.answer()
        words = self._read(*request.read, self._door.clock.now(), source)
        return CODE_FOR[words] if isinstance(words, Missing) else request.answer(words)

    def _link(self, drive: str) -> LinkState:
        return self._image.by_name[drive].link if drive in self._image.by_name else LinkState.ONLINE

    def _stop_lines(self, lines: tuple[str, ...], request: WriteRequest, source: Source, tell: Tell) -> None:
        if not all(self._stops.drives(line) for line in lines):
            raise Wrong(ExceptionCode.ILLEGAL_FUNCTION)
        if any(word not in (NOTHING, *LINE_ORDERS) for word in request.words):
            raise Wrong(ExceptionCode.ILLEGAL_DATA_VALUE)
        self._stops.write(lines, request.words, source, tell)

    def _of_one_drive(self, request: WriteRequest) -> tuple[int, dict[Place, int]]:
        index, first = divmod(request.address - MIRROR_AT, PER_DRIVE)
        is_inside = 0 <= index < len(self._drives) and first + len(request.words) <= PER_DRIVE
        if not is_inside or not Place(first + len(request.words) - 1).is_written:
            raise Wrong(ExceptionCode.ILLEGAL_DATA_ADDRESS)
        return index, {Place(first + i): word for i, word in enumerate(request.words)}

    def reading(self, start: int, count: int) -> Reading:
        """Return what reads these registers again and again."""
        return partial(self.read, start, count) if start >= MIRROR_AT else self._gateway_unit.reading(start, count)

    def read(self, start: int, count: int, now: float) -> bytes | Missing:
        """Return registers of the mirror, of the lines, or of what stands besides under this unit."""
        return self._read(start, count, now)

    def _read(self, start: int, count: int, now: float, reader: Source | None = None) -> bytes | Missing:
        end = start + count
        if start >= MIRROR_AT and end <= MIRROR_AT + PER_DRIVE * len(self._drives):
            first, last = (start - MIRROR_AT) // PER_DRIVE, (end - 1 - MIRROR_AT) // PER_DRIVE
            words = [word for index in range(first, last + 1) for word in self._words_of(index, now, reader)]
            skip = start - MIRROR_AT - PER_DRIVE * first
            return struct.pack(f">{count}H", *words[skip : skip + count])
        if start >= LINES_AT and end <= LINES_AT + len(self._stops.lines):
            lines = self._stops.lines[start - LINES_AT : end - LINES_AT]
            return struct.pack(f">{count}H", *map(self._stops.word, lines))
        return self._gateway_unit.read(start, count, now)

    def _words_of(self, index: int, now: float, reader: Source | None) -> list[int]:
        drive = self._drives[index]
        words = dict.fromkeys(Place, 0)
        if drive in self._door.controls:
            words |= self._commands.words(drive, reader, now)
            words |= self._of_control(drive, now)
        words |= self._of_drive(index, now)
        return [words[place] for place in Place]

    def _of_control(self, drive: str, now: float) -> Mapping[Place, int]:
        """Return who may command the drive, and whether it may be set in motion."""
        control = self._door.controls[drive]
        words = {Place.STANDING: STANDINGS[control.standing]}
        owner, left = control.lease.owner, control.lease.until - now
        if owner is not None and control.lease.is_held(now):
            high, low = _address(owner)
            words |= {Place.OWNER: OWNERS[owner.channel], Place.LEASE_LEFT: min(0xFFFF, int(left * 1000))}
            words |= {Place.OWNER_HIGH: high, Place.OWNER_LOW: low}
        return words

    def _of_drive(self, index: int, now: float) -> Mapping[Place, int]:
        block = self._gateway_unit.read(REGISTERS_PER_DRIVE * index, REGISTERS_PER_DRIVE, now)
        if isinstance(block, Missing):
            return dict.fromkeys(SHOWN, NO_VALUE)
        return {place: int.from_bytes(block[2 * at : 2 * at + 2], "big") for place, at in SHOWN.items()}


def _reads_result(request: WriteRequest, index: int) -> bool:
    """Say whether 17H reads the result register of the drive that it writes to: no exception is needed then."""
    result = MIRROR_AT + PER_DRIVE * index + Place.RESULT
    return request.read is not None and request.read[0] <= result < sum(request.read)


def _address(owner: Source) -> tuple[int, int]:
    """Return an IPv4 address as two words; zeros for all others."""
    try:
        return divmod(int(ipaddress.IPv4Address(host_of_source(owner.name))), 0x10000)
    except ValueError:
        return 0, 0
