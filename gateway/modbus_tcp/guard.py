"""Keeps clients to their rights: what they may not do is answered 01, before anything is read or sent. Pure.

Who may write to a drive at all may stop it, whichever registers its rights name (SAFETY.md H04, H29): of a request
that it may not make, a stop is carried out, and nothing beside it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gateway.control.command import GATEWAY, Command, Reason, Result, Source, Status, Verb
from gateway.control.door import Door
from gateway.control.raw_stops import bare, raw_stop
from gateway.metrics import TcpStats
from gateway.modbus_tcp.codes import ExceptionCode
from gateway.modbus_tcp.mirror_map import LINE_ORDERS, MIRROR_AT, PER_DRIVE, Place
from gateway.modbus_tcp.requests import EXCHANGE, WRITE, WRITING, Malformed, WriteRequest, parse
from gateway.modbus_tcp.responder import FUNCTION_AT, READ, UNIT_AT, Identify, Responder, Unit
from gateway.modbus_tcp.rights import IDENTIFY, READ_HOLDING, READ_INPUT, Rights
from gateway.modbus_tcp.session import Reply, Writer

REFUSED = ExceptionCode.ILLEGAL_FUNCTION  # MODBUS/TCP Security Protocol Specification: what a role may not do is 01

Stop = tuple[int, int]
"""A register and the word in it that stops."""


def permits(rights: Rights, unit: int, pdu: bytes) -> bool:
    """Say whether a request may be made; one that is not exact may be, by who might make an exact one: it is 03."""
    function = pdu[0]
    if function in (READ_HOLDING, READ_INPUT):
        if len(pdu) != READ.size:
            return rights.touches(unit, (function, False))
        _, start, count = READ.unpack(pdu)
        return rights.permits(unit, (function, False), start, max(1, count))
    if function == IDENTIFY:
        return rights.touches(unit, (function, False))
    if function not in WRITING:
        return rights.knows(unit)  # it is 01 anyway, or 0AH where there is no such unit
    try:
        request = parse(pdu)
    except Malformed:
        return rights.touches(unit, (function, True))
    may_read = request.read is None or rights.permits(unit, (EXCHANGE, False), *request.read)
    return may_read and rights.permits(unit, (function, True), request.address, len(request.words))


class GuardedResponder(Responder):
    """Answers for the clients that have one and the same rights. What it has answered once it may answer again."""

    def __init__(self, units: Mapping[int, Unit], identify: Identify, stats: TcpStats, rights: Rights) -> None:
        super().__init__(units, identify, stats)
        self._rights = rights
        self._tcp = stats

    def answer(self, frame: bytes, now: float) -> bytes:
        """Answer a frame, from its protocol id on, or refuse it."""
        if not permits(self._rights, frame[UNIT_AT], frame[FUNCTION_AT:]):
            self._tcp.denied += 1
            return self.told(frame, REFUSED)
        return super().answer(frame, now)


@dataclass(frozen=True, slots=True)
class Ward:
    """The writes to one unit, and who carries them out.

    `stop_of` returns the stop in a request, `drive_of` to which drive it writes, `block_of` the registers of
    the drive that a register belongs to: first and last.
    """

    unit: int
    writer: Writer
    stop_of: Callable[[WriteRequest], Stop | None]
    drive_of: Callable[[WriteRequest], str | None]
    block_of: Callable[[int], tuple[int, int]]


class GuardedWriter:
    """Passes on what rights permit, and of the rest the stops of who may write to their drive."""

    def __init__(self, ward: Ward, rights: Rights, door: Door, stats: TcpStats) -> None:
        self._ward = ward
        self._rights = rights
        self._door = door
        self._stats = stats

    def write(self, pdu: bytes, source: Source, reply: Reply) -> float:
        """Begin a request; 01 where it may not be made."""
        ward = self._ward
        if permits(self._rights, ward.unit, pdu):
            return ward.writer.write(pdu, source, reply)
        try:
            request = parse(pdu)
        except Malformed:
            return self._refuse(None, source, reply)
        stop = ward.stop_of(request)
        if stop is None or not self._rights.writes_within(ward.unit, *ward.block_of(stop[0])):
            return self._refuse(request, source, reply)
        return self._stop(request, stop, source, reply)

    def _stop(self, request: WriteRequest, stop: Stop, source: Source, reply: Reply) -> float:
        """Carry out the stop in a request alone; it is answered as if the words beside it had not been there.

        Where 17H may not read what it wants to, it is answered 01 when the motor was stopped.
        """
        read, unit = request.read, self._ward.unit
        if read is not None and self._rights.permits(unit, (EXCHANGE, False), *read):
            alone = struct.pack(">BHHHHBH", EXCHANGE, *read, stop[0], 1, 2, stop[1])
            return self._ward.writer.write(alone, source, reply)

        def told(answer: bytes | ExceptionCode) -> None:
            if isinstance(answer, bytes):
                answer = request.answer() if read is None else REFUSED
            reply(answer)

        return self._ward.writer.write(struct.pack(">BHH", WRITE, *stop), source, told)

    def _refuse(self, request: WriteRequest | None, source: Source, reply: Reply) -> float:
        self._stats.denied += 1
        reply(REFUSED)
        drive = None if request is None else self._ward.drive_of(request)
        if request is not None and drive is not None:
            now, size = self._door.clock.now(), len(request.words)
            command = Command(drive, Verb.WORDS, source, now, now, address=request.address, words=request.words)
            text = f"{source} has no right to write {size} from {request.address:04X}H under unit {self._ward.unit}"
            self._door.tell_result(Result(command, Status.REFUSED, Reason.NOT_PERMITTED, text))
        return 0.0


def drive_ward(unit: int, writer: Writer, drive: str, door: Door) -> Ward:
    """Return the ward of a drive's own registers."""
    model = door.controls[drive].drive.model

    def stop_of(request: WriteRequest) -> Stop | None:
        asked = Command(drive, Verb.WORDS, GATEWAY, 0.0, 0.0, address=request.address, words=request.words)
        stop = raw_stop(asked, model)
        return None if stop is None else (stop.register.address, bare(stop).word)

    return Ward(unit, writer, stop_of, lambda _: drive, lambda _: (0, 0xFFFF))


def mirror_ward(unit: int, writer: Writer, drives: tuple[str, ...], door: Door) -> Ward:
    """Return the ward of the command mirror: a right to any register of a drive there is one to stop it."""

    def block_of(address: int) -> tuple[int, int]:
        first = address - (address - MIRROR_AT) % PER_DRIVE
        return first, first + PER_DRIVE - 1

    def drive_of(request: WriteRequest) -> str | None:
        index = (request.address - MIRROR_AT) // PER_DRIVE
        drive = drives[index] if 0 <= index < len(drives) else None
        return drive if drive in door.controls else None

    def stop_of(request: WriteRequest) -> Stop | None:
        place = (request.address - MIRROR_AT) % PER_DRIVE
        if drive_of(request) is None or place != Place.COMMAND or request.words[0] not in LINE_ORDERS:
            return None
        return request.address, request.words[0]

    return Ward(unit, writer, stop_of, drive_of, block_of)
