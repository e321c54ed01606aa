"""The mechanics that all decoders share: what is held, what is waited for, and what silence settles."""

from __future__ import annotations

import pytest

from gateway.errors import Refusal, Refused
from gateway.protocol.answers import LIMIT, AnswerDecoder, Dialogue, Shape
from gateway.protocol.codec import Answering, Codec, NoSuchForm
from gateway.protocol.pdu import ReadWords, Words, WriteRam, Written
from gateway.protocol.registry import PROTOCOLS
from tests.protocol.drive_side import heard

REQUEST = b"?ab"
ANSWER = Words((1,))


def dialogue(*shapes: Shape) -> Dialogue:
    """Return a dialogue with the request `?ab`."""
    return Dialogue(REQUEST, Answering.ALWAYS, shapes)


def fixed(start: bytes, size: int) -> Shape:
    """Return a shape of a fixed size that ends in `!`."""
    return Shape(start, size, lambda frame: ANSWER if frame.endswith(b"!") else None)


def hear(decoder: AnswerDecoder, *pieces: bytes) -> list[object]:
    """Return what a decoder makes of some pieces."""
    return list(heard(decoder, pieces))


def test_bytes_of_a_reply_are_taken_and_the_others_kept() -> None:
    """What is left is for messages; a second answer is found behind the first."""
    decoder = AnswerDecoder(dialogue(fixed(b"?x", 4)))
    assert hear(decoder, b"..?xy!..?xz!?x") == [ANSWER, ANSWER]
    assert decoder.received == b"....?x"


def test_what_begins_as_an_answer_is_waited_for_until_the_line_is_silent() -> None:
    """An answer inside the beginning of a longer one counts only when no more comes."""
    decoder = AnswerDecoder(dialogue(fixed(b"?long", 20), fixed(b"?x", 4)))
    assert hear(decoder, b"?long", b"?xy!") == []
    assert hear(decoder, b"") == [ANSWER]


def test_silence_ends_with_the_next_byte() -> None:
    """What comes behind a silence is waited for anew."""
    decoder = AnswerDecoder(dialogue(fixed(b"?x", 4)))
    assert hear(decoder, b"?x", b"", b"?x", b"y!") == [ANSWER]


def test_an_answer_of_unknown_length_is_measured() -> None:
    """The beginning asks for more until it knows; 0 says that it is no answer."""

    def measure(beginning: bytes) -> int:
        return 3 if len(beginning) < 3 else (beginning[2] - ord("0"))

    decoder = AnswerDecoder(dialogue(Shape(b"?x", 9, lambda _: ANSWER, measure)))
    assert hear(decoder, b"?x", b"5", b"a") == []
    assert hear(decoder, b"b") == [ANSWER]
    assert hear(decoder, b"?x0?x3") == [ANSWER]


def test_the_whole_echo_is_passed_over_with_all_that_is_in_it() -> None:
    """Data of the request that look like an answer are none."""
    for pieces in ((b"?=?x7!",), (b"?=", b"?x7!"), (b"?", b"=", b"?x7", b"!")):
        decoder = AnswerDecoder(Dialogue(b"?=?x7!", Answering.ALWAYS, (fixed(b"?x", 4),)))
        assert hear(decoder, *pieces) == []
        assert hear(decoder, b"?x8!") == [ANSWER]


class TestAnAnswerThatBeginsAsTheEcho:
    LONG = Words((2,))
    shapes = (Shape(REQUEST, 8, lambda frame: TestAnAnswerThatBeginsAsTheEcho.LONG), fixed(b"?x", 4))

    def test_is_one_where_no_other_can_begin_behind_the_echo(self) -> None:
        """Nothing in its tail looks like the beginning of an answer."""
        assert hear(AnswerDecoder(dialogue(*self.shapes)), REQUEST + b".....") == [self.LONG]

    @pytest.mark.parametrize("tail", [b"....?", b"...?x", b"..?xy", b".?xy!", b"?xy!."])
    def test_gives_way_to_an_answer_behind_the_echo(self, tail: bytes) -> None:
        """The other answer is waited for, and what was held back is forgotten with it."""
        decoder = AnswerDecoder(dialogue(*self.shapes))
        assert hear(decoder, REQUEST + tail, b"?xy!"[len(tail) - tail.index(b"?") :]) == [ANSWER]
        left = len(decoder.received)
        assert left < 8
        assert hear(decoder, b"." * (8 - left), b"") == []

    def test_is_one_when_the_line_falls_silent_right_behind_it(self) -> None:
        """Not when anything follows."""
        assert hear(AnswerDecoder(dialogue(*self.shapes)), REQUEST + b"....?", b"") == [self.LONG]
        assert hear(AnswerDecoder(dialogue(*self.shapes)), REQUEST + b"....?", b".", b"") == []

    def test_is_forgotten_when_babble_pushes_it_out(self) -> None:
        """The place where it ended means nothing any more."""
        decoder = AnswerDecoder(dialogue(*self.shapes))
        assert hear(decoder, b"." * 300 + REQUEST + b"....?") == []
        assert hear(decoder, b"." * (LIMIT - 300)) == []
        assert hear(decoder, b"." * (308 - len(decoder.received)), b"") == []
        assert len(decoder.received) == 308


def test_where_nobody_answers_nothing_is_heard() -> None:
    """A decoder for such a request waits for ever."""
    decoder = AnswerDecoder(Dialogue(REQUEST, Answering.NEVER))
    assert hear(decoder, REQUEST, b"?x1!", b"") == []
    assert decoder.received == REQUEST + b"?x1!"


def test_a_refusal_is_raised_once() -> None:
    """The decoder goes on behind it."""
    refusal = Refused("no", Refusal.UNABLE)
    decoder = AnswerDecoder(dialogue(fixed(b"?x", 4), Shape(b"?n", 2, lambda _: refusal)))
    decoder.feed(b"?n?x1!")
    with pytest.raises(Refused) as caught:
        decoder.next_reply()
    assert caught.value is refusal
    assert decoder.next_reply() == ANSWER


@pytest.mark.parametrize("codec", PROTOCOLS.values(), ids=list(PROTOCOLS))
class TestEveryCodec:
    def test_holds_little_however_long_the_babble(self, codec: Codec) -> None:
        """Noise is dropped from the front; an answer behind it is read."""
        request = WriteRam(1, 0xFA01, 6000)
        decoder = codec.decoder(request)
        noise = codec.encode(ReadWords(1, 0xFA01))[:-1] * 40
        for _ in range(100):
            assert heard(decoder, [noise]) == []
            assert len(decoder.received) <= LIMIT
        said = Written((), False if codec.forms.says_tripped else None)
        assert heard(decoder, [b"\x00", codec.encode(request), b""]) == [said]
        assert heard(decoder, [noise, b"\x00" * LIMIT + codec.encode(request)]) == [said]

    def test_says_the_same_of_equal_requests_and_tells_unequal_ones_apart(self, codec: Codec) -> None:
        """What is remembered of a request is of that request only."""
        assert codec.encode(WriteRam(1, 0xFA01, 1)) == codec.encode(WriteRam(1, 0xFA01, 1))
        assert codec.answering(WriteRam(1, 0xFA00, 1)) is Answering.ALWAYS
        assert codec.answering(WriteRam(1, 0xFA00, 1, is_answered=False)) is Answering.MAYBE

    def test_refuses_again_what_it_refused(self, codec: Codec) -> None:
        """A refusal is not remembered as a frame."""
        for _ in range(2):
            with pytest.raises(NoSuchForm):
                codec.encode(ReadWords(1, 0xFA01, 9))
