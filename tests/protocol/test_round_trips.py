"""Every codec against answers built from the manuals: round trips, resynchronisation, and who is not believed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise, permutations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from gateway.protocol.codec import Answering
from gateway.protocol.frame_codec import FrameCodec
from gateway.protocol.pdu import Identify, Request
from tests.protocol.dialects import DIALECTS
from tests.protocol.drive_side import Content, Dialect, heard

SILENCE = b""
junk = st.binary(max_size=20)


@dataclass(frozen=True)
class Case:
    """A request, a normal answer to it, and a refusal."""

    dialect: Dialect
    request: Request
    content: Content
    refusal: bytes

    @property
    def echo(self) -> bytes:
        """Return the frame of the request."""
        return self.dialect.codec.encode(self.request)

    @property
    def frame(self) -> bytes:
        """Return the frame of the answer: the refusal where there is no normal one."""
        return self.dialect.frame(self.request, self.content) or self.refusal

    def hear(self, *pieces: bytes) -> list[object]:
        """Return what a fresh decoder makes of these pieces and of the silence behind them."""
        return list(heard(self.dialect.codec.decoder(self.request), (*pieces, SILENCE)))


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Make up a request of any codec and its answers."""

    def pick(least: int, most: int) -> int:
        return draw(st.integers(least, most))

    dialect = draw(st.sampled_from(DIALECTS))
    request = dialect.request(pick)
    content = dialect.content(request, pick)
    refusal = dialect.refusal(request, pick(0, 5), draw(st.booleans()))
    return Case(dialect, request, content, refusal)


@given(cases(), st.data())
def test_an_answer_is_read_however_it_is_cut(case: Case, data: st.DataObject) -> None:
    """Round trip of normal answers and refusals in up to three pieces, noise in front and behind."""
    wanted = data.draw(st.sampled_from([case.frame, case.refusal]))
    before = data.draw(junk.filter(lambda noise: case.echo[0] not in noise))
    stream = before + wanted + data.draw(junk.filter(lambda noise: case.echo[0] not in noise))
    cuts = sorted(data.draw(st.tuples(*2 * [st.integers(0, len(stream))])))
    pieces = [stream[: cuts[0]], stream[cuts[0] : cuts[1]], stream[cuts[1] :]]
    assert case.hear(*filter(None, pieces)) == [case.dialect.said(case.request, wanted)]


@given(cases())
def test_what_was_sent_is_what_is_read(case: Case) -> None:
    """The words, the trip and the failed places of an answer are those that the drive put into it."""
    if normal := case.dialect.frame(case.request, case.content):
        assert case.hear(normal) == [case.dialect.reply(case.request, case.content)]


@given(cases())
def test_nothing_is_said_before_the_last_byte(case: Case) -> None:
    """A frame counts only whole, and silence does not make it so."""
    assert case.hear(case.frame[:-1]) == []


@given(cases())
def test_the_sizes_are_those_of_the_answers(case: Case) -> None:
    """`answer_size` and `least_answer` agree with the manual; an identification has at most that many characters."""
    codec, request = case.dialect.codec, case.request
    size, normal = codec.answer_size(request), case.dialect.frame(request, case.content)
    assert len(normal) <= size if isinstance(request, Identify) else len(normal) == size
    assert codec.least_answer(request) == min(len(frame) for frame in (normal, case.refusal) if frame)
    assert (codec.answering(request) is Answering.ALWAYS) <= bool(normal)


@given(cases())
def test_no_answer_begins_as_another_kind_does(case: Case) -> None:
    """The first bytes say which kind of answer it is, so that one look is enough."""
    assert isinstance(case.dialect.codec, FrameCodec)
    dialogue = case.dialect.codec.dialogue(case.request)
    starts = [shape.start for shape in dialogue.normal + dialogue.refusals]
    assert not [pair for pair in permutations(starts, 2) if pair[0].startswith(pair[1])]
    assert {start[:1] for start in starts} <= {case.echo[:1]}


@pytest.mark.hazard("H15")
@given(cases(), st.data())
def test_an_echo_is_passed_over(case: Case, data: st.DataObject) -> None:
    """The adapter's echo in front of an answer, cut anywhere, or alone; an echo that is an answer is one."""
    wanted = data.draw(st.sampled_from([case.frame, case.refusal]))
    assume(wanted != case.echo)
    echo_says = [said] if (said := case.dialect.said(case.request, case.echo)) else []
    stream = case.echo + wanted
    cut = data.draw(st.integers(1, len(stream) - 1))
    assert case.hear(stream[:cut], stream[cut:]) == [*echo_says, case.dialect.said(case.request, wanted)]
    assert case.hear(case.echo) == echo_says


@st.composite
def streams(draw: st.DrawFn) -> tuple[Case, bytes]:
    """Make up a request and bytes that look much like what may come: frames, echoes, pieces of them, noise."""
    case = draw(cases())
    whole = st.sampled_from([case.frame, case.refusal, case.echo])
    cut = st.tuples(whole, st.integers(1, 20), st.booleans())
    piece = cut.map(lambda choice: choice[0][: choice[1]] if choice[2] else choice[0][-choice[1] :])
    parts = draw(st.lists(st.one_of(whole, piece, st.binary(max_size=4), st.just(case.echo[:1])), max_size=8))
    return case, b"".join(parts)


@given(streams(), st.lists(st.integers(0, 200), max_size=5))
def test_the_cut_of_the_bytes_makes_no_difference(stream: tuple[Case, bytes], cuts: list[int]) -> None:
    """A decoder says the same of the same bytes, in one piece, in many, byte by byte."""
    case, data = stream
    at_once = case.hear(data) if data else []
    places = [0, *sorted(cuts), len(data)]
    pieces = [data[start:end] for start, end in pairwise(places)]
    assert case.hear(*filter(None, pieces)) == at_once
    assert case.hear(*(bytes((byte,)) for byte in data)) == at_once


@pytest.mark.hazard("H17")
@given(streams())
def test_only_exact_answers_are_believed(stream: tuple[Case, bytes]) -> None:
    """Whatever a decoder says stands in the bytes as an exact answer; where one stands and no echo, one is found."""
    case, data = stream
    exact = case.dialect.answers_in(case.request, data)
    said = case.hear(data)
    assert all(any(one == other for other in exact) for one in said)
    if exact and case.echo not in data:
        assert said


@pytest.mark.hazard("H16")
@given(cases(), st.data())
def test_the_answer_to_another_request_is_dropped(case: Case, data: st.DataObject) -> None:
    """Number, command, communication number, count and echoed data must be those of the request."""

    def pick(least: int, most: int) -> int:
        return data.draw(st.integers(least, most))

    other = case.dialect.request(pick)
    late = Case(case.dialect, other, case.content, case.refusal)
    is_answer_to_both = late.dialect.said(other, case.frame) is not None
    assert bool(late.hear(case.frame)) == is_answer_to_both
