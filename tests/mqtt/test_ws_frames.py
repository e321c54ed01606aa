"""WebSocket frames as RFC 6455 prints them, cut anywhere; and what no server may send."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.mqtt.ws_frames import BadWebSocket, Control, Frames, Opcode, check, frame, masked, parted, request
from tests.soak import FACTOR

KEY = b"the sample nonce"  # RFC 6455 1.3
MASK = bytes.fromhex("37 fa 21 3d")  # RFC 6455 5.7
ANSWER = (
    b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\nSec-WebSocket-Protocol: mqtt"
)


def of_server(opcode: int, payload: bytes, *, is_final: bool = True) -> bytes:
    """Return a frame as a server sends it: not masked."""
    size = len(payload)
    if size < 126:
        length = bytes((size,))
    elif size < 65_536:
        length = bytes((126,)) + size.to_bytes(2, "big")
    else:
        length = bytes((127,)) + size.to_bytes(8, "big")
    return bytes((0x80 * is_final | opcode,)) + length + payload


def test_the_handshake_is_that_of_the_standard() -> None:
    """Its own key, and the answer to it; MQTT is asked for."""
    asked = request("server.example.com", "/chat", KEY)
    assert asked.startswith(b"GET /chat HTTP/1.1\r\nHost: server.example.com\r\n")
    assert b"\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n" in asked
    assert b"\r\nSec-WebSocket-Protocol: mqtt\r\n" in asked
    assert asked.endswith(b"\r\n\r\n")
    check(ANSWER, KEY)
    check(ANSWER.replace(b"Upgrade: websocket", b"upgrade:WebSocket"), KEY)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b"HTTP/1.1 404 Not Found\r\nServer: x", "HTTP 404 Not Found"),
        (b"HTTP/1.1 200 OK", "HTTP 200 OK"),
        (b"HTTP/1.1", "HTTP"),
        (ANSWER.replace(b"s3pP", b"s3pX"), "does not fit the request"),
        (ANSWER.replace(b"Upgrade: websocket", b"Upgrade: h2c"), "does not fit the request"),
        (ANSWER.replace(b": mqtt", b": amqp"), "another protocol"),
        (ANSWER + b"\r\nSec-WebSocket-Extensions: permessage-deflate", "an extension"),
    ],
)
def test_an_answer_that_opens_no_websocket_is_refused_with_its_reason(answer: bytes, said: str) -> None:
    """A web server without one, somebody else's answer, another protocol."""
    with pytest.raises(BadWebSocket, match=said):
        check(answer, KEY)


def test_the_answer_is_taken_whole_and_no_further() -> None:
    """Behind it frames may have come already; what is no HTTP, or does not end, is not waited for."""
    whole = ANSWER + b"\r\n\r\n" + of_server(2, b"x")
    assert [parted(whole[:size]) for size in range(len(ANSWER) + 4)] == [None] * (len(ANSWER) + 4)
    assert parted(whole) == (ANSWER, of_server(2, b"x"))
    with pytest.raises(BadWebSocket, match="no HTTP"):
        parted(b"\x20\x02\x00\x00")
    with pytest.raises(BadWebSocket, match="does not end"):
        parted(ANSWER + b"\r\nX: " + b"y" * 20_000)


def test_frames_are_written_as_the_standard_prints_them() -> None:
    """RFC 6455 5.7: a masked "Hello"; lengths of one, three and nine bytes."""
    hello = bytes.fromhex("81 85 37 fa 21 3d 7f 9f 4d 51 58")
    assert frame(Opcode.TEXT, b"Hello", MASK) == hello
    assert frame(Opcode.BINARY, bytes(256), b"\0\0\0\0")[:8] == bytes.fromhex("82 fe 01 00 00 00 00 00")
    long = frame(Opcode.BINARY, bytes(65_536), b"\0\0\0\0")
    assert long[:10] == bytes.fromhex("82 ff 00 00 00 00 00 01 00 00")
    assert len(long) == 14 + 65_536


