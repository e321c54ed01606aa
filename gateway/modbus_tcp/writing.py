"""Writes of MODBUS-TCP clients: a request becomes a command, its result the answer or the exception.

A drive's unit has the drive's own numbers (06H, 10H, 17H). Unit 255 has, for each drive, a few registers to command
it by, for masters that cannot know the drive's bits. Pure.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from enum import IntEnum

from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.door import Door
from gateway.control.drive_control import Standing
from gateway.image import Missing
from gateway.modbus_tcp.codes import CODE_FOR, ExceptionCode
from gateway.site import Drive

WRITE = 0x06
WRITE_WORDS = 0x10
EXCHANGE = 0x17
MOST_WRITTEN = 123  # words, MODBUS Application Protocol V1.1b3 6.12
MOST_EXCHANGED = 121  # 6.17
MOST_READ = 125

MIRROR_AT = 0x8000  # of unit 255
PER_DRIVE = 16
HUNDREDTH = Decimal("0.01")


class MirrorRegister(IntEnum):
    """The registers of one drive in the mirror; the first three are written, the others read."""

    COMMAND = 0
    HEARTBEAT = 1
    FREQUENCY = 2
    STANDING = 3
    OWNER = 4
    LEASE_LEFT = 5
    STATUS = 6
    REASON = 7


WRITTEN = (MirrorRegister.COMMAND, MirrorRegister.HEARTBEAT, MirrorRegister.FREQUENCY)
VERBS: Mapping[int, tuple[Verb, bool]] = {
    1: (Verb.TAKE, False),
    2: (Verb.ARM, False),
    3: (Verb.RELEASE, False),
    4: (Verb.STOP, False),
    5: (Verb.COAST, False),
    6: (Verb.EMERGENCY_STOP, False),
    7: (Verb.RESET, False),
    8: (Verb.RUN, False),
    9: (Verb.RUN, True),
}
STANDINGS = tuple(Standing)
STATUSES = tuple(Status)
REASONS = tuple(Reason)

EXCEPTIONS: Mapping[Reason, ExceptionCode] = {
    Reason.NOT_PERMITTED: ExceptionCode.ILLEGAL_FUNCTION,
    Reason.NOT_CONTROLLED: ExceptionCode.ILLEGAL_FUNCTION,
    Reason.NOT_IN_MODEL: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Reason.READ_ONLY: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Reason.FORBIDDEN: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Reason.STORED: ExceptionCode.ILLEGAL_DATA_ADDRESS,
    Reason.RANGE: ExceptionCode.ILLEGAL_DATA_VALUE,
    Reason.MALFORMED: ExceptionCode.ILLEGAL_DATA_VALUE,
    Reason.REFUSED_BY_DRIVE: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.NOT_READ_BACK: ExceptionCode.SERVER_DEVICE_FAILURE,
    Reason.NO_ANSWER: ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND,
    Reason.OFFLINE: ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND,
    Reason.LINE_DOWN: ExceptionCode.GATEWAY_PATH_UNAVAILABLE,
}
BUSY = ExceptionCode.SERVER_DEVICE_BUSY  # for all others: not owner, not armed, expired, superseded, left alone

Reply = Callable[[bytes | ExceptionCode], None]
Read = Callable[[int, int, float], bytes | Missing]


class Wrong(Exception):
    """A request that is not carried out."""

    def __init__(self, code: ExceptionCode) -> None:
        super().__init__(code.name)
        self.code = code


@dataclass(frozen=True, slots=True)
class WriteRequest:
    """What a write asks for: words from an address on; `read` are start and count of what 17H reads behind it."""

    function: int
    address: int
    words: tuple[int, ...]
    read: tuple[int, int] | None = None

    def answer(self) -> bytes:
        """Return the PDU of the answer, without what 17H reads."""
        value = self.words[0] if self.function == WRITE else len(self.words)
        return struct.pack(">BHH", self.function, self.address, value)


def parse(pdu: bytes) -> WriteRequest:
    """Read a request PDU; Wrong where lengths or counts contradict each other or the standard."""
    function, body = pdu[0], pdu[1:]
    try:
        if function == WRITE:
            address, word = struct.unpack(">HH", body)
            return WriteRequest(function, address, (word,))
        if function == WRITE_WORDS:
            address, count, size = struct.unpack_from(">HHB", body)
            return WriteRequest(function, address, _words(body[5:], count, size, MOST_WRITTEN))
        start, wanted, address, count, size = struct.unpack_from(">HHHHB", body)
    except struct.error:
        raise Wrong(ExceptionCode.ILLEGAL_DATA_VALUE) from None
    if not 1 <= wanted <= MOST_READ:
        raise Wrong(ExceptionCode.ILLEGAL_DATA_VALUE)
    words = _words(body[9:], count, size, MOST_EXCHANGED)
    return WriteRequest(function, address, words, (start, wanted))


def _words(data: bytes, count: int, size: int, most: int) -> tuple[int, ...]:
    if not 1 <= count <= most or size != 2 * count or len(data) != size:
        raise Wrong(ExceptionCode.ILLEGAL_DATA_VALUE)
    return struct.unpack(f">{count}H", data)


def exception_of(result: Result) -> ExceptionCode | None:
    """Return the exception that tells a result; None where it is done."""
    if result.status is Status.DONE:
        return None
    if result.status is Status.UNKNOWN:
        return ExceptionCode.GATEWAY_TARGET_FAILED_TO_RESPOND
    return EXCEPTIONS.get(result.reason, BUSY)


class DriveWriter:
    """Carries writes under a drive's own unit to the door."""

    def __init__(self, drive: Drive, door: Door, read: Read) -> None:
        self._drive = drive
        self._door = door
        self._read = read

    def write(self, pdu: bytes, source: Source, reply: Reply) -> None:
        """Take a request PDU; its answer comes when the drive has answered."""
        try:
            request = parse(pdu)
        except Wrong as wrong:
            reply(wrong.code)
            return
        control = self._door.controls.get(self._drive.name)
        if control is None:
            reply(ExceptionCode.ILLEGAL_FUNCTION)
            return
        now = self._door.clock.now()
        command = Command(
            self._drive.name,
            Verb.WORDS,
            source,
            now,
            now + control.settings.command_timeout,
            address=request.address,
            words=request.words,
        )
        self._door.submit(command, lambda result: reply(self._answer(request, result)))

    def _answer(self, request: WriteRequest, result: Result) -> bytes | ExceptionCode:
        code = exception_of(result)
        if code is not None:
            return code
        if request.read is None:
            return request.answer()
        start, count = request.read
        words = self._read(start, count, self._door.clock.now())
        if isinstance(words, Missing):
            return CODE_FOR[words]
        return bytes((EXCHANGE, 2 * count)) + words


