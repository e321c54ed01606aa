"""Requests that write, read from their bytes."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.pdu.register_message import (
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from gateway.modbus_tcp.requests import Malformed, WriteRequest, parse

WORDS = st.integers(0, 0xFFFF)


def several(address: int, words: list[int], count: int | None = None, size: int | None = None) -> bytes:
    """Make the PDU of 10H; `count` and `size` where they are to be wrong."""
    count = len(words) if count is None else count
    size = 2 * len(words) if size is None else size
    return struct.pack(f">BHHB{len(words)}H", 0x10, address, count, size & 0xFF, *words)


def exchange(start: int, wanted: int, address: int, words: list[int], size: int | None = None) -> bytes:
    """Make the PDU of 17H."""
    size = 2 * len(words) if size is None else size
    return struct.pack(f">BHHHHB{len(words)}H", 0x17, start, wanted, address, len(words), size & 0xFF, *words)


GOOD = [
    (bytes.fromhex("06FA01 0BB8"), WriteRequest(6, 0xFA01, (3000,)), bytes.fromhex("06FA010BB8")),
    (several(0xFA00, [0xC400, 3000]), WriteRequest(16, 0xFA00, (0xC400, 3000)), bytes.fromhex("10FA000002")),
    (several(0, [0] * 123), WriteRequest(16, 0, (0,) * 123), bytes.fromhex("100000007B")),
    (
        exchange(0xFD00, 2, 0xFA01, [3000]),
        WriteRequest(23, 0xFA01, (3000,), (0xFD00, 2)),
        b"\x17\x04\x17\x70\x00\x03",
    ),
    (exchange(0, 125, 0, [0] * 121), WriteRequest(23, 0, (0,) * 121, (0, 125)), b"\x17\x04\x17\x70\x00\x03"),
]


@pytest.mark.parametrize(("pdu", "meant", "answer"), GOOD)
def test_a_request_is_read_and_answered_as_the_standard_says(pdu: bytes, meant: WriteRequest, answer: bytes) -> None:
    """06H and 10H echo where and how much; 17H gives what it reads."""
    assert parse(pdu) == meant
    assert meant.answer(bytes.fromhex("17700003") if meant.read else b"") == answer


BAD = {
    "06H without a word": bytes.fromhex("06FA01"),
    "06H with half a word": bytes.fromhex("06FA010B"),
    "06H with two words": bytes.fromhex("06FA010BB80BB8"),
    "10H alone": b"\x10",
    "10H, no word": several(0xFA00, []),
    "10H, 124 words": several(0xFA00, [0] * 124),
    "10H, count above the bytes": several(0xFA00, [1], count=2),
    "10H, count below the bytes": several(0xFA00, [1, 2], count=1),
    "10H, size wrong": several(0xFA00, [1, 2], size=3),
    "10H, a byte too many": several(0xFA00, [1, 2]) + b"\0",
    "10H, a byte too few": several(0xFA00, [1, 2])[:-1],
    "10H, count 65535": several(0xFA00, [1], count=0xFFFF),
    "17H alone": b"\x17",
    "17H, reads nothing": exchange(0xFD00, 0, 0xFA01, [1]),
    "17H, reads 126": exchange(0xFD00, 126, 0xFA01, [1]),
    "17H, writes nothing": exchange(0xFD00, 1, 0xFA01, []),
    "17H, writes 122": exchange(0xFD00, 1, 0xFA01, [0] * 122),
    "17H, size wrong": exchange(0xFD00, 1, 0xFA01, [1], size=4),
    "17H, a byte too many": exchange(0xFD00, 1, 0xFA01, [1]) + b"\0",
}


@pytest.mark.hazard("H22")
@pytest.mark.parametrize("pdu", BAD.values(), ids=BAD)
def test_what_is_not_exact_is_refused_whole(pdu: bytes) -> None:
    """Lengths and counts agree with each other and with the standard, or nothing is done."""
    with pytest.raises(Malformed):
        parse(pdu)


@given(st.sampled_from([6, 16, 23]), st.binary(max_size=260))
def test_any_bytes_are_read_or_refused(function: int, body: bytes) -> None:
    """What is read has words enough for its answer, and no other error comes."""
    try:
        found = parse(bytes([function]) + body)
    except Malformed:
        return
    assert found.function == function
    assert 1 <= len(found.words) <= 123
    assert (found.read is not None) is (function == 23)


@given(WORDS, st.lists(WORDS, min_size=1, max_size=121), WORDS, st.integers(1, 125))
def test_what_another_library_sends_is_read_as_meant(address: int, words: list[int], start: int, count: int) -> None:
    """Pymodbus' own requests."""
    single = WriteSingleRegisterRequest(address=address, registers=words[:1])
    several_ = WriteMultipleRegistersRequest(address=address, registers=words)
    both = ReadWriteMultipleRegistersRequest(
        read_address=start, read_count=count, write_address=address, write_registers=words
    )
    assert parse(b"\x06" + single.encode()) == WriteRequest(6, address, (words[0],))
    assert parse(b"\x10" + several_.encode()) == WriteRequest(16, address, tuple(words))
    assert parse(b"\x17" + both.encode()) == WriteRequest(23, address, tuple(words), (start, count))