@given(st.binary(max_size=300), st.binary(min_size=4, max_size=4))
def test_a_mask_takes_itself_away(payload: bytes, mask: bytes) -> None:
    """Byte by byte, as the standard says it."""
    assert masked(payload, mask) == bytes(byte ^ mask[i % 4] for i, byte in enumerate(payload))
    assert masked(masked(payload, mask), mask) == payload


PARTS = st.lists(
    st.one_of(
        st.binary(max_size=400).map(lambda payload: (Opcode.BINARY, payload)),
        st.binary(max_size=125).map(lambda payload: (Opcode.PING, payload)),
        st.binary(max_size=125).map(lambda payload: (Opcode.PONG, payload)),
    ),
    max_size=8,
)


@given(PARTS, st.integers(1, 50))
def test_frames_are_read_however_they_are_cut(parts: list[tuple[Opcode, bytes]], size: int) -> None:
    """All bytes of MQTT in order, and every control frame, also between the parts of a message."""
    sent, is_begun = b"", False
    for opcode, payload in parts:
        if opcode is Opcode.BINARY:
            half = len(payload) // 2
            sent += of_server(0 if is_begun else 2, payload[:half], is_final=False)
            sent += of_server(0, payload[half:], is_final=len(payload) % 2 == 0)
            is_begun = len(payload) % 2 == 1
        else:
            sent += of_server(opcode, payload)
    frames, data, controls = Frames(), b"", []
    for start in range(0, len(sent), size):
        more, found = frames.feed(sent[start : start + size])
        data += more
        controls += found
    assert data == b"".join(payload for opcode, payload in parts if opcode is Opcode.BINARY)
    assert controls == [Control(*part) for part in parts if part[0] is not Opcode.BINARY]


@pytest.mark.hazard("H24")
def test_a_frame_that_says_it_is_endless_is_handed_on_and_not_collected() -> None:
    """However long it says it is."""
    frames = Frames()
    frames.feed(b"\x82\x7f" + (2**63 - 1).to_bytes(8, "big"))
    for _ in range(100):
        assert frames.feed(bytes(10_000)) == (bytes(10_000), [])
    assert not frames._buffer


@pytest.mark.parametrize(
    "sent",
    [
        pytest.param(of_server(1, b"text"), id="text"),
        pytest.param(of_server(0, b"x"), id="goes on with nothing"),
        pytest.param(of_server(2, b"x", is_final=False) + of_server(2, b"y"), id="begins anew within"),
        pytest.param(b"\x82\x81\0\0\0\0x", id="masked"),
        pytest.param(b"\xc2\x01x", id="compressed"),
        pytest.param(b"\x83\x01x", id="unknown"),
        pytest.param(b"\x09\x01x", id="a ping in parts"),
        pytest.param(b"\x89\x7e\x00\x7e" + bytes(126), id="a long ping"),
        pytest.param(b"\x20\x02\x00\x00", id="plain MQTT"),
    ],
)
def test_what_no_server_may_send_ends_it(sent: bytes) -> None:
    """RFC 6455 5; MQTT 5 6.0."""
    with pytest.raises(BadWebSocket):
        Frames().feed(sent)


def test_any_bytes_are_read_or_refused() -> None:
    """No other exception, and no more is held than a head or a control frame."""
    chance = random.Random("frames")
    refused = 0
    for _ in range(5_000 * FACTOR):
        frames = Frames()
        try:
            for _ in range(4):
                opcode = chance.choice((0, 2, 2, 2, 8, 9, 10, chance.randrange(16)))
                sent = of_server(opcode, chance.randbytes(chance.choice((0, 1, 5, 130))))
                frames.feed(sent if chance.random() < 0.7 else chance.randbytes(20))
                assert len(frames._buffer) < 140
        except BadWebSocket:
            refused += 1
    assert 0 < refused < 5_000 * FACTOR
