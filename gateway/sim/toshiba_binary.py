"""The TOSHIBA protocol in binary from the drive's side: a request frame to an answer frame, or silence.

Written from the manuals alone (E6581657 4, VF-MB1 RS485 4 and 6) and apart from the gateway's codec, so that the two
can judge each other.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from gateway.sim.memory import Denial, Denied
from gateway.sim.registers import Registers
from gateway.sim.toshiba import CODES, ERROR, READ, WRITE_RAM, WRITE_STORED, checksum, letter

START = b"/"
EVERY_DRIVE = 0xFF
HIGHEST_NUMBER = 0x3F
REPRESENTATIVE = 0  # answers for every drive (4.4)

READ_WITH_DUMMY = b"G"
EXCHANGE, EXCHANGED = b"X", b"Y"
PROPORTIONAL, PROPORTIONAL_OF_TRIPPED = b"S", b"s"
MOST_READ_GROUPS = 5
MOST_STATUS = 0x03  # the write status has bits for F870 and F871 only, for the display too (4.1.3, 7.3.1)
WORDS = {  # of data behind the command
    READ: 1,
    WRITE_STORED: 2,
    WRITE_RAM: 2,
    READ_WITH_DUMMY: 2,
    PROPORTIONAL: 2,
    PROPORTIONAL_OF_TRIPPED: 2,
}


@dataclass(frozen=True, slots=True)
class Request:
    """A frame taken apart: `number` is None where it was omitted, `data` is what is between command and checksum."""

    number: int | None
    command: bytes
    data: bytes
    is_sum_right: bool

    def word(self, place: int) -> int:
        """Return that word of the data."""
        return int.from_bytes(self.data[2 * place : 2 * place + 2], "big")


def is_whole(frame: bytes) -> bool:
    """Say whether a frame has the form of a request, and its checksum is right."""
    request = _request(frame)
    return request is not None and request.is_sum_right


def answer(frame: bytes, number: int, registers: Registers) -> bytes | None:
    """Do what a frame asks, and return the answer; None where the drive keeps silent.

    Silence: unknown command, wrong length, another number, FFH where the drive is not number 00, S (4.1.2, 4.2).
    """
    request = _request(frame)
    if request is None or not _is_for(request, number):
        return None
    if request.command in (PROPORTIONAL, PROPORTIONAL_OF_TRIPPED):
        _follow(request, registers)
        return None
    if request.command == EXCHANGE and request.data[0] > registers.most_groups:
        return None  # a format error (4.1.3)
    is_tripped = registers.is_tripped  # as the frame came: the emergency stop is answered in upper case (4.2)
    try:
        body = _act(request, registers)
    except Denied as denied:
        body = ERROR + _bytes(CODES[denied.denial])
    if not _answers(request, number):
        return None
    own = b"" if request.number is None else bytes([number])
    reply = START + own + letter(body[:1], is_tripped=is_tripped) + body[1:]
    return reply + bytes([checksum(reply)])


def _request(frame: bytes) -> Request | None:
    """Take a frame apart; None where it has no form of the manual's."""
    if not frame.startswith(START):
        return None
    is_numbered = len(frame) > 1 and (frame[1] <= HIGHEST_NUMBER or frame[1] == EVERY_DRIVE)
    body = frame[2:-1] if is_numbered else frame[1:-1]
    command, data = body[:1], body[1:]
    if len(data) != _size(command, data):
        return None
    return Request(frame[1] if is_numbered else None, command, data, checksum(frame[:-1]) == frame[-1])


def _size(command: bytes, data: bytes) -> int:
    """Return how many bytes of data a command has; -1 for one that there is not."""
    if command == EXCHANGE:
        return 2 + 2 * data[0] if data else -1
    return 2 * WORDS[command] if command in WORDS else -1


def _is_for(request: Request, number: int) -> bool:
    """Say whether the drive is meant; a request without a number is for whoever hears it."""
    if request.number is None:
        return True
    return number <= HIGHEST_NUMBER and request.number in (EVERY_DRIVE, number)


def _answers(request: Request, number: int) -> bool:
    return request.number != EVERY_DRIVE or number == REPRESENTATIVE


def _follow(request: Request, registers: Registers) -> None:
    """Do what the master of an inter-drive communication says; a refusal is not told either."""
    if request.is_sum_right and registers.has_proportional:
        is_master_tripped = request.command == PROPORTIONAL_OF_TRIPPED
        with suppress(Denied):
            registers.write_proportional(request.word(0), request.word(1), is_master_tripped=is_master_tripped)


def _act(request: Request, registers: Registers) -> bytes:
    """Do what is asked, and return the answer from its letter to its data."""
    if not request.is_sum_right:
        raise Denied(Denial.CHECKSUM)
    if request.command == EXCHANGE:
        return _exchange(request, registers)
    address = request.word(0)
    if request.command in (READ, READ_WITH_DUMMY):
        word = registers.read(address)
    else:
        word = request.word(1)
        write = registers.write_stored if request.command == WRITE_STORED else registers.write_ram
        write(address, word)
    return request.command + _bytes(address, word)


def _exchange(request: Request, registers: Registers) -> bytes:
    """Read as it stood, and write: a drive that is started answers that it stands (4.1.3)."""
    groups, wanted = request.data[0], request.data[1]
    count = wanted if wanted <= MOST_READ_GROUPS else 0
    words = registers.read_block(count)
    failed = registers.write_groups([request.word(1 + place) for place in range(groups)])
    status = sum(1 << place for place in failed) & MOST_STATUS
    return EXCHANGED + bytes([count, status]) + _bytes(*words)


def _bytes(*words: int) -> bytes:
    return b"".join(word.to_bytes(2, "big") for word in words)
