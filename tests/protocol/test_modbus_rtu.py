"""The MODBUS-RTU codec: the manuals' frames whole, in pieces, with junk around, and what it must not accept."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.errors import Refusal, Refused
from gateway.protocol.checksum import crc16
from gateway.protocol.modbus_rtu import MAX_ADU, ModbusRtu
from gateway.protocol.pdu import Identify, Identity, ReadBlock, ReadWords, Reply, Request, Words
from tests import frames

CODEC = ModbusRtu()

REQUESTS: list[tuple[str, Request]] = [
    ("01 03 FD 00 00 01 B5 A6", ReadWords(1, 0xFD00)),
    ("01 03 FD 00 00 02 F5 A7", ReadWords(1, 0xFD00, 2)),
    ("01 03 18 75 00 05 92 B3", ReadBlock(1, 0x1875, 5)),
    ("01 03 18 75 00 02 D3 71", ReadBlock(1, 0x1875, 2)),
    ("01 03 18 75 00 06 D2 B2", ReadWords(1, 0x1875, 6)),
    ("01 03 18 76 00 02 23 71", ReadBlock(1, 0x1876, 2)),
    ("01 03 01 30 00 05 84 3A", ReadWords(1, 0x0130, 5)),
    ("01 2B 0E 01 00 70 77", Identify(1)),
]
NC3 = Identity("TOSHIBA", "VFnC3-2007P", "0100")
REPLIES: list[tuple[Request, str, Reply]] = [
    (ReadWords(1, 0xFD00), "01 03 02 17 70 B6 50", Words((6000,))),
    (
        ReadBlock(1, 0x1875, 5),
        "01 03 0A E4 04 17 70 00 00 26 FF 00 80 58 00",
        Words((0xE404, 6000, 0, 0x26FF, 0x80)),
    ),
    (ReadBlock(1, 0x1875, 2), "01 03 04 E4 04 17 70 83 16", Words((0xE404, 6000))),
    (ReadBlock(1, 0x1875, 2), "01 03 04 00 00 17 70 F4 27", Words((0, 6000))),
    (
        ReadWords(1, 0x0130, 5),
        "01 03 0A 00 04 80 00 00 0A 80 00 80 00 CE 17",
        Words((4, 0x8000, 10, 0x8000, 0x8000)),
    ),
    (
        ReadWords(1, 0x0130, 5),
        "01 03 0A 00 04 00 06 00 0A 80 00 80 00 A0 77",
        Words((4, 6, 10, 0x8000, 0x8000)),
    ),
    (
        Identify(1),
        "01 2B 0E 01 01 00 00 03 00 07 54 4F 53 48 49 42 41 01 0B 56 46 6E 43 33 2D 32 30 30 37 50"
        " 02 04 30 31 30 30 38 2C",
        NC3,
    ),
]


def decode(request: Request, *pieces: bytes) -> Reply | None:
    """Feed pieces to a fresh decoder and return the first reply."""
    decoder = CODEC.decoder(request)
    for piece in pieces:
        decoder.feed(piece)
        if (reply := decoder.next_reply()) is not None:
            return reply
    return None


@pytest.mark.parametrize(("printed", "request_"), REQUESTS, ids=[text for text, _ in REQUESTS])
def test_requests_are_the_printed_frames(printed: str, request_: Request) -> None:
    """Every read that the manuals print."""
    assert CODEC.encode(request_) == bytes.fromhex(printed)


def test_every_printed_read_is_in_these_tables() -> None:
    """No printed 03H or 2BH frame is left out."""
    here = {bytes.fromhex(text) for text, _ in REQUESTS} | {bytes.fromhex(text) for _, text, _ in REPLIES}
    for frame in frames.FRAMES:
        if frame.protocol == "modbus-rtu" and frame.data[1] in (0x03, 0x2B) and frame.hex not in frames.MISPRINTED:
            assert frame.data in here, frame.meaning


@pytest.mark.parametrize(("request_", "printed", "reply"), REPLIES, ids=[text for _, text, _ in REPLIES])
class TestReplies:
    def test_whole(self, request_: Request, printed: str, reply: Reply) -> None:
        """A whole frame is its reply, and its size was foreseen."""
        frame = bytes.fromhex(printed)
        assert decode(request_, frame) == reply
        assert len(frame) <= CODEC.answer_size(request_)

    def test_byte_by_byte(self, request_: Request, printed: str, reply: Reply) -> None:
        """Nothing before the last byte, the reply with it."""
        frame = bytes.fromhex(printed)
        decoder = CODEC.decoder(request_)
        for position in range(len(frame)):
            assert decoder.next_reply() is None
            decoder.feed(frame[position : position + 1])
        assert decoder.next_reply() == reply

    @pytest.mark.hazard("H15")
    def test_behind_the_adapters_echo(self, request_: Request, printed: str, reply: Reply) -> None:
        """The request that an adapter echoes is passed over."""
        assert decode(request_, CODEC.encode(request_), bytes.fromhex(printed)) == reply
        assert decode(request_, CODEC.encode(request_)) is None

    def test_between_junk(self, request_: Request, printed: str, reply: Reply) -> None:
        """Glitches of the turnaround in front, noise behind."""
        assert decode(request_, b"\xff\x00", bytes.fromhex(printed) + b"\x55\xaa") == reply

    @pytest.mark.hazard("H16")
    def test_not_from_another_drive_nor_for_another_request(
        self, request_: Request, printed: str, reply: Reply
    ) -> None:
        """Number, function and count must match: the frame answers no other request."""
        frame = bytes.fromhex(printed)
        others: list[Request] = [ReadWords(2, 0xFD00), ReadBlock(2, 0x1875, 5), Identify(2), ReadWords(1, 0xFD00, 3)]
        assert all(decode(other, frame) is None for other in others)

    @pytest.mark.hazard("H17")
    def test_no_flipped_bit_is_accepted(self, request_: Request, printed: str, reply: Reply) -> None:
        """Each bit of the frame flipped in turn: never a reply."""
        frame = bytes.fromhex(printed)
        for bit in range(8 * len(frame)):
            broken = bytearray(frame)
            broken[bit // 8] ^= 1 << bit % 8
            assert decode(request_, bytes(broken)) is None


def test_the_misprinted_identification_is_refused_and_the_right_one_read() -> None:
    """The VF-MB1 manual's answer ends in 9A CC; its CRC is B6 0C."""
    printed = next(frame.data for frame in frames.FRAMES if frame.hex in frames.MISPRINTED)
    assert decode(Identify(1), printed) is None
    assert decode(Identify(1), printed[:-2] + bytes.fromhex("B60C")) == Identity("TOSHIBA", "VFMB1S-2004PL", "0102")