class MirrorWriter:
    """The command mirror of unit 255: 16 registers a drive, in the order of the file."""

    def __init__(self, drives: tuple[Drive, ...], door: Door, read: Read) -> None:
        self._drives = drives
        self._door = door
        self._read = read
        self._last: dict[str, Result] = {}
        door.on_result(self._note)

    def _note(self, result: Result) -> None:
        self._last[result.command.drive] = result

    def write(self, pdu: bytes, source: Source, reply: Reply) -> None:
        """Take a request PDU: one drive's registers only, each of them one that can be written."""
        try:
            request = parse(pdu)
            drive, places = self._places(request)
            self._do(drive, dict(zip(places, request.words, strict=True)), source, request, reply)
        except Wrong as wrong:
            reply(wrong.code)

    def _places(self, request: WriteRequest) -> tuple[Drive, list[MirrorRegister]]:
        index, place = divmod(request.address - MIRROR_AT, PER_DRIVE)
        end = place + len(request.words)
        if request.read is not None or not 0 <= index < len(self._drives) or end > len(WRITTEN):
            raise Wrong(ExceptionCode.ILLEGAL_DATA_ADDRESS)
        return self._drives[index], [MirrorRegister(at) for at in range(place, end)]

    def _do(
        self,
        drive: Drive,
        words: Mapping[MirrorRegister, int],
        source: Source,
        request: WriteRequest,
        reply: Reply,
    ) -> None:
        """Heartbeat first, then the command with its frequency, as one command and one answer."""
        control = self._door.controls.get(drive.name)
        if control is None:
            raise Wrong(ExceptionCode.ILLEGAL_FUNCTION)
        frequency = words.get(MirrorRegister.FREQUENCY)
        hertz = None if frequency is None else frequency * HUNDREDTH
        code = words.get(MirrorRegister.COMMAND, 0)
        if code and code not in VERBS:
            raise Wrong(ExceptionCode.ILLEGAL_DATA_VALUE)
        if MirrorRegister.HEARTBEAT in words:
            self._door.beat(drive.name, source, words[MirrorRegister.HEARTBEAT])
        if not code and hertz is None:
            reply(request.answer())
            return
        verb, is_reverse = VERBS[code] if code else (Verb.FREQUENCY, False)
        now = self._door.clock.now()
        deadline = now + control.settings.command_timeout
        value = hertz if verb in (Verb.RUN, Verb.FREQUENCY) else None
        command = Command(drive.name, verb, source, now, deadline, is_reverse=is_reverse, value=value)
        self._door.submit(command, lambda result: reply(exception_of(result) or request.answer()))

    def read(self, start: int, count: int, now: float) -> bytes | Missing:
        """Return registers of the mirror, or of what stands besides under this unit."""
        if start < MIRROR_AT:
            return self._read(start, count, now)
        if start + count > MIRROR_AT + PER_DRIVE * len(self._drives):
            return self._read(start, count, now)
        first, last = (start - MIRROR_AT) // PER_DRIVE, (start + count - 1 - MIRROR_AT) // PER_DRIVE
        words = [word for drive in self._drives[first : last + 1] for word in self._of(drive, now)]
        skip = start - MIRROR_AT - PER_DRIVE * first
        return struct.pack(f">{count}H", *words[skip : skip + count])

    def _of(self, drive: Drive, now: float) -> list[int]:
        words = [0] * PER_DRIVE
        control = self._door.controls.get(drive.name)
        if control is None:
            return words
        lease = control.lease
        words[MirrorRegister.STANDING] = STANDINGS.index(control.standing) + 1
        if lease.is_held(now) and lease.owner is not None:
            words[MirrorRegister.OWNER] = list(Channel).index(lease.owner.channel) + 1
            words[MirrorRegister.LEASE_LEFT] = min(0xFFFF, int((lease.until - now) * 1000))
        last = self._last.get(drive.name)
        if last is not None:
            words[MirrorRegister.STATUS] = STATUSES.index(last.status) + 1
            words[MirrorRegister.REASON] = REASONS.index(last.reason)
        return words
