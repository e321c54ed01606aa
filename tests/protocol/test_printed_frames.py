"""Every frame that the manuals print, in both directions: made byte for byte, read whole, in pieces, amid noise."""

from __future__ import annotations

from collections import Counter

import pytest

from gateway.protocol.codec import NoSuchForm
from gateway.protocol.pdu import Identify, Identity, WriteBlock, WriteRam, WriteStored
from tests import frames
from tests.protocol.drive_side import Denied, heard
from tests.protocol.printed import (
    ANSWERS,
    BINARY,
    BINARY_G,
    COPIES,
    NOT_MADE,
    PLAIN,
    REPLIES,
    REQUESTS,
    RTU,
    RTU_10H,
    RUN_60_HZ,
    Printed,
    X,
)


def printed(direction: str) -> set[str]:
    """Return the printed frames of one direction."""
    return {frame.hex for frame in frames.FRAMES if frame.direction == direction}


def test_all_82_frames_of_the_manuals_are_here() -> None:
    """As many of each protocol and direction as the manuals print."""
    count = Counter((frame.protocol, frame.direction) for frame in frames.FRAMES)
    both = ("request", "response")
    assert [count[frames.RTU, way] for way in both] == [14, 14]
    assert [count[frames.BINARY, way] for way in both] == [13, 13]
    assert [count[frames.ASCII, way] for way in both] == [14, 14]
    assert sum(count.values()) == 82


def test_every_printed_frame_is_in_these_tables() -> None:
    """What is not made or not read is so by design, and nothing else is."""
    assert REQUESTS.keys() | NOT_MADE.keys() == printed("request")
    assert REQUESTS.keys().isdisjoint(NOT_MADE)
    assert {frame for _, _, frame, _ in REPLIES} | set(frames.MISPRINTED) == printed("response")


@pytest.mark.parametrize("frame", REQUESTS)
def test_a_request_is_the_printed_frame(frame: str) -> None:
    """Byte for byte."""
    codec, request = REQUESTS[frame]
    assert codec.encode(request) == bytes.fromhex(frame)


def test_the_frames_that_are_not_made_are_refused_or_made_right() -> None:
    """Three words for two places are refused; a checksum is right; data has four digits."""
    with pytest.raises(NoSuchForm, match="must be 2, not 3"):
        RTU.encode(WriteBlock(1, 0x1870, (*RUN_60_HZ, 0)))
    made = [BINARY.encode(X), *(PLAIN.encode(WriteStored(None, *write)) for write in ((0x0803, 0), (0x1234, 0x12)))]
    assert made == [bytes.fromhex("2F 58 02 05 C4 00 17 70 D9"), b"(W08030000)\r", b"(W12340012)\r"]
    assert not {frame.hex(" ").upper() for frame in made} & NOT_MADE.keys()


def test_every_copied_answer_is_read() -> None:
    """Ten printed writes are answered by the same bytes, as the manuals say beside them."""
    assert len(COPIES) == 10
    assert {frame for _, _, frame, _ in COPIES} < REQUESTS.keys()


@pytest.mark.parametrize("answer", ANSWERS, ids=lambda answer: f"{answer.codec.name} {answer.frame.hex()}")
class TestAnswers:
    def test_whole(self, answer: Printed) -> None:
        """A whole frame is its reply, and leaves nothing behind."""
        decoder = answer.codec.decoder(answer.request)
        assert heard(decoder, [answer.frame]) == [answer.said]
        assert decoder.received == b""

    def test_byte_by_byte(self, answer: Printed) -> None:
        """Nothing before the last byte, the reply with it."""
        decoder = answer.codec.decoder(answer.request)
        pieces = [answer.frame[at : at + 1] for at in range(len(answer.frame))]
        assert heard(decoder, pieces[:-1]) == []
        assert heard(decoder, pieces[-1:]) == [answer.said]

    def test_of_the_size_that_was_foreseen(self, answer: Printed) -> None:
        """Never longer than the normal answer, never shorter than the shortest."""
        longest, least = answer.codec.answer_size(answer.request), answer.codec.least_answer(answer.request)
        assert least <= len(answer.frame) <= longest
        assert isinstance(answer.said, Denied | Identity) or len(answer.frame) == longest

    def test_with_the_next_frame_at_its_heels(self, answer: Printed) -> None:
        """The frame ends where it ends: another request or answer behind it makes no difference."""
        for following in (answer.codec.encode(answer.request), answer.frame, b"\x01\x03\x02\x17\x70\xb6\x50"):
            assert answer.hear(answer.frame + following)[0] == answer.said

    def test_between_noise(self, answer: Printed) -> None:
        """Glitches of the turnaround in front, noise behind, and what was no reply is kept for messages."""
        decoder = answer.codec.decoder(answer.request)
        assert heard(decoder, [b"\xff\x00", answer.frame + b"\x55\xaa"]) == [answer.said]
        assert decoder.received == b"\xff\x00\x55\xaa"

    def test_behind_a_broken_beginning(self, answer: Printed) -> None:
        """Part of the same frame in front is passed over, at the latest when the line falls silent."""
        for cut in range(1, len(answer.frame)):
            assert answer.hear(answer.frame[:cut] + answer.frame, b"")[0] == answer.said

    @pytest.mark.hazard("H15")
    def test_behind_the_adapters_echo(self, answer: Printed) -> None:
        """The echo is passed over, unless it has the form of an answer: to 06H, P and W to one drive, and to G."""
        is_write = isinstance(answer.request, WriteRam | WriteStored) and answer.codec is not RTU_10H
        has_form = isinstance(answer.request.number, int | None) and (is_write or answer.codec is BINARY_G)
        echo = answer.codec.encode(answer.request)
        assert bool(answer.hear(echo, b"")) is has_form
        assert answer.hear(echo, answer.frame)[-1] == answer.said


@pytest.mark.hazard("H17")
@pytest.mark.parametrize("answer", [answer for answer in ANSWERS if answer.codec is not PLAIN])
def test_no_flipped_bit_is_accepted(answer: Printed) -> None:
    """Each bit of a frame with a checksum flipped in turn: never a reply to this request."""
    for bit in range(8 * len(answer.frame)):
        broken = bytearray(answer.frame)
        broken[bit // 8] ^= 1 << bit % 8
        assert answer.hear(bytes(broken), b"") == []


def test_the_misprinted_identification_is_refused_and_the_right_one_read() -> None:
    """The VF-MB1 manual's answer ends in 9A CC; its CRC is B6 0C."""
    misprinted = bytes.fromhex(frames.MISPRINTED[0])
    right = misprinted[:-2] + bytes.fromhex("B6 0C")
    assert heard(RTU.decoder(Identify(1)), [misprinted, b""]) == []
    assert heard(RTU.decoder(Identify(1)), [right]) == [Identity("TOSHIBA", "VFMB1S-2004PL", "0102")]