@pytest.mark.parametrize(
    ("code", "reason"),
    [(1, Refusal.COMMAND), (2, Refusal.ADDRESS), (3, Refusal.RANGE), (4, Refusal.UNABLE), (9, Refusal.OTHER)],
)
def test_error_codes_are_refusals(code: int, reason: Refusal) -> None:
    """E6581657 5.3: error codes 01 to 04."""
    body = bytes((1, 0x83, code))
    decoder = CODEC.decoder(ReadWords(1, 0xFD00))
    decoder.feed(body + crc16(body))
    with pytest.raises(Refused) as refused:
        decoder.next_reply()
    assert refused.value.reason is reason


def test_the_printed_refusal() -> None:
    """Error 03 for two words from FD00."""
    decoder = CODEC.decoder(ReadWords(1, 0xFD00, 2))
    decoder.feed(bytes.fromhex("01 83 03 01 31"))
    with pytest.raises(Refused, match="error 03"):
        decoder.next_reply()


numbers = st.integers(1, 247)
requests = st.one_of(
    st.builds(ReadWords, numbers, st.integers(0, 0xFFF8), st.integers(1, 8)),
    st.builds(ReadBlock, numbers, st.just(0x1875), st.integers(2, 5)),
    st.builds(Identify, numbers),
)


@pytest.mark.hazard("H17")
@given(requests, st.binary(max_size=600))
def test_random_bytes_are_no_reply_and_no_surprise(request_: Request, noise: bytes) -> None:
    """Whatever comes, the decoder neither raises nor grows; a refusal needs a sound frame."""
    decoder = CODEC.decoder(request_)
    try:
        for start in range(0, len(noise), 7):
            decoder.feed(noise[start : start + 7])
            reply = decoder.next_reply()
            assert reply is None or _is_sound(request_, noise)
    except Refused:
        assert _is_sound(request_, noise)
    assert len(decoder.received) <= 2 * MAX_ADU


def _is_sound(request_: Request, noise: bytes) -> bool:
    """Say whether the noise holds, by chance, a whole frame of that drive with a right CRC."""
    starts = [i for i, byte in enumerate(noise) if byte == request_.number]
    return any(crc16(noise[s : e - 2]) == noise[e - 2 : e] for s in starts for e in range(s + 5, len(noise) + 1))


@given(numbers, st.integers(0, 0xFFF8), st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=8), st.data())
def test_words_come_back_as_sent_however_they_are_cut(
    number: int, address: int, words: list[int], data: st.DataObject
) -> None:
    """Round trip through a frame built from the standard, in random pieces, with junk in front."""
    body = bytes((number, 3, 2 * len(words))) + b"".join(word.to_bytes(2, "big") for word in words)
    frame = body + crc16(body)
    cut = data.draw(st.integers(0, len(frame)))
    junk = data.draw(st.binary(max_size=5).filter(lambda junk: number not in junk))
    assert decode(ReadWords(number, address, len(words)), junk, frame[:cut], frame[cut:]) == Words(tuple(words))
