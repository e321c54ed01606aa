"""What a broker sends is cut into the packets that it sent, wherever the network cuts it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.mqtt.packets import puback
from gateway.mqtt.stream import Stream, TooLarge
from tests.mqtt.played import packet

LARGEST = 64 * 1024
PACKETS = st.tuples(st.integers(0, 255), st.one_of(st.binary(max_size=20), st.integers(100, 20_000).map(bytes)))


def taken(stream: Stream) -> list[bytes]:
    """Return all packets that are whole."""
    return list(iter(stream.next, None))


@given(st.lists(PACKETS, max_size=8), st.lists(st.integers(0, 100_000), max_size=8))
def test_packets_come_as_they_were_sent(sent: list[tuple[int, bytes]], cuts: list[int]) -> None:
    """In any pieces."""
    whole = [packet(head, body) for head, body in sent]
    raw, stream, found = b"".join(whole), Stream(LARGEST), []
    ends = [*sorted(cut % (len(raw) + 1) for cut in cuts), len(raw)]
    for start, end in zip([0, *ends], ends, strict=False):
        stream.feed(raw[start:end])
        found += taken(stream)
    assert found == whole


def test_packets_come_byte_by_byte() -> None:
    """Each when its last byte has come, and not before."""
    whole = [b"\x40\x02\xfd\xe9", b"\xd0\x00", packet(0x30, b"x" * 300), b"\x40\x03\xfd\xea\x10"]
    stream, found = Stream(LARGEST), []
    for place, byte in enumerate(b"".join(whole)):
        stream.feed(bytes([byte]))
        found += [(place, each) for each in taken(stream)]
    ends = [3, 5, 308, 313]
    assert found == list(zip(ends, whole, strict=True))


@pytest.mark.hazard("H24")
def test_a_packet_that_is_too_large_is_refused_before_it_has_come() -> None:
    """When its length is known; one of that very length is none, and what came before it is handed on."""
    stream = Stream(300)
    stream.feed(packet(0x30, bytes(300)) + packet(0x30, bytes(301))[:2])
    assert stream.next() == packet(0x30, bytes(300))
    assert stream.next() is None
    stream.feed(packet(0x30, bytes(301))[2:3])
    with pytest.raises(TooLarge) as refused:
        stream.next()
    assert refused.value.size == 301


def test_a_length_that_is_none_is_shown_as_it_came() -> None:
    """More than four bytes (MQTT 5 1.5.5): whoever reads that finds that it is no MQTT."""
    stream = Stream(LARGEST)
    stream.feed(b"\x40\xff\xff\xff\xff")
    assert stream.next() is None
    stream.feed(b"\xff\x01")
    assert stream.next() == b"\x40\xff\xff\xff\xff\xff"


@pytest.mark.parametrize(
    ("raw", "is_5", "found"),
    [
        (b"\x40\x02\xfd\xe9", True, (0xFDE9, 0)),
        (b"\x40\x02\xfd\xe9", False, (0xFDE9, 0)),
        (b"\x40\x03\xfd\xe9\x10", True, (0xFDE9, 0x10)),
        (b"\x40\x04\x00\x07\x97\x00", True, (7, 0x97)),
        (packet(0x40, b"\x00\x07\x87" + b"\xc7\x01\x1f\x00\xc4" + b"y" * 196), True, (7, 0x87)),
        (b"\x40\x82\x00\x00\x07", True, (7, 0)),
        (b"\x40\x03\xfd\xe9\x10", False, None),
        (b"\x40\x01\xfd", True, None),
        (b"\x40\x00", False, None),
        (b"\x41\x02\xfd\xe9", True, None),
        (b"\x50\x02\xfd\xe9", True, None),
        (b"\x40\xff\xff\xff\xff\xff", True, None),
        (b"\x40\x80\x80\x80\x80\x01", False, None),
    ],
    ids=lambda value: value[:6].hex(" ") if isinstance(value, bytes) else str(value),
)
def test_acknowledgements_are_read(raw: bytes, is_5: bool, found: tuple[int, int] | None) -> None:
    """With reason and properties where the protocol has them (MQTT 5 3.4); what is none of them is left to paho."""
    assert puback(raw, is_5=is_5) == found


@given(st.binary(min_size=2, max_size=12), st.booleans())
def test_nothing_that_comes_is_an_error(raw: bytes, is_5: bool) -> None:
    """Only what could be one is an acknowledgement."""
    found = puback(raw, is_5=is_5)
    assert found is None or raw[0] == 0x40
