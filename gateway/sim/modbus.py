"""MODBUS-RTU from the drive's side: a request frame to an answer frame, or silence (E6581657 5).

Written from the manual alone and apart from the gateway's codec, so that the two can judge each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from gateway.drives.model import BlockForms
from gateway.sim.memory import Denial, Denied
from gateway.sim.registers import Registers

BROADCAST = 0
LONGEST_NUMBER = 247
SHORTEST = 4  # bytes: number, function, CRC

READ = 0x03
WRITE = 0x06
WRITE_WORDS = 0x10
EXCHANGE = 0x17
IDENTIFY = 0x2B
ERROR = 0x80

DEVICE_ID = 0x0E  # the only MEI type
READ_CODES = range(4)
CONFORMITY = 0x01
MAKER = "TOSHIBA"

CODES = {Denial.COMMAND: 1, Denial.NUMBER: 2, Denial.RANGE: 3, Denial.UNABLE: 4}  # 5.3

BLOCK_READ_NUMBERS = 5  # 1875H-1879H stand for F875-F879, 1870H-1871H for F870-F871
BLOCK_WRITE_NUMBERS = 2


def _shifted(byte: int) -> int:
    register = byte
    for _ in range(8):
        register = register >> 1 ^ 0xA001 if register & 1 else register >> 1
    return register


SHIFTED = tuple(_shifted(byte) for byte in range(256))  # eight shifts of the CRC register at once


def crc(data: bytes) -> bytes:
    """Return the check of a frame as it stands on the wire, low byte first (5.2)."""
    register = 0xFFFF
    for byte in data:
        register = register >> 8 ^ SHIFTED[(register ^ byte) & 0xFF]
    return register.to_bytes(2, "little")


def is_whole(frame: bytes) -> bool:
    """Say whether a frame's CRC is right."""
    return len(frame) >= SHORTEST and crc(frame[:-2]) == frame[-2:]


def answer(frame: bytes, number: int, registers: Registers) -> bytes | None:
    """Do what a frame asks, and return the answer; None where the drive keeps silent.

    Silence: wrong CRC, wrong length, another number, a broadcast (5, 5.1).
    """
    if not is_whole(frame) or frame[0] > LONGEST_NUMBER or frame[0] not in (BROADCAST, number):
        return None
    function, body = frame[1], frame[2:-2]
    form = FORMS.get(function)
    try:
        if form is None:
            raise Denied(Denial.COMMAND)
        length, act = form
        if len(body) != length(body):
            return None
        reply = bytes([function]) + act(body, registers)
    except Denied as denied:
        reply = bytes([function | ERROR, CODES[denied.denial]])
    if frame[0] == BROADCAST:
        return None
    reply = bytes([frame[0]]) + reply
    return reply + crc(reply)


def _read(body: bytes, registers: Registers) -> bytes:
    first, count = _word(body, 0), _word(body, 2)
    blocks = registers.blocks
    if _is_block(first, blocks.indirect_read_address, BLOCK_READ_NUMBERS):
        _check_block_read(first, count, blocks)
        words = registers.read_block(count)
    elif count == 1:
        words = [registers.read(first)]
    elif 2 <= count <= blocks.direct_read_maximum:
        words = registers.read_direct(first, count)
    else:
        raise Denied(Denial.RANGE)
    return _counted(words)


def _write(body: bytes, registers: Registers) -> bytes:
    registers.write_stored(_word(body, 0), _word(body, 2))
    return body


def _write_words(body: bytes, registers: Registers) -> bytes:
    first, count = _word(body, 0), _word(body, 2)
    words = _words(body[5:])
    if count != len(words) or body[4] != 2 * count:
        raise Denied(Denial.RANGE)
    blocks = registers.blocks
    if _is_block(first, blocks.indirect_write_address, BLOCK_WRITE_NUMBERS):
        if first != blocks.indirect_write_address or count != blocks.indirect_write_words:
            raise Denied(Denial.RANGE)
        registers.write_block(words)
    elif count == 1:
        registers.write_stored(first, words[0])
    else:
        raise Denied(Denial.RANGE)
    return body[:4]


def _exchange(body: bytes, registers: Registers) -> bytes:
    """Read as it stood and write: the manual's Y answers to a start show the motor standing (4.1.3)."""
    blocks = registers.blocks
    if not blocks.has_exchange:
        raise Denied(Denial.COMMAND)
    _check_block_read(_word(body, 0), _word(body, 2), blocks)
    words = _words(body[9:])
    if _word(body, 4) != blocks.indirect_write_address or not (
        _word(body, 6) == len(words) == blocks.indirect_write_words and body[8] == 2 * len(words)
    ):
        raise Denied(Denial.RANGE)
    values = registers.read_block(_word(body, 2))
    registers.write_block(words)
    return _counted(values)


def _identify(body: bytes, registers: Registers) -> bytes:
    if body[0] != DEVICE_ID:
        raise Denied(Denial.COMMAND)
    if body[1] not in READ_CODES or body[2] != 0:
        raise Denied(Denial.RANGE)
    objects = (MAKER, *registers.identity())
    head = bytes([DEVICE_ID, body[1], CONFORMITY, 0, 0, len(objects)])
    return head + b"".join(
        bytes([number, len(text)]) + text.encode("ascii") for number, text in enumerate(objects)
    )


def _is_block(address: int, start: int, numbers: int) -> bool:
    """Say whether a number stands for a block selector; one behind the first is a data error (5.1.2, 5.1.5)."""
    return start != 0 and start <= address < start + numbers


def _check_block_read(first: int, count: int, blocks: BlockForms) -> None:
    is_count_right = blocks.indirect_read_minimum <= count <= blocks.indirect_read_maximum
    if first != blocks.indirect_read_address or not is_count_right:
        raise Denied(Denial.RANGE)


def _word(body: bytes, at: int) -> int:
    return int.from_bytes(body[at : at + 2], "big")


def _words(data: bytes) -> list[int]:
    if len(data) % 2:
        raise Denied(Denial.RANGE)
    return [_word(data, at) for at in range(0, len(data), 2)]


def _counted(words: Sequence[int]) -> bytes:
    return bytes([2 * len(words)]) + b"".join(word.to_bytes(2, "big") for word in words)


def _fixed(length: int) -> Callable[[bytes], int]:
    return lambda _body: length


def _with_count_at(position: int) -> Callable[[bytes], int]:
    """Return a rule for a body that ends with data counted in the byte at that position."""
    return lambda body: position + 1 + body[position] if len(body) > position else -1


FORMS: dict[int, tuple[Callable[[bytes], int], Callable[[bytes, Registers], bytes]]] = {
    READ: (_fixed(4), _read),
    WRITE: (_fixed(4), _write),
    WRITE_WORDS: (_with_count_at(4), _write_words),
    EXCHANGE: (_with_count_at(8), _exchange),
    IDENTIFY: (_fixed(3), _identify),
}
